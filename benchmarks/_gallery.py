"""A run as one strip of pictures: target, start, result, density."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

from isas_cli.report import cells, frames

COLUMNS = {"target": "", "start": "", "result": "", "density": ""}
_TITLE = 0.28  # inches, where there are titles


def write(
    run: Path, path: Path, columns: Mapping[str, str] = COLUMNS, side: float = 1.9, dpi: int = 100
) -> None:
    """The first view that ``run`` kept, as PNG: ``columns`` is frame → title, ``side`` the width of
    a picture in inches."""
    views, _ = frames.read(run)
    view = views[min(views)]
    shown, _ = cells.exposure({"view": view}, ("target",))
    picture, title = cells.aspect(view["target"]) * side, _TITLE * any(columns.values())
    canvas = Figure(figsize=(len(columns) * side, picture + title), dpi=dpi, facecolor="white")
    high = picture / (picture + title)
    for column, (name, says) in enumerate(columns.items()):
        box = (column / len(columns), 0, 0.98 / len(columns), high)
        axes = canvas.add_axes(box, xticks=[], yticks=[])
        axes.set_title(says, fontsize=11, pad=4)
        axes.spines[:].set_visible(False)
        scale = cells.density_scale([view[name]]) if name == "density" and name in view else None
        cells.draw(axes, view.get(name), shown, scale)
    canvas.savefig(path)
    with Image.open(path) as drawn:
        # Few colours: a quarter of the size.
        small = drawn.convert("RGB").quantize(128, dither=Image.Dither.FLOYDSTEINBERG)
    small.save(path, optimize=True)
