"""The unknown parameters: keys, starts, truth, legal ranges, and their place in the scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from . import images
from .config import BlurConfig
from .errors import InputError, nearest
from .poses import Pose, Poses

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
    "irradiance": (0.0, np.inf),
}


@dataclass
class Unknown:
    """One unknown. ``start`` and ``truth`` are float32 arrays of the parameter's shape
    (``truth`` is None for photographs); ``low``, ``high``: legal range, parameter's unit;
    ``lr``: its own learning rate, or None for the optimiser's; ``seen``: which entries some view
    sees (bool, same shape), filled in by ``coverage``; ``blur``: of ``sampler=plateau``, or None;
    ``period``: after which a value means the same again (an angle's 360), or None; ``scale``: the
    size, in the unknown's unit, of what it is added to in the scene."""

    key: str
    start: np.ndarray
    truth: np.ndarray | None
    low: float
    high: float
    lr: float | None
    seen: np.ndarray | None = None
    blur: BlurConfig | None = None
    period: float | None = None
    scale: float = 1.0


def _owner(params: mi.SceneParameters, key: str):
    return params.properties[key][2]


def _is_environment(params: mi.SceneParameters, key: str) -> bool:
    """Whether the parameter is the picture of an environment map."""
    return isinstance(_owner(params, key), mi.Emitter) and dr.is_tensor_v(params[key])


def _moves_geometry(params: mi.SceneParameters, key: str) -> bool:
    """Whether the parameter changes what is visible. Mitsuba's flag alone would not do: it also
    marks roughness, whose lobe is smooth inside the legal range, and environment maps."""
    if isinstance(_owner(params, key), (mi.BSDF, mi.Texture)) or _is_environment(params, key):
        return False
    return bool(params.flags(key) & mi.ParamFlags.Discontinuous)


def _is_float(value) -> bool:
    """Whether it holds floating-point numbers, at least one, and is no matrix."""
    if not (dr.is_array_v(value) and dr.is_float_v(value)):
        return False
    return not dr.is_matrix_v(value) and dr.width(value) > 0


def differentiable_keys(params: mi.SceneParameters) -> list[str]:
    """All keys that path replay can differentiate: floating point, not moving geometry."""
    keys = []
    for key in params.keys():
        if not (_is_float(params[key]) and dr.is_diff_v(params[key])):
            continue
        if isinstance(_owner(params, key), (mi.Sensor, mi.Film)):
            continue
        if params.flags(key) & mi.ParamFlags.NonDifferentiable or _moves_geometry(params, key):
            continue
        keys.append(key)
    return keys


def as_numpy(value) -> np.ndarray:
    """A parameter as a float32 array: tensors keep their shape, colours become (3,)."""
    array = np.asarray(value, dtype=np.float32)
    return array if dr.is_tensor_v(value) else array.reshape(-1)


def _loaded(params: mi.SceneParameters, key: str) -> np.ndarray:
    """The scene's value of a parameter, in the shape that it has as an unknown.

    An environment map of (H, W, 3) texels is kept by Mitsuba as (H, W + 2, 3): its last column
    stands before the first once more, and its first behind the last. Only the W in between are
    unknown (``Unknowns`` puts the others around them).
    """
    array = as_numpy(params[key])
    return array[:, 1:-1].copy() if _is_environment(params, key) else array


def _like(template, array: np.ndarray):
    """``array`` as a Dr.Jit value of the type of ``template``, in memory of its own: frozen kernels
    go on seeing earlier values of a texture of one channel whose memory is NumPy's."""
    kind = type(template)
    if not dr.is_tensor_v(kind) and array.size == dr.size_v(kind) > 1:
        return kind(*[float(x) for x in array])
    entries = mi.Float(np.ascontiguousarray(array.reshape(-1), dtype=np.float32))
    entries = entries + dr.opaque(mi.Float, 0, entries.shape[0])
    dr.eval(entries)
    if dr.is_tensor_v(kind):
        return kind(entries, array.shape)
    return dr.unravel(kind, entries) if dr.size_v(kind) > 1 else kind(entries)


def flat(value) -> mi.Float:
    """All entries of a parameter as one flat array, in Dr.Jit's order. Traced."""
    return value.array if dr.is_tensor_v(value) else dr.ravel(value)


def unflat(template, entries: mi.Float):
    """The inverse of ``flat`` for a parameter of the type and shape of ``template``."""
    if dr.is_tensor_v(template):
        return type(template)(entries, template.shape)
    return dr.unravel(type(template), entries)


def _start(
    spec, key: str, params: mi.SceneParameters, poses: Poses | None, truth_known: bool
) -> np.ndarray:
    current = _present(params, poses, key)
    if spec is None:
        if truth_known:
            raise InputError(
                f"scene.unknowns['{key}'] has no start: without scene.targets the scene's own "
                "value is the truth; give start: a number, a list, an image file or {of: key}"
            )
        return current
    if isinstance(spec, Mapping) and "uniform" in spec:
        return _random_start(spec, key, current.shape)
    if isinstance(spec, Mapping):
        return _start_of_another(spec, key, current.shape, params)
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


def _present(params: mi.SceneParameters, poses: Poses | None, key: str) -> np.ndarray:
    """The value that the scene was loaded with."""
    return poses.items[key].at if poses and key in poses else _loaded(params, key)


def _random_start(spec: Mapping, key: str, shape: tuple[int, ...]) -> np.ndarray:
    """``{uniform: [low, high], seed: n}``: every entry drawn by itself, for trials of starts."""
    where = f"scene.unknowns['{key}'].start={dict(spec)}"
    try:
        low, high = map(float, spec["uniform"])
        rng = np.random.default_rng(spec["seed"])
        if set(spec) != {"uniform", "seed"} or not low < high:
            raise ValueError
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{where}: give {{uniform: [low, high], seed: 1}}, low < high") from None
    return rng.uniform(low, high, shape).astype(np.float32)


def _start_of_another(
    spec: Mapping, key: str, shape: tuple[int, ...], params: mi.SceneParameters
) -> np.ndarray:
    """``{of: other}``: what the scene was loaded with as ``other``, which may be unknown itself."""
    where = f"scene.unknowns['{key}'].start"
    if list(spec) != ["of"]:
        raise InputError(
            f"{where}={dict(spec)}: a mapping is {{of: another key}} or "
            "{uniform: [low, high], seed: 1}"
        )
    other = spec["of"]
    valid = [k for k in params.keys() if k != key and _is_float(params[k])]
    if other not in valid:
        raise InputError(
            f"{where}.of={other}: no other parameter that holds numbers; "
            f"{nearest(str(other), valid)}"
        )
    value = _loaded(params, other)
    if value.shape != shape:
        raise InputError(f"{where}: '{other}' is {value.shape}, the parameter {shape}")
    return value


def _range(spec, key: str, params: mi.SceneParameters) -> tuple[float, float]:
    if spec is None and key not in params:  # a pose
        return -np.inf, np.inf
    if spec is None:
        # A light's own numbers ('scale', 'data') have names that say nothing: none is negative.
        light = isinstance(_owner(params, key), mi.Emitter)
        default = (0.0 if light else -np.inf, np.inf)
        return next((_RANGES[w] for w in reversed(key.split(".")) if w in _RANGES), default)
    if len(spec) != 2 or not spec[0] < spec[1]:
        raise InputError(
            f"scene.unknowns['{key}'].range={list(spec)}: give [low, high] with low < high"
        )
    return float(spec[0]), float(spec[1])


def parse(
    params: mi.SceneParameters, specs: dict, truth_known: bool, poses: Poses | None = None
) -> list[Unknown]:
    """Check the configured unknowns against the scene and read starts and truths.

    ``specs``: key → object with ``start``, ``range``, ``lr``, ``blur`` (``config.UnknownConfig``).
    Raises InputError for an unknown key (nearest and all differentiable ones listed), for one
    that moves geometry, an illegal range, a start outside it, or when there is no unknown.
    """
    valid = [*(poses.items if poses else ()), *differentiable_keys(params)]
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
                    "not differentiate; move the object by scene.poses and sampler=plateau; "
                    f"valid: {', '.join(valid)}"
                )
            raise InputError(
                f"scene.unknowns: '{key}' is no differentiable parameter; {nearest(key, valid)}"
            )
        start = _start(spec.start, key, params, poses, truth_known)
        low, high = _range(spec.range, key, params)
        if not np.all(np.isfinite(start)) or start.min() < low or start.max() > high:
            raise InputError(
                f"scene.unknowns['{key}'].start lies outside its range [{low:g}, {high:g}]"
            )
        if key in params and _is_environment(params, key) and not start.any():
            raise InputError(
                f"scene.unknowns['{key}'].start: a map that is zero everywhere cannot be sampled; "
                "start above 0"
            )
        if spec.lr is not None and not spec.lr > 0:
            raise InputError(f"scene.unknowns['{key}'].lr={spec.lr}: must be above 0")
        truth = _present(params, poses, key) if truth_known else None
        if truth is not None and (truth.min() < low or truth.max() > high):
            raise InputError(
                f"scene.unknowns['{key}']: the scene's own value, the truth, is outside its range "
                f"[{low:g}, {high:g}]; give a range that holds it"
            )
        found.append(Unknown(key, start, truth, low, high, spec.lr, blur=spec.blur))
        if poses and key in poses:
            found[-1].period = poses.items[key].period
            found[-1].scale = poses.scale(key)
    for name in poses.items if poses else ():
        if name not in specs:
            raise InputError(
                f"scene.poses['{name}'] is not among scene.unknowns: give it a start there, or "
                "leave it out"
            )
    return found


def textures(params: mi.SceneParameters, keys: list[str]) -> dict[str, mi.Texture]:
    """Of ``keys``, those of texels laid out on a surface, with the texture that holds them."""
    tensors = [key for key in keys if key in params and dr.is_tensor_v(params[key])]
    owners = {key: _owner(params, key) for key in tensors}
    return {key: owner for key, owner in owners.items() if isinstance(owner, mi.Texture)}


class Unknowns:
    """The unknowns of one scene, and the only writer of the scene's parameters.

    ``leaves``: key → Dr.Jit value that the scene currently uses; after ``attach`` these carry
    gradients, and estimators add to them. (Of an environment map: the value that the scene's own
    is made from. Mitsuba makes it once more at each update, and only gradients at its origin stay.
    Likewise of a pose.)
    """

    def __init__(
        self, params: mi.SceneParameters, items: list[Unknown], poses: Poses | None = None
    ):
        self.params, self.items, self._poses = params, items, poses
        present = {u.key: _present(params, poses, u.key) for u in items}
        self.poses = [u.key for u in items if poses and u.key in poses]
        own = [u.key for u in items if u.key not in self.poses]
        params.keep([*own, *(poses.keys(self.poses) if self.poses else ())])
        self._templates = {key: type(params[key])(params[key]) for key in own}
        self._templates |= {key: mi.Float(0) for key in self.poses}
        self._shapes = {key: params[key].shape for key in own if _is_environment(params, key)}
        self._around = {key: _wrapped(shape) for key, shape in self._shapes.items()}
        self.leaves = self.values_of(present)

    @property
    def moved(self) -> set[str]:
        """Ids of the objects that poses among the unknowns move."""
        return {id for key in self.poses for id in self._poses.items[key].ids}

    def place(self, key: str, where: str) -> tuple[Pose, np.ndarray]:
        """The translation ``key`` and where its parts were loaded (``Poses.middles``); raises
        InputError, naming ``where``, if it is none."""
        if key not in self.poses:
            raise InputError(f"{where}: only for what a pose moves")
        return self._poses.items[key], self._poses.middles(key, where)

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
        self._update({key: dr.detach(value) for key, value in values.items()})

    def attach(self, values: dict) -> None:
        """Put values into the scene with fresh derivatives: the next backward pass adds to the
        gradients of ``leaves``. Must stay outside frozen kernels: inside, textures crash.

        While a scene is attached, forward passes through *another* scene of the process fail:
        Dr.Jit's virtual calls reach all materials there are. ``write`` ends it.
        """
        leaves = {key: type(value)(dr.detach(value)) for key, value in values.items()}
        dr.enable_grad(leaves)
        self._update(leaves)

    def _update(self, leaves: dict) -> None:
        origins = self.leaves | leaves
        for key, leaf in leaves.items():
            if key in self._around:
                entries = dr.gather(mi.Float, leaf.array, self._around[key])
                self.params[key] = type(leaf)(entries, self._shapes[key])
            elif key not in self.poses:
                self.params[key] = leaf
        if self.poses:
            placed = self._poses.placed({key: origins[key] for key in self.poses})
            dr.eval(placed)
            for key, value in placed.items():
                self.params[key] = value
        self.params.update()
        derived = [*self._around, *self.poses]
        self.leaves = {k: origins[k] if k in derived else self.params[k] for k in self.keys}

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


def _wrapped(shape: tuple[int, int, int]) -> mi.UInt32:
    """For each entry of an environment map of ``shape (H, W + 2, C)``: which entry of the
    (H, W, C) texels stands there."""
    height, width, channels = shape
    texels = np.arange(height * (width - 2) * channels, dtype=np.uint32)
    texels = texels.reshape(height, width - 2, channels)
    return mi.UInt32(np.pad(texels, ((0, 0), (1, 1), (0, 0)), mode="wrap").ravel())
