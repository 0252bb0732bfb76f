"""What every format of cameras is turned into, and what their readers share.

A format is a module with ``find(folder)``, the file that says that a folder is of it, or None,
``claims(file)``, whether a file is of it, and ``read(file, asked)``, the ``Capture`` that it
describes. Both ``read`` and, where it has to look into files, ``find`` raise InputError.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ...runtime.errors import InputError
from .camera import Camera


@dataclass
class Capture:
    """``cameras``: at least one, each of another picture; ``points (P, 3)``: places of the scene
    that are known, or None; ``observed``: by view, the numbers of those points that were found in
    it and where, ``(K,)`` and ``(K, 2)`` pixels as ``Camera`` counts them; ``plane``: a known
    rectangle of the plane z = 0, [x0, y0, x1, y1], or None; ``kind``: the format, in words;
    ``held``: names of the views that the files hold out; ``notes``: what was chosen or changed on
    the way, a sentence each; ``worlds``: whether the file tells of another world than that of its
    poses, so that ``photos.world`` means something; ``turned``: whether their cameras are
    usually of pictures turned as their Orientation tags ask, not of the pixels as stored."""

    cameras: list[Camera]
    kind: str
    points: np.ndarray | None = None
    observed: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    plane: tuple[float, ...] | None = None
    held: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    worlds: bool = False
    turned: bool = False


@dataclass(frozen=True)
class Asked:
    """``root``: the folder given, in which pictures are looked for; ``given``: whether views that
    the files hold out are looked for; ``world``: ``mesh`` or ``file``, as
    ``photos.world``; ``named``: whether ``photos.cameras`` says which file."""

    root: Path
    given: bool = False
    world: str = "mesh"
    named: bool = False


def read_text(file: Path) -> str:
    """Without the mark that Windows' programs begin it by. Raises InputError."""
    try:
        return file.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read as text: {error}") from error


def load_xml(file: Path, what: str = "XML") -> ElementTree.Element:
    """The root of an XML file, which is called ``what``. Raises InputError."""
    try:
        return ElementTree.fromstring(read_text(file).encode())
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(f"{file}: cannot be read as {what}: {error}") from error


def words(text: str, count: int, where: str) -> list[float]:
    """``count`` finite numbers between blanks. Raises InputError, naming ``where``."""
    found = text.split()
    if len(found) != count:
        raise InputError(f"{where} has {len(found)} numbers, not {count}")
    return [number(word, where) for word in found]


def name_of(image: Path, root: Path) -> str:
    """What the view of a picture is called where no file names it."""
    return image.relative_to(root).as_posix() if root in image.parents else image.name


def load_json(file: Path) -> dict:
    """A JSON file that holds an object. Raises InputError."""
    try:
        found = json.loads(read_text(file))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file}: cannot be read as JSON: {error}") from error
    if not isinstance(found, dict):
        raise InputError(f"{file}: holds no JSON object, which a list of cameras is")
    return found


def objects(entry: dict, name: str, where: str) -> list[dict]:
    """A list of JSON objects, none where it is missing or, as boost writes it, "". Raises
    InputError, naming ``where``."""
    found = entry.get(name) or []
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise InputError(f"{where}: {name} is no list of JSON objects")
    return found


def inside(entry: dict, where: str, *names: str) -> dict:
    """The JSON object under ``names``, one within the other. Raises InputError, naming
    ``where``."""
    for name in names:
        entry = entry.get(name)
        if not isinstance(entry, dict):
            raise InputError(f"{where}: has no {name}")
    return entry


def number(value, where: str) -> float:
    """A finite number. Raises InputError, naming ``where``."""
    try:
        if isinstance(value, bool):
            raise TypeError
        found = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{where}={value!r}: no number") from None
    if not math.isfinite(found):
        raise InputError(f"{where}={found}: must be a finite number")
    return found


def numbers(values, count: int, where: str) -> tuple[float, ...]:
    """A list of ``count`` finite numbers. Raises InputError, naming ``where``."""
    if not isinstance(values, list) or len(values) != count:
        raise InputError(f"{where}={values!r}: no list of {count} numbers")
    return tuple(number(value, where) for value in values)


def exposure(entry: dict, where: str) -> tuple[float, ...]:
    """``exposure`` of a view's entry, a number or one a channel, as ``(3,)``; 1 where it has none.
    Raises InputError, naming ``where``, for what is not above 0."""
    value, where = entry.get("exposure", 1.0), f"{where}: exposure"
    found = numbers(value, 3, where) if isinstance(value, list) else (number(value, where),) * 3
    if not min(found) > 0:
        raise InputError(f"{where}={value}: must be above 0")
    return found


def whole(value, where: str) -> int:
    """A whole number, at least 1. Raises InputError, naming ``where``."""
    found = number(value, where)
    if found != int(found) or found < 1:
        raise InputError(f"{where}={value}: a whole number of pixels, at least 1")
    return int(found)


def matrix(value, where: str) -> np.ndarray:
    """A ``(4, 4)`` matrix (a last row that is missing is 0, 0, 0, 1). Raises InputError."""
    try:
        found = np.asarray(value, np.float64)
        if found.shape == (3, 4):
            found = np.vstack([found, [0, 0, 0, 1]])
        if found.shape != (4, 4):
            raise ValueError
    except (TypeError, ValueError):
        raise InputError(f"{where}: no matrix of 4 rows of 4 numbers") from None
    if not np.isfinite(found).all():
        raise InputError(f"{where}: holds NaN or infinite numbers: mend or remove this view")
    return found


def claimed(file: Path, claims: Callable[[Path], bool]) -> bool:
    """Whether a reader ``claims`` a file; one that cannot be read is nobody's."""
    try:
        return claims(file)
    except InputError:
        return False


def lone(folder: Path, found: list[Path], what: str) -> Path | None:
    """The one of the files ``found``. Raises InputError for several, all of which are ``what``."""
    if len(found) > 1:
        raise InputError(
            f"{folder}: {' and '.join(file.name for file in found)} are all {what}: "
            f"photos.cameras={found[0].name} takes one"
        )
    return found[0] if found else None
