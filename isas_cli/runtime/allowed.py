"""Which code a configuration may name. Importing a module runs it, so a configuration that somebody
else wrote, or a record, must not choose what is imported, nor which program is run."""

from __future__ import annotations

import importlib
import shlex
import sys
from pathlib import Path

from . import guests
from .errors import InputError
from .guests import ALLOW, listed


def named(path: str, own: str, where: str):
    """The object at the dotted ``path``, defined in a module below the package ``own``, or in one
    that is installed as a guest of isas (``guests``), or that the environment variable ISAS_ALLOW
    lists (names, with commas between), installed or in the present folder. ``where``: the setting.
    Raises InputError."""
    module, _, name = str(path).rpartition(".")
    others = [*listed(), *guests.packages()]
    if not _below(module, [own, *others]):
        raise InputError(
            f"{where}={path}: would import code that is not isas's own: set {ALLOW}="
            f"{module or path} in the environment if you trust it"
        )
    here = str(Path.cwd())
    if not _below(module, [own]) and here not in sys.path:
        sys.path.append(here)  # last, so that it takes no other module's place
    try:
        found = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"{where}={path}: cannot be imported ({error})") from error
    # What a module imports is not its own: `os.system` by way of any module that uses it.
    if not _below(getattr(found, "__module__", ""), [own, *others]):
        raise InputError(f"{where}={path}: names what another module defines; name that one")
    return found


def program(name: str, where: str) -> None:
    """Raises InputError for a program that ISAS_ALLOW does not list by this name."""
    if name not in listed():
        raise InputError(
            f"{where}: would run a program: set {ALLOW}={shlex.quote(name)} in the "
            "environment if you trust it"
        )


def _below(module: str, packages: list[str]) -> bool:
    return any(each and f"{module}.".startswith(f"{each}.") for each in packages)
