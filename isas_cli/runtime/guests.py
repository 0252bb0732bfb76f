"""Packages that are installed beside isas and bring parts of their own.

They say so by entry points: of the group ``isas.configs``, whose value is a package of YAML files
in folders like those of ``configs/`` (sampler, estimator, loss, prior, filter, effects, scene); of
``isas.kinds``, a class of unknowns (``unknowns.kind.Kind``); of ``isas.cameras``, a module that
reads cameras as those of ``scene/photos`` do. Who installs a package trusts it: what a
configuration names of a guest's modules is imported. So are modules that ISAS_ALLOW lists.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import os
import sys
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from .errors import InputError

_CODE = "*.py", "*.yaml"
ALLOW = "ISAS_ALLOW"
CONFIGS, KINDS, CAMERAS = GROUPS = ("isas.configs", "isas.kinds", "isas.cameras")


@functools.cache
def points(group: str) -> tuple[EntryPoint, ...]:
    """In the order of their names, so that machines agree."""
    return tuple(sorted(entry_points(group=group), key=lambda point: (point.name, point.value)))


def packages() -> list[str]:
    """The packages that guests are made of, by their topmost names."""
    return sorted({_package(point) for group in GROUPS for point in points(group)})


def listed() -> list[str]:
    """What the environment variable ISAS_ALLOW lists, modules and programs, as it stands there."""
    return [each.strip() for each in os.environ.get(ALLOW, "").split(",")]


def installed() -> dict[str, str]:
    """Version by name of what is installed, with the code's own digest, ``0.1+3fa92c1d``: who works
    on a package does not give each change a version. The digest alone of what ISAS_ALLOW lists and
    this process has imported."""
    found: dict[str, tuple[str, set[str]]] = {}
    for point in (point for group in GROUPS for point in points(group)):
        if point.dist is not None:
            _, packages = found.setdefault(point.dist.name, (point.dist.version, set()))
            packages.add(_package(point))
    told = {
        name: (version, "".join(map(_digest, sorted(of)))) for name, (version, of) in found.items()
    }
    tops = sorted({name.partition(".")[0] for name in listed()} & {*sys.modules})
    own = {name: digest for name in tops if (digest := _digest(name))}
    return own | {name: "+".join(filter(None, both)) for name, both in told.items()}


def _package(point: EntryPoint) -> str:
    return point.value.partition(":")[0].partition(".")[0]


@functools.cache
def _digest(package: str) -> str:
    """Of its code and configurations as this process found them; empty where it has no files."""
    try:
        spec = importlib.util.find_spec(package)
    except (ImportError, ValueError):
        spec = None
    if spec is None:
        return ""
    files = [Path(spec.origin)] if spec.origin and not spec.submodule_search_locations else []
    for folder in spec.submodule_search_locations or ():
        files += (file for ending in _CODE for file in Path(folder).rglob(ending))
    hashed = hashlib.blake2b(digest_size=4)
    for file in sorted(files):
        with contextlib.suppress(OSError):  # an editor's link to nothing
            hashed.update(file.name.encode() + file.read_bytes())
    return hashed.hexdigest()


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
