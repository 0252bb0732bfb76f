"""Plots of a comparison, each as PNG and SVG: a method has one colour in all of them."""

from __future__ import annotations

from pathlib import Path

import matplotlib

from ...records import safe_name
from ..figures import STYLE, Picture, save
from . import plots_accuracy, plots_runs
from .gather import Comparison, by_scene
from .looks import looks

_DRAWN = {
    "errors": plots_accuracy.errors,
    "speedup": plots_accuracy.speedups,
    "price": plots_accuracy.prices,
    "time": plots_runs.times,
    "training": plots_runs.training,
}


def write_plots(comparison: Comparison, folder: Path) -> dict[str, list[Picture]]:
    """Writes <scene>_<plot>.png and .svg into `folder`; the PNGs of each scene, in reading order.

    A plot for which the runs recorded nothing is left out. Raises IsasError when the disk refuses.
    """
    look, made = looks(comparison), {}
    for scene, methods in by_scene(comparison.methods).items():
        made[scene] = []
        for name, draw in _DRAWN.items():
            with matplotlib.rc_context(STYLE):
                canvas, caption = draw(comparison, scene, methods, look)
                if canvas is None:
                    continue
                path = folder / f"{safe_name(scene)}_{name}.png"
                save(canvas, path)
                canvas.set_layout_engine("none")  # it is laid out: once is enough
                save(canvas, path.with_suffix(".svg"))
            made[scene].append(Picture(path, caption))
    return made
