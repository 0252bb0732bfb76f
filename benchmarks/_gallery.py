"""A run as one strip of pictures: target, start, result, density."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

from isas_cli.report import cells, frames

_SIDE = 1.9  # inches
_COLUMNS = ("target", "start", "result", "density")


def write(run: Path, path: Path) -> None:
    """The first view that ``run`` kept, as PNG."""
    views, _ = frames.read(run)
    view = views[min(views)]
    shown, _ = cells.exposure({"view": view}, ("target",))
    height = cells.aspect(view["target"]) * _SIDE
    canvas = Figure(figsize=(len(_COLUMNS) * _SIDE, height), dpi=100, facecolor="white")
    for column, name in enumerate(_COLUMNS):
        box = (column / len(_COLUMNS), 0, 0.98 / len(_COLUMNS), 1)
        axes = canvas.add_axes(box, xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        scale = cells.density_scale([view[name]]) if name == "density" and name in view else None
        cells.draw(axes, view.get(name), shown, scale)
    canvas.savefig(path)
    with Image.open(path) as picture:
        # Few colours: a quarter of the size.
        small = picture.convert("RGB").quantize(128, dither=Image.Dither.FLOYDSTEINBERG)
    small.save(path, optimize=True)
