"""Plots of a comparison, each as PNG and SVG: a method has one style in all of them."""

from __future__ import annotations

from pathlib import Path

from .. import static
from ..chart import Chart
from ..figures import save
from . import labels


def write_plots(scene: str, charts: list[Chart], folder: Path) -> list[Path]:
    """Writes <scene>_<chart>.png and .svg into `folder`; the PNGs, in reading order.

    Raises IsasError when the disk refuses.
    """
    made = []
    for chart in charts:
        path = folder / f"{labels.stem(scene)}_{chart.name}.png"
        canvas = static.draw(chart)
        save(canvas, path)
        canvas.set_layout_engine("none")  # it is laid out: once is enough
        save(canvas, path.with_suffix(".svg"))
        made.append(path)
    return made
