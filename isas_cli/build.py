"""From a configured scene to a ``Problem``."""

from __future__ import annotations

import hashlib
import importlib
from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from . import coverage, scene_file, targets
from .config import SceneConfig, TargetConfig
from .errors import InputError
from .pixels import Views
from .problem import Problem
from .unknowns import Unknowns, as_numpy, parse

def problem(
    scene: SceneConfig,
    target: TargetConfig,
    seed: int,
    progress: Callable[[int, int], None],
    phase: Callable[[str], None] = lambda name: None,
) -> Problem:
    """Load the scene, check its unknowns, find out what is seen, get the targets.

    ``phase(name)`` is told when work of another kind begins ('load', 'targets', 'coverage').
    """
    phase("load")
    if scene.path is not None:
        loaded, integrator = scene_file.load(scene.path, scene.max_depth)
    else:
        loaded = _from_builder(scene)
        integrator = loaded.integrator()
    sensors = loaded.sensors()
    if not sensors:
        raise InputError(f"scene {scene.name} has no sensor: add at least one camera")
    sizes = [tuple(int(x) for x in s.film().crop_size()) for s in sensors]
    params = mi.traverse(loaded)
    content = _content_hash(loaded, integrator, params)
    photographs = scene.targets is not None
    found = parse(params, scene.unknowns, truth_known=not photographs)
    # Traversed anew: reading a parameter marks it as a candidate for an update.
    unknowns = Unknowns(mi.traverse(loaded), found)
    result = Problem(
        scene.name,
        loaded,
        integrator,
        loaded.sensors_dr(),
        sizes,
        Views.of(sizes),
        unknowns,
        content,
    )
    phase("targets")
    if photographs:
        result.set_targets(*targets.load(result, scene.targets, scene.masks))
    else:
        if scene.masks is not None:
            raise InputError("scene.masks needs scene.targets: rendered targets have no masks")
        rendered, digest = targets.render(result, target.spp, target.seed, progress)
        result.set_targets(rendered, None, digest)
    phase("coverage")
    coverage.fill_in(result, seed)
    return result


def _from_builder(scene: SceneConfig) -> mi.Scene:
    module, _, function = scene.builder.rpartition(".")
    try:
        build = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"scene.builder={scene.builder}: cannot be imported ({error})") from error
    for name, value in scene.arguments.items():
        if isinstance(value, int) and not isinstance(value, bool) and value < 1:
            raise InputError(f"scene.arguments.{name}={value}: at least 1")
    try:
        dictionary = build(**scene.arguments)
    except TypeError as error:
        raise InputError(f"scene.arguments do not fit {scene.builder}: {error}") from error
    # Merging equal materials would turn two unknowns with equal starts into one.
    return mi.load_dict(dictionary, optimize=False)


def _content_hash(scene: mi.Scene, integrator, params: mi.SceneParameters) -> str:
    """Hash of what a rendering depends on: the scene's description and all its arrays."""
    hashed = hashlib.blake2b(digest_size=16)
    hashed.update(str(scene).encode())
    hashed.update(str(integrator).encode())
    for key in sorted(params.keys()):
        value = params[key]
        hashed.update(key.encode())
        if dr.is_array_v(value) and not dr.is_special_v(value):
            hashed.update(np.ascontiguousarray(np.array(value)).tobytes())
        else:
            hashed.update(str(value).encode())
    return hashed.hexdigest()
