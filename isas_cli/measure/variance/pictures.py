"""The results drawn: variances as bars, and where each sampler looks."""

from __future__ import annotations

import math
import re
from pathlib import Path

import drjit as dr
import matplotlib
import mitsuba as mi
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from ...rendering.pixels import PixelDistribution
from ...report import cells
from ...report.chart import GREY
from ...report.figures import COLOURS, figure, log_values, save, styled
from ...runtime import images
from ...scene.problem import Problem
from .table import BEST

BARS = "variance.png"
# Panels beside each other in the picture of a view's densities.
_ACROSS = 4
_PANEL = 2.6  # inches


def bars(table: list[dict], folder: Path, title: str) -> None:
    """variance.png and .svg: variance and efficiency relative to uniform's, logarithmic."""
    known = [row for row in table if row["ratio_to_uniform"] > 0]
    if not known:
        return
    with styled():
        canvas = figure(10, 5)
        left, right = canvas.subplots(1, 2)
        _bars(left, known, "ratio_to_uniform", "variance (uniform: 1)")
        _bars(right, known, "efficiency", "1 / (variance × time) (uniform: 1)")
        best = next((row for row in known if row["sampler"] == BEST), None)
        if best:
            left.axhline(best["ratio_to_uniform"], color=GREY, linestyle=":", linewidth=1.2)
            line = Line2D([], [], color=GREY, ls=":", label="what the best pmf measured has")
            canvas.legend(handles=[line], loc="outside lower center")
        canvas.suptitle(title, x=0.01, ha="left", fontsize=10)
        save(canvas, folder / BARS)
        canvas.set_layout_engine("none")  # it is laid out: once is enough
        save(canvas, (folder / BARS).with_suffix(".svg"))


def _bars(axes: Axes, table: list[dict], name: str, label: str) -> None:
    """One bar for each row from 1, up or down, with its interval where there is one."""
    values = [row[name] for row in table]
    ends = [row.get(f"{name}{end}", math.nan) for row in table for end in ("_low", "_high")]
    log_values(axes, np.array([*values, *ends, 0.9, 1.1]))
    for place, row in enumerate(table):
        colour = GREY if row["sampler"] == BEST else COLOURS[place % len(COLOURS)]
        axes.bar(place, row[name] - 1, 0.7, bottom=1, color=colour)
        low, high = (row.get(f"{name}{end}", math.nan) for end in ("_low", "_high"))
        if low > 0:
            axes.plot([place, place], [low, high], color="#333333", linewidth=1.4)
        above = row[name] >= 1
        axes.annotate(
            f"{row[name]:.3g}",
            (place, max(row[name], high) if above else min(row[name], low)),
            xytext=(0, 3 if above else -3),
            textcoords="offset points",
            ha="center",
            va="bottom" if above else "top",
            fontsize=8,
        )
    low, high = axes.get_ylim()
    axes.set_ylim(low / 1.3, high * 1.3)
    axes.axhline(1, color="black", linewidth=1)
    names = [cells.shortened(row["sampler"], 1.6) for row in table]
    axes.set_xticks(range(len(table)), names, rotation=35, ha="right")
    axes.set_ylabel(label)
    axes.grid(False, axis="x")


def chosen(problem: Problem, count: int) -> list[int]:
    """Up to ``count`` views spread evenly over the problem's."""
    views = len(problem.film_sizes)
    return [int(v) for v in np.linspace(0, views, min(count, views), endpoint=False)]


def densities(
    problem: Problem,
    distributions: dict[str, PixelDistribution],
    views: list[int],
    folder: Path,
    tags: dict,
) -> None:
    """density_<sampler>_v00.exr and .png for each sampler and view, and all of a view beside its
    target in densities_v00.png. An EXR's Y is p_j n, 1 where a pixel is drawn as uniformly;
    the PNGs share one logarithmic scale of colours."""
    maps = {
        (label, view): _map(problem, distribution, view)
        for label, distribution in distributions.items()
        for view in views
    }
    if not maps:
        return
    scale = cells.density_scale(list(maps.values()))
    for (label, view), density in maps.items():
        path = folder / f"density_{_slug(label)}_v{view:02d}.exr"
        stated = {**tags, "what": "p_j n", "sampler": label, "view": view}
        images.write_exr(path, density, ["Y"], stated)
        span = f"viridis, logarithmic, {scale.norm.vmin:.3g} to {scale.norm.vmax:.3g}"
        coloured = cells.colours(density, 1.0, scale)
        images.write_png(path.with_suffix(".png"), coloured, {**stated, "scale": span})
    with styled(grid=False):
        for view in views:
            own = {label: maps[label, view] for label in distributions}
            _sheet(problem.target_image(view), own, scale, folder / f"densities_v{view:02d}.png")


def _slug(label: str) -> str:
    """A part of a file's name: readable, nothing that a shell would take apart."""
    return re.sub(r"[^\w.=+-]+", "_", label)


def _map(problem: Problem, distribution: PixelDistribution, view: int) -> np.ndarray:
    """p_j n of one view, (H, W, 1)."""
    width, height = problem.film_sizes[view]
    index = dr.arange(mi.UInt32, width * height)
    row = index // width
    of = dr.full(mi.UInt32, view, width * height)
    found = distribution.probability(of, index - row * width, row) * problem.views.total
    return np.array(found).reshape(height, width, 1)


def _sheet(target: np.ndarray, maps: dict[str, np.ndarray], scale: cells.Scale, path: Path) -> None:
    """The target and the maps of one view, four beside each other, one bar of colours."""
    count = 1 + len(maps)
    across = min(_ACROSS, count)
    down = -(-count // across)
    tall = _PANEL * cells.aspect(target) + 0.25
    canvas = figure(_PANEL * across, tall * down + 0.7)
    grid = canvas.subplots(down, across, squeeze=False).ravel()
    exposure = images.exposure_for([target])
    panels = [("target", target, None), *((label, m, scale) for label, m in maps.items())]
    for axes, (title, image, own) in zip(grid, panels):
        cells.draw(axes, image, exposure, own)
        axes.set_title(cells.shortened(title, _PANEL), fontsize=9)
    for axes in grid:
        axes.set_xticks([])
        axes.set_yticks([])
        axes.spines[:].set_visible(False)
    for axes in grid[count:]:
        axes.set_visible(False)
    made = canvas.colorbar(
        matplotlib.cm.ScalarMappable(scale.norm, scale.colours),
        ax=grid.tolist(),
        orientation="horizontal",
        extend=scale.extend,
        shrink=0.5,
        aspect=40,
    )
    made.set_label(scale.label, fontsize=8)
    save(canvas, path)
