"""What a setting is to a run, told once, beside the setting itself: field metadata of the schema.

Comparing, resuming, racing and naming a sweep's folders all ask here.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import typing
from dataclasses import dataclass, field
from typing import Any

from ..runtime.errors import InputError


class Role(enum.Enum):
    """PROBLEM: what is to be found, and from what. METHOD: how; runs that differ in one of these
    are different methods. SEED: which random numbers. RECORD: what is measured, pictured and said,
    which changes no result. PLACE: where, how fast and under what name it is computed."""

    PROBLEM = "problem"
    METHOD = "method"
    SEED = "seed"
    RECORD = "record"
    PLACE = "place"


@dataclass(frozen=True)
class Meaning:
    """``role``; ``resumes``: a continued run may change it; ``shared``: the contestants of a race
    cannot differ in it; ``looped``: it means something to a run only, not to measurements at a
    fixed point."""

    role: Role
    resumes: bool = False
    shared: bool = False
    looped: bool = False


# Hydra's own settings; and what no field of the schema knows, such as a setting of another version:
# whoever compares must see it.
_HYDRA, _STRANGE = Meaning(Role.PLACE, shared=True), Meaning(Role.METHOD)


def setting(default: Any, role: Role, **more: bool) -> Any:
    """A field of the schema with its ``Meaning``. ``default``: a value, or what makes one."""
    metadata = {"meaning": Meaning(role, **more)}
    if callable(default):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


def meaning(key: str) -> Meaning:
    """Of a setting, ``optimizer.lr`` or ``scene.unknowns.jar.bsdf.base_color.data.lr``: what the
    innermost field says that says anything."""
    from .schema import Config

    table = _table(Config)
    found = [pattern for pattern in table if _matches(pattern, key)]
    if not found:
        return _HYDRA if key.partition(".")[0] == "hydra" else _STRANGE
    return table[max(found, key=len)]


def resuming() -> list[str]:
    """The settings that a continued run may change."""
    from .schema import Config

    return [key for key, meant in _table(Config).items() if meant.resumes]


def _matches(pattern: str, key: str) -> bool:
    group, star, name = pattern.partition(".*.")
    if not star:
        return key == pattern or key.startswith(f"{pattern}.")
    # Names of unknowns hold dots.
    return key.startswith(f"{group}.") and f".{name}." in f"{key}."


@functools.cache
def _table(schema: type, prefix: str = "") -> dict[str, Meaning]:
    found = {}
    hints = typing.get_type_hints(schema)
    for each in dataclasses.fields(schema):
        key = prefix + each.name
        if "meaning" in each.metadata:
            found[key] = each.metadata["meaning"]
        kind, named = hints[each.name], ""
        if typing.get_origin(kind) is dict:
            kind, named = typing.get_args(kind)[1], ".*"
            kind = next(iter(typing.get_args(kind)), kind)  # of an optional one
        if dataclasses.is_dataclass(kind):
            found |= _table(kind, f"{key}{named}.")
    return found


def at_least(least: int, **values: int | None) -> None:
    """Refuse values below ``least``; names are the settings', with __ for a dot."""
    for name, value in values.items():
        if value is not None and value < least:
            raise InputError(f"{name.replace('__', '.')}={value}: at least {least}")
