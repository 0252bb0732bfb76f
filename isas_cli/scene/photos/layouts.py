"""Where people have COLMAP's models and their pictures."""

from __future__ import annotations

import importlib.util
import struct
from pathlib import Path

# In this order; at a star are the numbers of several models.
_PLACES = (
    *("", "sparse/*", "sparse", "colmap/sparse/*", "colmap/sparse", "colmap"),
    *("dense/sparse", "dense/*/sparse", "dense", "*/sparse", "*"),
)
_NAMES = ("sparse", "colmap", "dense")


def chosen(folder: Path) -> tuple[Path | None, list[tuple[Path, int]]]:
    """The cameras of the model to take, of those in the first place that has any that with the
    most images; and all of that place, with how many images each has (-1: not counted)."""
    for place in _PLACES:
        found = [(file, -1) for file in _models(folder, place)]
        if len(found) > 1:
            found = [(file, images(file)) for file, _ in found]
        if found:
            return max(found, key=lambda each: each[1])[0], found  # of those alike, the first
    return None, []


def _models(folder: Path, place: str) -> list[Path]:
    if "*" not in place:
        folders = [folder / place]
    else:
        # Numbers in their order, which is not that of letters.
        numbers = [p for p in folder.glob(place) if p.relative_to(folder).parts[-1] and _of(p)]
        folders = sorted(numbers, key=lambda p: (len(_of(p)), _of(p)))
    files = [_file(each) for each in folders]
    return [file for file in files if file is not None]


def _of(path: Path) -> str:
    """The number that a folder of a model stands under; empty where there is none."""
    name = path.parent.name if path.name == "sparse" else path.name
    return name if name.isdigit() else ""


def _file(folder: Path) -> Path | None:
    """Its cameras: binary where both are whole, as COLMAP reads it, if it can be read here."""
    files = [folder / f"cameras.{ending}" for ending in ("bin", "txt")]
    files = [file for file in files if file.is_file()]
    whole = [
        file
        for file in files
        if all(file.with_name(f"{name}{file.suffix}").is_file() for name in ("images", "points3D"))
    ]
    if len(whole) == 2 and importlib.util.find_spec("pycolmap") is None:
        return whole[1]
    return (whole or files or [None])[0]


def around(place: Path) -> list[Path]:
    """The folder of a model, or of a file of it, and those around it up to the set's own, as far as
    they are called as people call them."""
    found = [place.parent if place.is_file() else place]
    while found[-1].name.isdigit() or found[-1].name in _NAMES:
        found.append(found[-1].parent)
    return found


def images(file: Path) -> int:
    """How many a model has; 0 where that cannot be told."""
    listed = file.with_name(f"images{file.suffix}")
    try:
        if file.suffix == ".bin":
            with open(listed, "rb") as opened:
                return int(struct.unpack("<Q", opened.read(8))[0])
        lines = listed.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError, struct.error):
        return 0
    count, lines = 0, (line for line in lines if not line.startswith("#"))
    for line in lines:
        if line.strip():
            count += 1
            next(lines, None)  # its points
    return count


def notes(model: Path, root: Path) -> list[str]:
    """What to say of a ``model`` that was taken from ``root`` although there are more."""
    file, found = chosen(root)
    if file is None or file.parent != model:
        return []
    both = [model / f"{name}.{end}" for name in ("cameras", "images") for end in ("bin", "txt")]
    if all(each.is_file() for each in both):
        other = model / f"cameras{'.txt' if file.suffix == '.bin' else '.bin'}"
        return [
            f"{model} holds its model twice: {file.name} is taken, and {other.name} is not: move "
            "the one away that is not the latest"
        ]
    if len(found) < 2:
        return []
    told = [f"{each.parent.relative_to(root)} ({count} images)" for each, count in found]
    other = next(each.parent for each, _ in found if each != file)
    return [
        f"{model.relative_to(root)} is taken of {', '.join(told)}: it has the most images; "
        f"photos.cameras={other.relative_to(root)} takes another"
    ]


def pictures(model: Path, root: Path) -> list[Path]:
    """Folders in which the pictures of a model are looked for: those beside it, whose cameras its
    own are, before those of the folder given."""
    parents = [model, *(p for p in model.parents if root in (p, *p.parents)), root]
    found = [folder / name for name in ("images", "") for folder in parents]
    return [folder for folder in dict.fromkeys(found) if folder.is_dir()] or [root]
