"""Unknowns and poses of a scene that are taken out of it by ``~``, Hydra's sign for that.

Hydra's own grammar cannot name them, as their names hold dots, and a field of the schema cannot be
deleted. So what is taken out is null in what Hydra composes, and goes afterwards.
"""

from __future__ import annotations

import re

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, open_dict

from ..runtime.errors import InputError, nearest
from .grammar import decoded, literal
from .method import options, said

# What holds names of its own, and one of them in words.
SETTINGS = {"scene.unknowns": "unknown", "scene.poses": "pose"}
# Also as in Python: ~scene.unknowns["sky.data"]; and from a race's contestant, which has a value.
_DROPPED = re.compile(r"""~(scene\.\w+)(?:\.|\[)?(["']?)(.*?)\2\]?(?:=null|=)?""")


def translated(text: str) -> str | None:
    """What is typed, ``~scene.unknowns`` or ``~scene.unknowns.sky.data``, for ``expanded``; None
    where it is nothing of the kind."""
    found = _DROPPED.fullmatch(text)
    if not found or found[1] not in SETTINGS:
        return None
    return f"++{found[1]}={literal({found[3]: None})}" if found[3] else f"~{found[1]}"


def expanded(overrides: list[str]) -> list[str]:
    """Overrides in Hydra's grammar, with the name of each that goes. Raises InputError for one
    that is not there, unless Hydra has more to say: that there is no such scene."""
    scene = next((o.partition("=")[2] for o in overrides[::-1] if o.startswith("scene=")), "")
    present = {setting: list(said(scene, setting.partition(".")[2])) for setting in SETTINGS}
    found = []
    for text in overrides:
        setting = text.lstrip("+~").partition("=")[0]
        if setting not in SETTINGS:
            found.append(text)
        elif text.startswith("~"):
            if present[setting]:
                found.append(f"{setting}={literal(dict.fromkeys(present[setting]))}")
            present[setting] = []
        else:
            found.append(text)
            for name, value in _entries(text).items():
                if value is None and scene in options("scene"):
                    _check(setting, name, present[setting])
                    present[setting].remove(name)
                elif name not in present[setting]:
                    present[setting].append(name)
    return found


def settled(cfg: DictConfig) -> DictConfig:
    """``cfg`` without what is null in it; a pose goes with its unknown. Names are as they were
    typed."""
    with open_dict(cfg):
        for entries in (cfg.scene.unknowns, cfg.scene.poses, cfg.scene.external.parameters):
            for name in [name for name in entries if decoded(str(name)) != name]:
                entries[decoded(name)] = entries.pop(name)
        gone = [name for name, entry in cfg.scene.unknowns.items() if entry is None]
        for entries in (cfg.scene.unknowns, cfg.scene.poses):
            for name in list(entries):
                if name in gone or entries[name] is None:
                    del entries[name]
    return cfg


def _check(setting: str, name: str, present: list[str]) -> None:
    if name not in present:
        raise InputError(
            f"~{setting}.{name}: no such {SETTINGS[setting]}; {nearest(name, present)}"
        )


def _entries(text: str) -> dict:
    """What an override gives, by name; nothing where it is no mapping, which Hydra refuses."""
    try:
        value = OverridesParser.create().parse_override(text).value()
    except HydraException:
        return {}
    given = value if isinstance(value, dict) else {}
    return {decoded(str(getattr(name, "text", name))): entry for name, entry in given.items()}
