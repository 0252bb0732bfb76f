"""The roles that settings can have, and how a field of the schema says its own."""

from __future__ import annotations

import enum
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


def setting(default: Any, role: Role, **more: bool) -> Any:
    """A field of the schema with its ``Meaning``. ``default``: a value, or what makes one."""
    metadata = {"meaning": Meaning(role, **more)}
    if callable(default):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


def at_least(least: int, **values: int | None) -> None:
    """Refuse values below ``least``; names are the settings', with __ for a dot."""
    for name, value in values.items():
        if value is not None and value < least:
            raise InputError(f"{name.replace('__', '.')}={value}: at least {least}")
