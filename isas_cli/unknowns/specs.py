"""What a configuration says of the unknowns, checked against the scene."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mitsuba as mi
import numpy as np

from ..runtime import images
from ..runtime.errors import InputError, nearest
from .parameters import differentiable_keys, is_environment, is_float, loaded, moves_geometry, owner
from .poses import Poses
from .smoothing import stable
from .unknowns import Unknown, present

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


def _start(
    spec, key: str, params: mi.SceneParameters, poses: Poses | None, truth_known: bool
) -> np.ndarray:
    current = present(params, poses, key)
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
        picture = images.read(Path(spec))
        if picture.shape != current.shape:
            raise InputError(
                f"scene.unknowns['{key}'].start: {spec} is {picture.shape}, "
                f"the parameter {current.shape}"
            )
        return picture.astype(np.float32)
    try:
        if isinstance(spec, bool):
            raise TypeError
        return np.broadcast_to(np.asarray(spec, np.float32), current.shape).copy()
    except (ValueError, TypeError):
        raise InputError(
            f"scene.unknowns['{key}'].start={spec} does not fit the parameter's shape "
            f"{current.shape}: give one number, or one per channel"
        ) from None


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
    valid = [k for k in params.keys() if k != key and is_float(params[k])]
    if other not in valid:
        raise InputError(
            f"{where}.of={other}: no other parameter that holds numbers; "
            f"{nearest(str(other), valid)}"
        )
    value = loaded(params, other)
    if value.shape != shape:
        raise InputError(f"{where}: '{other}' is {value.shape}, the parameter {shape}")
    return value


def _range(spec, key: str, params: mi.SceneParameters) -> tuple[float, float]:
    if spec is None and key not in params:  # a pose
        return -np.inf, np.inf
    if spec is None:
        # A light's own numbers ('scale', 'data') have names that say nothing: none is negative.
        light = isinstance(owner(params, key), mi.Emitter)
        default = (0.0 if light else -np.inf, np.inf)
        return next((_RANGES[w] for w in reversed(key.split(".")) if w in _RANGES), default)
    if len(spec) != 2 or not spec[0] < spec[1]:
        raise InputError(
            f"scene.unknowns['{key}'].range={list(spec)}: give [low, high] with low < high"
        )
    return float(spec[0]), float(spec[1])


def narrow_blurs(unknowns: list[Unknown]) -> list[str]:
    """A warning for each unknown whose last blur is narrower than single precision resolves."""
    found = []
    for unknown in (u for u in unknowns if u.blur is not None):
        wanted = np.full(unknown.start.size, unknown.blur.end)
        width = stable(wanted, unknown.start.reshape(-1), unknown.scale).max()
        if width > unknown.blur.end:
            found.append(
                f"scene.unknowns['{unknown.key}'].blur.end={unknown.blur.end:g}: single precision "
                f"resolves no less than {width:.2g} there, which is the width instead"
            )
    return found


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
            if key in params and moves_geometry(params, key):
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
        if key in params and is_environment(params, key) and not start.any():
            raise InputError(
                f"scene.unknowns['{key}'].start: a map that is zero everywhere cannot be sampled; "
                "start above 0"
            )
        if spec.lr is not None and not spec.lr > 0:
            raise InputError(f"scene.unknowns['{key}'].lr={spec.lr}: must be above 0")
        truth = present(params, poses, key) if truth_known else None
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
