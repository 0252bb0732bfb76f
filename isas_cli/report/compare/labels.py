"""What a method is called: its sampler, and the settings in which it differs from others."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Container, Sequence
from typing import Any

from ...config.roles import Role, meaning
from ...records import safe_name

_UNSET = "unset"
# Characters of a setting, such as a list of files, in a name; and of a file's name.
_LONG, _FILE = 60, 120

Settings = dict[str, str]


def flatten(config: dict[str, Any], prefix: str = "") -> Settings:
    """``{"optimizer": {"lr": 0.01}}`` → ``{"optimizer.lr": "0.01"}``.

    Equal values have equal texts (20 and 20.0 too), so that settings can be compared and shown.
    """
    flat: Settings = {}
    for key, value in config.items():
        if isinstance(value, dict):
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = _text(value)
    return flat


def _text(value: Any) -> str:
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)


def split(flat: Settings) -> tuple[Settings, Settings]:
    """Settings of the problem (which scene, size, targets, starts) and of the method."""
    problem, method = {}, {}
    for key, value in flat.items():
        role = meaning(key).role
        if role is Role.PROBLEM:
            problem[key] = value
        elif role is Role.METHOD:
            method[key] = value
    return problem, method


def methods(settings: Sequence[Settings]) -> list[str]:
    """A label for each of different settings, such as ``ours optimizer.lr=0.01``.

    The sampler's name, then each setting that differs, whether it alone tells methods apart or
    not: whoever compares must see all that differs. What belongs to a choice with a name (a
    sampler, a loss) is compared only among those that made the same choice, as others have
    settings of their own.
    """
    every = {key for each in settings for key in each}
    # What all have alike, those that made the same choice have alike.
    apart = sorted(k for k in every if len({each.get(k, _UNSET) for each in settings}) > 1)
    labels = []
    for own in settings:
        parts = [_choice(own, "sampler") or "unnamed"]
        for key in apart:
            if key in ("sampler", "sampler.name"):
                continue
            peers = settings
            for group in _groups(key, every):
                peers = [each for each in peers if _choice(each, group) == _choice(own, group)]
            if len({each.get(key, _UNSET) for each in peers}) > 1:
                parts.append(f"{key.removesuffix('.name')}={own.get(key, _UNSET)}")
        labels.append(" ".join(parts))
    return labels


def _groups(key: str, every: Container[str]) -> list[str]:
    """The named choices that a setting belongs to: of ``sampler.base.floor`` the sampler and its
    base."""
    parts = key.removesuffix(".name").split(".")
    groups = (".".join(parts[:end]) for end in range(1, len(parts)))
    return [group for group in groups if f"{group}.name" in every]


def _choice(settings: Settings, group: str) -> str | None:
    return settings.get(f"{group}.name", settings.get(group))


def scenes(name: str, problems: Sequence[Settings]) -> list[str]:
    """A name for each of different problems of one scene, such as ``pottery size=tiny``.

    As few settings as tell them apart, because one (the size) entails others: the first that
    divides them further is added until all differ. ``problems`` hold, last, what always differs.
    """
    keys = dict.fromkeys(
        ["size", *sorted(key for each in problems for key in each if "hash" not in key)]
    )
    keys |= dict.fromkeys(key for each in problems for key in each)
    chosen: list[str] = []
    for key in keys:
        if len(_told_apart(problems, [*chosen, key])) > len(_told_apart(problems, chosen)):
            chosen.append(key)
    return [
        " ".join([name, *(f"{key}={_short(each.get(key, _UNSET), _LONG)}" for key in chosen)])
        for each in problems
    ]


def stem(scene: str) -> str:
    """How the names of files about a scene begin."""
    return _short(safe_name(scene), _FILE)


def _short(text: str, most: int) -> str:
    """``text``, or where it is longer its beginning and what tells it from others."""
    if len(text) <= most:
        return text
    told = hashlib.blake2b(text.encode(), digest_size=4).hexdigest()
    return f"{text[: most - 12]}-{told}"


def _told_apart(problems: Sequence[Settings], keys: list[str]) -> set[tuple[str, ...]]:
    return {tuple(each.get(key, _UNSET) for key in keys) for each in problems}
