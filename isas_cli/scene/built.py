"""Scenes that a program describes: builders', and those of photographs."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

from ..config.schema import SceneConfig
from ..runtime import allowed, backend
from ..runtime.errors import InputError, nearest
from . import instances
from .photos import building
from .photos.photographs import Photographs


def description(scene: SceneConfig, taken: Photographs | None = None) -> dict[str, Any]:
    """As ``mitsuba.load_dict`` takes it. ``taken``: the photographs, where the scene is of some.
    Raises InputError for a builder that is not there or gives no scene, and for arguments that are
    not its own."""
    backend.look_beside()
    if taken is not None:
        return building.description(taken, scene.max_depth)
    build = allowed.named(scene.builder, "isas_cli.scenes", "scene.builder")
    _check_arguments(scene, build)
    made = build(**scene.arguments)
    if not isinstance(made, dict) or made.get("type") != "scene":
        raise InputError(
            f"scene.builder={scene.builder}: gives no scene: it is to return a dictionary of type "
            "'scene', as mitsuba.load_dict takes it"
        )
    if scene.max_depth is None:
        return made
    integrator = made.get("integrator", {"type": "prb"})
    if not isinstance(integrator, dict):
        raise InputError(
            f"scene.max_depth={scene.max_depth}: scene.builder={scene.builder} has made its "
            "integrator already: it is to give a dictionary that describes it"
        )
    return {**made, "integrator": {**integrator, "max_depth": scene.max_depth}}


def told(value: Any) -> str:
    """What a description says beside its arrays, which are parameters: a text."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {told(each)}" for key, each in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(told, value)) + "]"
    if isinstance(value, (str, int, float, bool, type(None))):
        return repr(value)
    if hasattr(value, "matrix"):  # a transformation
        return str(np.array(value.matrix, np.float64).tolist())
    return type(value).__name__


def load(dictionary: dict[str, Any]) -> mi.Scene:
    """Nothing is merged: two materials that start equal stay two unknowns."""
    settings = mi.parser.ParserConfig(mi.variant())
    settings.merge_equivalent = settings.merge_meshes = False
    state = mi.parser.parse_dict(settings, dictionary)
    instances.in_floats(state)
    return instances.instantiate(settings, state)[0]


def _check_arguments(scene: SceneConfig, build: Callable) -> None:
    """All that the builder asks for, nothing else, each of its type, whole numbers from 1 on."""
    try:
        kinds = typing.get_type_hints(build)
    except Exception:  # of names that are known inside of it only
        kinds = {}
    every = inspect.signature(build).parameters
    wanted = {n: p for n, p in every.items() if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)}
    takes_any = any(p.kind is p.VAR_KEYWORD for p in every.values())
    for name, value in scene.arguments.items():
        if name not in wanted and not takes_any:
            raise InputError(f"scene.arguments.{name}: no such argument; {nearest(name, wanted)}")
        kind = kinds.get(name)
        if kind is int and (not isinstance(value, int) or isinstance(value, bool) or value < 1):
            raise InputError(f"scene.arguments.{name}={value}: a whole number, at least 1")
    for name, parameter in wanted.items():
        if name not in scene.arguments and parameter.default is parameter.empty:
            raise InputError(f"scene.arguments.{name} is missing: {scene.builder} needs it")
