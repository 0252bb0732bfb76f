"""Packages that are installed beside isas and bring parts of their own.

They say so by entry points: of the group ``isas.configs``, whose value is a package of YAML files
in folders like those of ``configs/`` (sampler, estimator, loss, prior, filter, effects, scene); of
``isas.kinds``, a class of unknowns (``unknowns.kind.Kind``); of ``isas.cameras``, a module that
reads cameras as those of ``scene/photos`` do. Who installs a package trusts it: what a
configuration names of a guest's modules is imported.
"""

from __future__ import annotations

import functools
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from .errors import InputError

CONFIGS, KINDS, CAMERAS = GROUPS = ("isas.configs", "isas.kinds", "isas.cameras")


@functools.cache
def points(group: str) -> tuple[EntryPoint, ...]:
    """In the order of their names, so that machines agree."""
    return tuple(sorted(entry_points(group=group), key=lambda point: (point.name, point.value)))


def packages() -> list[str]:
    """The packages that guests are made of, by their topmost names."""
    return sorted({p.value.partition(":")[0].partition(".")[0] for g in GROUPS for p in points(g)})


def installed() -> dict[str, str]:
    """Version by name of what is installed."""
    found = (point.dist for group in GROUPS for point in points(group))
    return {dist.name: dist.version for dist in found if dist is not None}


def loaded(group: str) -> list[Any]:
    """What the entry points of a group name. Raises InputError for one that cannot be imported."""
    found = []
    for point in points(group):
        try:
            found.append(point.load())
        except Exception as error:  # whatever the guest's own code raises
            raise InputError(f"{told(point)}: cannot be imported: {error}") from error
    return found


def told(point: EntryPoint) -> str:
    """Whose it is, for messages."""
    whose = f"{point.dist.name} {point.dist.version}" if point.dist else "an installed package"
    return f"{whose}: entry point {point.name} of {point.group} ({point.value})"
