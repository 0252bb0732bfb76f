"""The unknown parameters: keys, starts, truth, legal ranges, and their place in the scene."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from . import images
from .errors import InputError, nearest

# Ranges outside which a parameter means nothing (or gains energy), by the last word of its key.
# Roughness stays above 0.03: below about that the principled lobe's derivative dies.
_RANGES = {
    "base_color": (0.0, 1.0),
    "reflectance": (0.0, 1.0),
    "albedo": (0.0, 1.0),
    "roughness": (0.03, 1.0),
    "alpha": (0.03, 1.0),
    "metallic": (0.0, 1.0),
    "spec_trans": (0.0, 1.0),
    "radiance": (0.0, np.inf),
    "intensity": (0.0, np.inf),
}


@dataclass
class Unknown:
    """One unknown. ``start`` and ``truth`` are float32 arrays of the parameter's shape
    (``truth`` is None for photographs); ``low``, ``high``: legal range, parameter's unit;
    ``lr``: its own learning rate, or None for the optimiser's; ``seen``: which entries some view
    sees (bool, same shape), filled in by ``coverage``."""

    key: str
    start: np.ndarray
    truth: np.ndarray | None
    low: float
    high: float
    lr: float | None
    seen: np.ndarray | None = None


def _moves_geometry(params: mi.SceneParameters, key: str) -> bool:
    """Whether the parameter changes what is visible. Mitsuba's flag alone would not do: it also
    marks roughness, whose lobe is smooth inside the legal range."""
    owner = params.properties[key][2]
    discontinuous = params.flags(key) & mi.ParamFlags.Discontinuous
    return bool(discontinuous) and not isinstance(owner, (mi.BSDF, mi.Texture))


def differentiable_keys(params: mi.SceneParameters) -> list[str]:
    """All keys that path replay can differentiate: floating point, not moving geometry."""
    keys = []
    for key in params.keys():
        value = params[key]
        if not (dr.is_array_v(value) and dr.is_diff_v(value) and dr.is_float_v(value)):
            continue
        if dr.is_matrix_v(value) or dr.width(value) == 0:
            continue
        if isinstance(params.properties[key][2], (mi.Sensor, mi.Film)):
            continue
        if params.flags(key) & mi.ParamFlags.NonDifferentiable or _moves_geometry(params, key):
            continue
        keys.append(key)
    return keys


def as_numpy(value) -> np.ndarray:
    """A parameter as a float32 array: tensors keep their shape, colours become (3,)."""
    array = np.asarray(value, dtype=np.float32)
    return array if dr.is_tensor_v(value) else array.reshape(-1)


def _like(template, array: np.ndarray):
    """``array`` as a Dr.Jit value of the type of ``template``."""
    kind = type(template)
    if dr.is_tensor_v(kind):
        return kind(np.ascontiguousarray(array, dtype=np.float32))
    if dr.size_v(kind) > 1:
        return kind(*[float(x) for x in array]) if array.size == dr.size_v(kind) else kind(array)
    return kind(np.ascontiguousarray(array.reshape(-1), dtype=np.float32))


def flat(value) -> mi.Float:
    """All entries of a parameter as one flat array, in Dr.Jit's order. Traced."""
    return value.array if dr.is_tensor_v(value) else dr.ravel(value)


def unflat(template, entries: mi.Float):
    """The inverse of ``flat`` for a parameter of the type and shape of ``template``."""
    if dr.is_tensor_v(template):
        return type(template)(entries, template.shape)
    return dr.unravel(type(template), entries)


def _start(spec, key: str, current: np.ndarray, truth_known: bool) -> np.ndarray:
    if spec is None:
        if truth_known:
            raise InputError(
                f"scene.unknowns['{key}'] has no start: without scene.targets the scene's own "
                "value is the truth; give start: a number, a list or an image file"
            )
        return current.copy()
    if isinstance(spec, str):
        loaded = images.read(Path(spec))
        if loaded.shape != current.shape:
            raise InputError(
                f"scene.unknowns['{key}'].start: {spec} is {loaded.shape}, "
                f"the parameter {current.shape}"
            )
        return loaded.astype(np.float32)
    try:
        if isinstance(spec, bool):
            raise TypeError
        return np.broadcast_to(np.asarray(spec, np.float32), current.shape).copy()
    except (ValueError, TypeError):
        raise InputError(
            f"scene.unknowns['{key}'].start={spec} does not fit the parameter's shape "
            f"{current.shape}: give one number, or one per channel"
        ) from None


def _range(spec, key: str, start: np.ndarray) -> tuple[float, float]:
    if spec is None:
        words = key.split(".")
        return next((_RANGES[w] for w in reversed(words) if w in _RANGES), (-np.inf, np.inf))
    if len(spec) != 2 or not spec[0] < spec[1]:
        raise InputError(
            f"scene.unknowns['{key}'].range={list(spec)}: give [low, high] with low < high"
        )
    return float(spec[0]), float(spec[1])


def parse(params: mi.SceneParameters, specs: dict, truth_known: bool) -> list[Unknown]:
    """Check the configured unknowns against the scene and read starts and truths.

    ``specs``: key → object with ``start``, ``range``, ``lr`` (``config.Unknown``).
    Raises InputError for an unknown key (nearest and all differentiable ones listed), for one
    that moves geometry, an illegal range, a start outside it, or when there is no unknown.
    """
    valid = differentiable_keys(params)
    if not valid:
        raise InputError("the scene has no differentiable parameter to recover")
    if not specs:
        raise InputError(
            f"scene.unknowns is empty: name what to recover; valid: {', '.join(valid)}"
        )
    found = []
    for key, spec in specs.items():
        if key not in valid:
            if key in params and _moves_geometry(params, key):
                raise InputError(
                    f"scene.unknowns: '{key}' moves geometry, whose visibility path replay does "
                    f"not differentiate; valid: {', '.join(valid)}"
                )
            raise InputError(
                f"scene.unknowns: '{key}' is no differentiable parameter; {nearest(key, valid)}"
            )
        current = as_numpy(params[key])
        start = _start(spec.start, key, current, truth_known)
        low, high = _range(spec.range, key, start)
        if not np.all(np.isfinite(start)) or start.min() < low or start.max() > high:
            raise InputError(
                f"scene.unknowns['{key}'].start lies outside its range [{low:g}, {high:g}]"
            )
        if spec.lr is not None and not spec.lr > 0:
            raise InputError(f"scene.unknowns['{key}'].lr={spec.lr}: must be above 0")
        truth = current if truth_known else None
        if truth is not None and (truth.min() < low or truth.max() > high):
            raise InputError(
                f"scene.unknowns['{key}']: the scene's own value, the truth, is outside its range "
                f"[{low:g}, {high:g}]; give a range that holds it"
            )
        found.append(Unknown(key, start, truth, low, high, spec.lr))
    return found


class Unknowns:
    """The unknowns of one scene, and the only writer of the scene's parameters.

    ``leaves``: key → Dr.Jit value that the scene currently uses; after ``attach`` these carry
    gradients, and estimators add to them.
    """

    def __init__(self, params: mi.SceneParameters, items: list[Unknown]):
        self.params, self.items = params, items
        params.keep([u.key for u in items])
        self._templates = {u.key: type(params[u.key])(params[u.key]) for u in items}
        self.leaves = {u.key: params[u.key] for u in items}

    def __iter__(self):
        return iter(self.items)

    @property
    def keys(self) -> list[str]:
        return [u.key for u in self.items]

    def values_of(self, arrays: dict[str, np.ndarray]) -> dict:
        """NumPy arrays by key → Dr.Jit values of the scene's types."""
        return {k: _like(self._templates[k], a) for k, a in arrays.items()}

    def starts(self) -> dict:
        return self.values_of({u.key: u.start for u in self.items})

    def truths(self) -> dict | None:
        if any(u.truth is None for u in self.items):
            return None
        return self.values_of({u.key: u.truth for u in self.items})

    def write(self, values: dict) -> None:
        """Put values into the scene, without derivatives (for evaluation)."""
        for key, value in values.items():
            self.params[key] = dr.detach(value)
        self.params.update()
        self.leaves = {k: self.params[k] for k in self.keys}

    def attach(self, values: dict) -> None:
        """Put values into the scene with fresh derivatives: the next backward pass adds to the
        gradients of ``leaves``. Must stay outside frozen kernels: inside, textures crash.

        While a scene is attached, forward passes through *another* scene of the process fail:
        Dr.Jit's virtual calls reach all materials there are. ``write`` ends it.
        """
        for key, value in values.items():
            leaf = type(value)(dr.detach(value))
            dr.enable_grad(leaf)
            self.params[key] = leaf
        self.params.update()
        self.leaves = {k: self.params[k] for k in self.keys}

    def gradients(self) -> dict:
        """Gradients of the leaves, by key. Read after the frozen call, never returned from it."""
        return {k: dr.grad(v) for k, v in self.leaves.items()}

    def push_tangent(self, values: dict, tangents: dict) -> None:
        """Put values into the scene and push ``tangents`` (same shapes) towards the renderer.

        The edges are cleared on the way: only then may the integrator's loop pick the tangents
        up from the textures' own copies.
        """
        self.attach(values)
        for key, leaf in self.leaves.items():
            dr.set_grad(leaf, tangents[key])
            dr.enqueue(dr.ADMode.Forward, leaf)
        dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearEdges)
