"""Scenes that a program describes: builders', and those of photographs."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

from ..config.schema import SceneConfig
from ..runtime import allowed
from ..runtime.errors import InputError, nearest
from . import instances
from .photos import building
from .photos.photographs import Photographs


def description(scene: SceneConfig, taken: Photographs | None = None) -> dict[str, Any]:
    """As ``mitsuba.load_dict`` takes it. ``taken``: the photographs, where the scene is of some.
    Raises InputError for a builder that is not there, and for arguments that are not its own."""
    if taken is not None:
        return building.description(taken, scene.max_depth)
    build = allowed.named(scene.builder, "isas_cli.scenes", "scene.builder")
    _check_arguments(scene, build)
    dictionary = build(**scene.arguments)
    if scene.max_depth is not None:
        integrator = dictionary.get("integrator", {"type": "prb"})
        dictionary["integrator"] = {**integrator, "max_depth": scene.max_depth}
    return dictionary


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
    kinds = typing.get_type_hints(build)
    wanted = inspect.signature(build).parameters
    for name, value in scene.arguments.items():
        if name not in wanted:
            raise InputError(f"scene.arguments.{name}: no such argument; {nearest(name, wanted)}")
        kind = kinds.get(name)
        if kind is int and (not isinstance(value, int) or isinstance(value, bool) or value < 1):
            raise InputError(f"scene.arguments.{name}={value}: a whole number, at least 1")
    for name, parameter in wanted.items():
        if name not in scene.arguments and parameter.default is parameter.empty:
            raise InputError(f"scene.arguments.{name} is missing: {scene.builder} needs it")
