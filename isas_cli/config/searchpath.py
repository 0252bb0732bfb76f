"""Where choices lie: isas's own folder, folders that are named, and those of packages installed
beside isas. Hydra looks there, and so does whoever asks for names."""

from __future__ import annotations

import functools
import importlib.resources
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ..runtime import guests
from ..runtime.errors import InputError

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

OWN = "isas_cli.configs"
# Folders and packages (pkg://NAME) besides these, with commas between. The processes of a sweep
# inherit them so.
VARIABLE = "ISAS_SEARCHPATH"
_PACKAGE, _FOLDER = "pkg://", "file://"
_FLAGS, _SETTING = ("--config-dir", "-cd"), "hydra.searchpath="


@functools.cache
def register() -> None:
    """Tell Hydra, which is imported only where something is composed."""
    from hydra.core.plugins import Plugins
    from hydra.plugins.search_path_plugin import SearchPathPlugin

    class Others(SearchPathPlugin):
        def manipulate_search_path(self, search_path) -> None:
            for place in _others():
                search_path.append("isas", place)

    Plugins.instance().register(Others)


def files(group: str) -> dict[str, "Traversable"]:
    """The YAML file of each choice of a group, by name, in alphabetical order. Raises InputError
    where two places have one of a name, and for a place that is none."""
    found: dict[str, "Traversable"] = {}
    of: dict[str, str] = {}
    for place in (_PACKAGE + OWN, *_others()):
        folder = _opened(place) / group
        for file in folder.iterdir() if folder.is_dir() else ():
            name, dot, ending = file.name.rpartition(".")
            if ending != "yaml" or not name:
                continue
            if name in found:
                raise InputError(
                    f"{group}={name} is in {_named(of[name])} and in {_named(place)}: rename one"
                )
            found[name], of[name] = file, place
    return dict(sorted(found.items()))


@contextmanager
def asked(arguments: list[str]) -> Iterator[list[str]]:
    """Within, folders that ``arguments`` name are looked in as well; the arguments without them.
    Raises InputError for one that is none."""
    rest, places = [], []
    words = iter(arguments)
    for word in words:
        flag, equals, value = word.partition("=")
        if flag in _FLAGS:
            value = value if equals else next(words, "")
            places.append(_place(value, flag))
        elif word.startswith(_SETTING):
            value = word.removeprefix(_SETTING)
            # A folder's own name may end in one.
            listed = (value[1:-1] if value[:1] + value[-1:] == "[]" else value).split(",")
            places += [_place(each.strip().strip("'\""), _SETTING[:-1]) for each in listed if each]
        else:
            rest.append(word)
    before = os.environ.get(VARIABLE)
    try:
        add(places)
        yield rest
    finally:
        if before is None:
            os.environ.pop(VARIABLE, None)
        else:
            os.environ[VARIABLE] = before


def add(places: list[str]) -> None:
    """Look in these as well, as long as ``asked`` lasts."""
    found = [*(each for each in places if each not in typed()), *typed()]
    if found:
        os.environ[VARIABLE] = ",".join(found)


def typed() -> list[str]:
    """The folders and packages that were named."""
    return [each for each in os.environ.get(VARIABLE, "").split(",") if each]


def words() -> list[str]:
    """The same, as they are typed."""
    return [f"{_SETTING}[{','.join(typed())}]"] if typed() else []


def _place(text: str, where: str) -> str:
    """A folder, whole, or ``pkg://NAME``. Raises InputError."""
    if not text.startswith(_PACKAGE):
        text = text and str(Path(os.path.expanduser(text.removeprefix(_FOLDER))).resolve())
    try:
        there = bool(text) and _opened(text).is_dir()
    except InputError:
        there = False
    if not there or "," in text:
        raise InputError(
            f"{where}={text}: no such folder: give one that holds folders of YAML files, such as "
            "sampler, loss or scene, and has no comma in its name"
        )
    return text


def _others() -> Iterable[str]:
    """As Hydra takes them."""
    for place in typed():
        yield place if place.startswith(_PACKAGE) else _FOLDER + place
    for point in guests.points(guests.CONFIGS):
        yield _PACKAGE + point.value


def _opened(place: str) -> "Traversable":
    if not place.startswith(_PACKAGE):
        return Path(place.removeprefix(_FOLDER))
    name = place.removeprefix(_PACKAGE)
    try:
        return importlib.resources.files(name)
    except (ImportError, TypeError, ValueError) as error:
        raise InputError(f"{_named(place)}: cannot be imported: {error}") from error


def _named(place: str) -> str:
    """A place in words."""
    name = place.removeprefix(_PACKAGE)
    if name == OWN:
        return "isas itself"
    point = next((p for p in guests.points(guests.CONFIGS) if p.value == name), None)
    return guests.told(point) if point and place != name else place.removeprefix(_FOLDER)
