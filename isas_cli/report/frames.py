"""Picture sheets: what was asked for, where the run began, what it found and what is wrong with it.

The frames are linear; a sheet shows them through `images.to_display` with one exposure, stated on
it, so that the pictures of a row, and the rows among themselves, can be compared.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ..records import key_of
from . import cells
from .figures import Picture, save, styled

_VIEW = re.compile(r"(target|start|result|error|density)_v(\d+)$")
_HELD = re.compile(r"held_(target|result|weight)_v(\d+)$")
_TEXTURE = re.compile(r"(truth|start|result)_(.+)$")
Frames = dict[str, dict[str, np.ndarray]]


def write_sheets(folder: Path) -> list[Picture]:
    """Writes plots/sheet.png (views) and plots/textures.png (unknown textures) from frames/*.exr.

    Returns those for which there were frames, and the turntables of shapes and volumes. A frame
    that is missing or cannot be read leaves a grey field that says so.
    """
    views, textures = read(folder)
    made = []
    with styled(grid=False):
        if views:
            made.append(_views_sheet(views, Path(folder) / "plots" / "sheet.png"))
        if textures:
            made.append(_textures_sheet(textures, Path(folder) / "plots" / "textures.png"))
        made += _held_out(folder)
    return [*made, *_turntables(folder)]


def held_out(folder: Path) -> Frames:
    """Of views of which nothing was learnt target, result and error, reduced; what does not count
    is black."""
    rows: Frames = {}
    numbers = {
        match.group(2)
        for path in Path(folder).glob("frames/held_*.exr")
        if (match := _HELD.match(path.stem))
    }
    for number in sorted(numbers, key=int):
        row = {}
        for what in ("target", "result", "weight"):
            frame = cells.read(Path(folder) / "frames" / f"held_{what}_v{number}.exr")
            row |= {} if frame is None else {what: frame}
        if len(row) == 3:
            counts = row.pop("weight") > 0
            row["target"], row["result"] = row["target"] * counts, row["result"] * counts
            row["error"] = np.abs(row["result"] - row["target"])
        row = {what: cells.reduced(frame) for what, frame in row.items()}
        rows |= {f"held out {int(number)}": row} if row else {}
    return rows


def _held_out(folder: Path) -> list[Picture]:
    """plots/held_out.png, of what ``held_out`` has."""
    rows = held_out(folder)
    if not rows:
        return []
    exposure, words = cells.exposure(rows, ("target", "result"))
    path = Path(folder) / "plots" / "held_out.png"
    save(_sheet(rows, ["target", "result", "error"], exposure, words), path)
    told = "Views held out: photograph, rendering and absolute error of the pixels that count"
    return [Picture(path, f"{told}. {words}.")]


def _turntables(folder: Path) -> list[Picture]:
    columns = "truth (where it is known), start, result, and the result's distance from the truth"
    return [
        Picture(
            path,
            f"{key_of(path.stem.removeprefix('turntable_'))}: {columns} (dark: none; yellow: as far"
            " as its farthest twentieth).",
        )
        for path in sorted(Path(folder).glob("meshes/turntable_*.webp"))
    ] + [
        Picture(
            path,
            f"{key_of(path.stem.removeprefix('turning_'))}: truth (where it is known), start and "
            "result, the largest values along lines of sight.",
        )
        for path in sorted(Path(folder).glob("meshes/turning_*.webp"))
    ]


def read(folder: Path, only_view: str | None = None) -> tuple[Frames, Frames]:
    """The frames of a run: views by number ("00") and textures by file name.

    Each row holds (H, W, 3) linear pictures by what they show, reduced to what a sheet needs (see
    `cells.read_reduced`); those that are missing or cannot be read are left out. `only_view` names
    the one view to read. Of it, and of textures, whose truth is known, also the error at the start,
    ``before``, and of textures that of the result.
    """
    views: Frames = {}
    textures: Frames = {}
    here = Path(folder) / "frames"
    for path in sorted(Path(folder).glob("frames/*.exr")):
        view, texture = _VIEW.match(path.stem), _TEXTURE.match(path.stem)
        if view and only_view not in (None, view.group(2)):
            continue
        match, rows = (view, views) if view else (texture, textures)
        frame = cells.read_reduced(path) if match else None
        if match and frame is not None:
            rows.setdefault(match.group(2), {})[match.group(1)] = frame

    def compare(row: dict, what: str, a: str, b: str) -> None:
        error = cells.difference(here / f"{a}.exr", here / f"{b}.exr")
        row |= {} if error is None else {what: error}

    for name, row in textures.items():
        compare(row, "before", f"start_{name}", f"truth_{name}")
        compare(row, "error", f"result_{name}", f"truth_{name}")
    for name, row in views.items() if only_view else ():
        compare(row, "before", f"start_v{name}", f"target_v{name}")
    return views, textures


def _views_sheet(views: Frames, path: Path) -> Picture:
    """One row for each view: target, start, result, error and density."""
    columns = ["target", "start", "result", "error", "density"]
    exposure, words = cells.exposure(views, ("target", "result", "start"))
    rows = {f"view {int(name)}": views[name] for name in sorted(views, key=int)}
    save(_sheet(rows, columns, exposure, words), path)
    return Picture(
        path,
        "Target, start, result, absolute error (of pixels that count) and sampling density. "
        f"{words}. Non-finite pixels are magenta.",
    )


def _textures_sheet(textures: Frames, path: Path) -> Picture:
    """One row for each unknown texture: truth, start, result and error (if the truth is known)."""
    rows = {key_of(name): row for name, row in sorted(textures.items())}
    columns = ["start", "result"]
    if any("truth" in row for row in rows.values()):
        columns = ["truth", *columns, "error"]
    exposure, words = cells.exposure(rows, ("truth", "result", "start"), at_least=1.0)
    save(_sheet(rows, columns, exposure, words), path)
    return Picture(
        path,
        f"Unknown textures ({', '.join(rows)}): {', '.join(columns)}. {words}. "
        "Non-finite texels are magenta.",
    )


def _sheet(rows: Frames, columns: list[str], exposure: float, words: str) -> Figure:
    """A line for each of ``rows``, and below them the bars of their colours."""
    scales = {
        column: scale([row[column] for row in rows.values() if column in row])
        for column, scale in (("error", cells.error_scale), ("density", cells.density_scale))
        if column in columns
    }
    lines = [
        cells.Row(title, {column: row.get(column) for column in columns}, scales)
        for title, row in rows.items()
    ]
    bars = [cells.Row("", {}, scales)] if scales else []
    return cells.sheet(lines + bars, columns, exposure, words)
