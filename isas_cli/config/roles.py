"""What a setting is to a run, told once, beside the setting itself: field metadata of the schema.

Comparing, resuming, racing and naming a sweep's folders all ask here.
"""

from __future__ import annotations

import dataclasses
import functools
import typing

from .meanings import Meaning, Role
from .schema import Config

# Hydra's own settings; and what no field of the schema knows, such as a setting of another version:
# whoever compares must see it.
_HYDRA, _STRANGE = Meaning(Role.PLACE, shared=True), Meaning(Role.METHOD)


def meaning(key: str) -> Meaning:
    """Of a setting, ``optimizer.lr`` or ``scene.unknowns.jar.bsdf.base_color.data.lr``: what the
    innermost field says that says anything."""
    table = _table(Config)
    found = [pattern for pattern in table if _matches(pattern, key)]
    if not found:
        return _HYDRA if key.partition(".")[0] == "hydra" else _STRANGE
    return table[max(found, key=len)]


def resuming() -> list[str]:
    """The settings that a continued run may change."""
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
