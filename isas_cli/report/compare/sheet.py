"""A sheet of pictures per scene: what was asked for, and what each method made of it.

One exposure for all pictures, one colour scale for all error maps and one for all densities, so
that methods can be compared by eye. Each method shows the run with the median final error.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ...records import key_of
from .. import cells, frames
from ..chart import Style
from ..figures import Picture, figure, save, styled
from . import labels
from .gather import Method
from .typical import pictured, typical_run, words

_VIEW = "00"
_CELL, _GAP, _LEFT, _RIGHT, _TOP = 2.1, 0.08, 0.4, 0.3, 0.62  # inches


@dataclass(frozen=True)
class _Row:
    """One line of a sheet: a picture, or None where none was saved, under each column it has."""

    title: str
    pictures: dict[str, np.ndarray | None]
    scale: cells.Scale | None


def write_sheets(methods: list[Method], styles: dict[str, Style], folder: Path) -> list[Picture]:
    """Writes <scene>_sheet.png and, with unknown textures, <scene>_textures.png into `folder`.

    methods: those of one scene, baseline first. Returns the pictures for which there were frames.
    Raises IsasError when the disk refuses.
    """
    methods, more = pictured(methods)
    shown = {method.label: frames.read(typical_run(method).folder, _VIEW) for method in methods}
    views = {label: views[_VIEW] for label, (views, _) in shown.items() if _VIEW in views}
    textures = {label: textures for label, (_, textures) in shown.items() if textures}
    stem, made = labels.stem(methods[0].scene), []
    with styled(grid=False):
        if views:
            canvas, caption = _views_sheet(views, styles)
            made.append((folder / f"{stem}_sheet.png", canvas, caption))
        if textures:
            canvas, caption = _textures_sheet(textures, styles)
            made.append((folder / f"{stem}_textures.png", canvas, caption))
        for path, canvas, _ in made:
            save(canvas, path)
    return [Picture(path, f"{caption}{more} {words(methods)}") for path, _, caption in made]


def _views_sheet(methods: dict[str, frames.Frames], styles: dict[str, Style]) -> tuple[Figure, str]:
    """Pictures, error maps and densities of view 0, a column for each method."""
    exposure, reason = cells.exposure(methods, ("target", "result", "start"))
    given = _given(methods, "target")
    found = {label: row.get("result") for label, row in methods.items()}
    errors = {label: row.get("error") for label, row in methods.items()}
    scale = cells.error_scale(_saved(errors))  # the start's, often far larger, is cut off
    before = _given(methods, "before")["before"]
    alike = [e for e in _saved(errors) if before is not None and e.shape == before.shape]
    if alike:  # pixels that do not count have no error, in any result
        before = before * np.any([error != 0 for error in alike], axis=0)
    errors = {**({} if before is None else {"start": before}), **errors}
    densities = {label: row.get("density") for label, row in methods.items()}
    rows = [
        _Row("picture", {**given, **found}, None),
        _Row("error", errors, scale),
        _Row("density", densities, cells.density_scale(_saved(densities))),
    ]
    columns = ["target", "start", *methods]
    caption = (
        "View 0: target, start and result of each method; below, the absolute error (of "
        "pixels that count) and the sampling density, each on one scale (which the start's error "
        f"may exceed). {reason}. Non-finite pixels are magenta."
    )
    return _sheet(rows, columns, styles, exposure, reason), caption


def _textures_sheet(
    methods: dict[str, frames.Frames], styles: dict[str, Style]
) -> tuple[Figure, str]:
    """Each unknown texture: truth, start and what each method found, and the error where known."""
    names = sorted({name for rows in methods.values() for name in rows})
    every = {
        f"{label} {name}": row for label, rows in methods.items() for name, row in rows.items()
    }
    exposure, reason = cells.exposure(every, ("truth", "result", "start"), at_least=1.0)
    errors: dict[str, dict[str, np.ndarray | None]] = {}
    pictures: dict[str, dict[str, np.ndarray | None]] = {}
    for name in names:
        own = {label: rows.get(name, {}) for label, rows in methods.items()}
        given = _given(own, "truth")
        found = {label: row.get("result") for label, row in own.items()}
        pictures[name] = {**given, **found}
        if given.get("truth") is not None:
            errors[name] = {"start": _given(own, "before")["before"]}
            errors[name] |= {label: row.get("error") for label, row in own.items()}
    of_methods = [row[label] for row in errors.values() for label in methods]
    scale = cells.error_scale([error for error in of_methods if error is not None])
    rows = []
    for name in names:
        rows.append(_Row(key_of(name), pictures[name], None))
        if name in errors:
            rows.append(_Row("error", errors[name], scale))
    columns = [*(["truth"] if errors else []), "start", *methods]
    caption = (
        f"Unknown textures ({', '.join(key_of(name) for name in names)}): start and result of each "
        f"method{'; errors on one scale' if errors else ''}. {reason}. "
        "Texels that no view sees stay at the start. Non-finite texels are magenta."
    )
    return _sheet(rows, columns, styles, exposure, reason), caption


def _given(methods: dict[str, dict[str, np.ndarray]], wanted: str) -> dict[str, np.ndarray | None]:
    """What is the same for all methods, from the first that saved it; `wanted` may be unknown."""
    return {
        name: next((row[name] for row in methods.values() if name in row), None)
        for name in (wanted, "start")
    }


def _saved(row: dict[str, np.ndarray | None]) -> list[np.ndarray]:
    return [image for image in row.values() if image is not None]


def _sheet(
    rows: list[_Row], columns: list[str], styles: dict[str, Style], exposure: float, reason: str
) -> Figure:
    """Lays the cells out in inches; a row's colour bar stands in its empty first column."""
    heights = [
        _CELL * cells.aspect(next(iter(_saved(row.pictures)), np.zeros((1, 1)))) for row in rows
    ]
    width = _LEFT + len(columns) * (_CELL + _GAP) + _RIGHT
    height = _TOP + sum(heights) + _GAP * (len(rows) + 1)
    canvas = figure(width, height, layout=None)
    canvas.text(_LEFT / width, 1 - 0.12 / height, reason, va="top", fontsize=9, color="#444444")
    bottom = height - _TOP
    for index, (row, cell_height) in enumerate(zip(rows, heights)):
        bottom -= cell_height + _GAP
        for place, column in enumerate(columns):
            left = _LEFT + place * (_CELL + _GAP)
            if column in row.pictures:
                box = (left / width, bottom / height, _CELL / width, cell_height / height)
                axes = canvas.add_axes(box, xticks=[], yticks=[])
                axes.spines[:].set_visible(False)
                cells.draw(axes, row.pictures[column], exposure, row.scale)
                if index == 0:
                    colour = styles[column].colour if column in styles else "black"
                    axes.set_title(cells.shortened(column, _CELL), fontsize=11, pad=4, color=colour)
            elif place == 0 and row.scale is not None and _saved(row.pictures):
                middle = bottom + cell_height / 2
                box = ((left + 0.1) / width, middle / height, (_CELL - 0.3) / width, 0.12 / height)
                cells.bar(canvas, canvas.add_axes(box), row.scale)
        label = cells.shortened(row.title, cell_height)
        middle = (bottom + cell_height / 2) / height
        canvas.text(0.2 / width, middle, label, rotation=90, ha="center", va="center", fontsize=10)
    return canvas
