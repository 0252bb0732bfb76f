"""A sheet of pictures per scene: what was asked for, and what each method made of it.

One exposure for all pictures, one colour scale for all error maps and one for all densities, so
that methods can be compared by eye. Each method shows the run with the median final error.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ...records import key_of
from .. import cells, frames
from ..chart import Style
from ..figures import Picture, save, styled
from . import labels
from .gather import Method
from .typical import pictured, typical_run, words

_VIEW = "00"


def write_sheets(methods: list[Method], styles: dict[str, Style], folder: Path) -> list[Picture]:
    """Writes <scene>_sheet.png and, with unknown textures, <scene>_textures.png into `folder`.

    methods: those of one scene, baseline first. Returns the pictures for which there were frames.
    Raises IsasError when the disk refuses.
    """
    methods, more = pictured(methods)
    shown = {method.label: frames.read(typical_run(method).folder, _VIEW) for method in methods}
    views = {label: views[_VIEW] for label, (views, _) in shown.items() if _VIEW in views}
    textures = {label: textures for label, (_, textures) in shown.items() if textures}
    inks = {label: style.colour for label, style in styles.items()}
    stem, made = labels.stem(methods[0].scene), []
    with styled(grid=False):
        if views:
            canvas, caption = _views_sheet(views, inks)
            made.append((folder / f"{stem}_sheet.png", canvas, caption))
        if textures:
            canvas, caption = _textures_sheet(textures, inks)
            made.append((folder / f"{stem}_textures.png", canvas, caption))
        for path, canvas, _ in made:
            save(canvas, path)
    return [Picture(path, f"{caption}{more} {words(methods)}") for path, _, caption in made]


def _views_sheet(methods: dict[str, frames.Frames], inks: dict[str, str]) -> tuple[Figure, str]:
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
        cells.Row("picture", {**given, **found}),
        _maps("error", errors, scale, "target"),
        _maps("density", densities, cells.density_scale(_saved(densities)), "target"),
    ]
    columns = ["target", "start", *methods]
    caption = (
        "View 0: target, start and result of each method; below, the absolute error (of "
        "pixels that count) and the sampling density, each on one scale (which the start's error "
        f"may exceed). {reason}. Non-finite pixels are magenta."
    )
    return cells.sheet(rows, columns, exposure, reason, inks), caption


def _textures_sheet(methods: dict[str, frames.Frames], inks: dict[str, str]) -> tuple[Figure, str]:
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
        rows.append(cells.Row(key_of(name), pictures[name]))
        if name in errors:
            rows.append(_maps("error", errors[name], scale, "truth"))
    columns = [*(["truth"] if errors else []), "start", *methods]
    caption = (
        f"Unknown textures ({', '.join(key_of(name) for name in names)}): start and result of each "
        f"method{'; errors on one scale' if errors else ''}. {reason}. "
        "Texels that no view sees stay at the start. Non-finite texels are magenta."
    )
    return cells.sheet(rows, columns, exposure, reason, inks), caption


def _given(methods: dict[str, dict[str, np.ndarray]], wanted: str) -> dict[str, np.ndarray | None]:
    """What is the same for all methods, from the first that saved it; `wanted` may be unknown."""
    return {
        name: next((row[name] for row in methods.values() if name in row), None)
        for name in (wanted, "start")
    }


def _saved(row: dict[str, np.ndarray | None]) -> list[np.ndarray]:
    return [image for image in row.values() if image is not None]


def _maps(
    title: str, maps: dict[str, np.ndarray | None], scale: cells.Scale, beside: str
) -> cells.Row:
    """A line of maps of one scale, whose bar stands in the column ``beside`` them."""
    return cells.Row(title, maps, dict.fromkeys([beside, *maps], scale) if _saved(maps) else {})
