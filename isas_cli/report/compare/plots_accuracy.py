"""What accuracy costs, drawn: curves, speed-ups, the price of the next halving."""

from __future__ import annotations

import math

import numpy as np
import pandas
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, MaxNLocator

from .. import cells
from ..figures import GREY, figure, log_costs, log_values
from . import content
from .gather import Comparison, Method
from .looks import Look, legend
from .price import MONTE_CARLO

_AXES = ("seconds", "paths")


def errors(
    comparison: Comparison, scene: str, methods: list[Method], look: dict[str, Look]
) -> tuple[Figure | None, str]:
    """Error against both costs, log-log: a row of panels for each measure that is known."""
    shown = content.measures(comparison, scene)
    if not shown:
        return None, ""
    canvas = figure(10, 3.5 * len(shown) + 0.4)
    grid = canvas.subplots(len(shown), 2, squeeze=False, sharey="row", sharex="col")
    for measure, row in zip(shown, grid):
        for cost, axes in zip(_AXES, row):
            _curves(axes, comparison, scene, methods, look, measure, cost)
            axes.label_outer()
        row[0].set_ylabel(content.label(measure, methods))
    legend(canvas, methods, look, [Line2D([], [], color=GREY, ls=":", label="slope −1/2")])
    several = max(len(method.runs) for method in methods) > 1
    band = "median over runs, band: its 95 % interval" if several else "one run each, no band"
    if several:
        band += "; thin: only some runs went so far"
    return canvas, (
        f"Error against billed seconds and light paths, {band}. Thin lines: 1/2, 1/4, … of the "
        "start. Dotted: the slope −1/2 of Monte Carlo."
    )


def _curves(
    axes: Axes,
    comparison: Comparison,
    scene: str,
    methods: list[Method],
    look: dict[str, Look],
    measure: str,
    cost: str,
) -> None:
    """One panel of curves, with the levels of the tables and the guide line."""
    costs, medians, values = [np.empty(0)], [np.empty(0)], []
    for method in methods:
        own = look[method.label]
        for piece in content.curve(comparison, scene, method.label, measure, cost):
            x, low, high = (piece[name].to_numpy(dtype=float) for name in ("x", "low", "high"))
            width = 1.8 if piece["runs"].iloc[0] == len(method.runs) else 0.9
            axes.plot(x, piece["median"], own.line, color=own.colour, linewidth=width, zorder=3)
            axes.fill_between(x, low, high, color=own.colour, alpha=0.18, linewidth=0)
            costs.append(x)
            medians.append(piece["median"].to_numpy(dtype=float))
            values += [low, high]
    start = content.start(methods, measure)
    log_costs(axes, cost, np.concatenate(costs))
    log_values(axes, np.concatenate([*medians, *values, [start]]))
    low, high = axes.get_ylim()
    for level in [1.0, *content.levels(comparison, scene, measure)]:
        if low < level * start < high:
            axes.axhline(level * start, color="#999999", linewidth=0.6, zorder=1)
            name = "start" if level == 1 else content.level_name(level)
            axes.annotate(
                name,
                (1, level * start),
                xycoords=("axes fraction", "data"),
                xytext=(3, 0),
                textcoords="offset points",
                va="center",
                fontsize=8,
                color=GREY,
            )
    left, right = axes.get_xlim()
    if axes.get_xscale() == "log" and axes.get_yscale() == "log":
        middle = np.concatenate(medians)
        guide = content.guide(left, right, middle.min(), middle.max())
        axes.plot(*guide, color=GREY, linestyle=":", linewidth=1.2, zorder=2)
        axes.set_xlim(left, right)
        axes.set_ylim(low, high)


def speedups(
    comparison: Comparison, scene: str, methods: list[Method], look: dict[str, Look]
) -> tuple[Figure | None, str]:
    """Bars: how many times sooner than the baseline each method reaches each level."""
    base = comparison.baseline[scene]
    others = [method for method in methods if method.label != base]
    shown = [m for m in content.measures(comparison, scene) if content.levels(comparison, scene, m)]
    if not others or not shown:
        return None, ""
    canvas = figure(10, 3.2 * len(shown) + 0.4)
    for measure, axes in zip(shown, canvas.subplots(len(shown), 1, squeeze=False)[:, 0]):
        _bars(axes, comparison, scene, others, look, measure)
        axes.set_ylabel("speed-up")
        axes.set_title(content.SHORT[measure], loc="left")
    axes.set_xlabel("share of the start's error")
    handles = [Line2D([], [], color="black", lw=1, label=f"{base} (baseline)")]
    legend(canvas, others, look, handles, patches=True)
    return canvas, (
        f"How many times sooner than {base} each method reaches a share of the start's error "
        "(above 1: sooner), with 95 % bootstrap intervals where there are several runs."
    )


def _bars(
    axes: Axes,
    comparison: Comparison,
    scene: str,
    methods: list[Method],
    look: dict[str, Look],
    measure: str,
) -> None:
    """One panel of speed-ups: a group for each level, a bar or words for each method."""
    width = 0.8 / len(methods)
    every = {m.label: content.bars(comparison, scene, measure, m.label) for m in methods}
    low, high = content.bar_limits([bar for bars in every.values() for bar in bars])
    log_values(axes, np.array([low, high]))
    axes.set_ylim(low, high)
    for place, (label, bars) in enumerate(every.items()):
        own = look[label]
        for group, bar in enumerate(bars):
            x = group - 0.4 + width * (place + 0.5)
            if math.isnan(bar.ratio):
                axes.annotate(
                    bar.words,
                    (x, 1),
                    xytext=(0, 4),
                    textcoords="offset points",
                    rotation=90,
                    ha="center",
                    va="bottom",
                    fontsize=8,
                    color=own.colour,
                )
                continue
            axes.bar(
                x,
                bar.ratio - 1,
                width * 0.9,
                bottom=1,
                color=own.colour,
                hatch=own.hatch,
                edgecolor="white",
            )
            if not math.isnan(bar.low):  # an end at 0 or infinity runs out of the panel
                ends = [max(bar.low, low / 2), min(bar.high, high * 2)]
                axes.plot([x, x], ends, color="#333333", linewidth=1.2)
    axes.axhline(1, color="black", linewidth=1)
    names = [content.level_name(level) for level in content.levels(comparison, scene, measure)]
    axes.set_xlim(-0.6, max(len(names), 3) - 0.4)
    axes.xaxis.set_major_locator(FixedLocator(range(len(names))))
    axes.set_xticklabels(names)
    axes.grid(False, axis="x")


def prices(
    comparison: Comparison, scene: str, methods: list[Method], look: dict[str, Look]
) -> tuple[Figure | None, str]:
    """What each halving of the error costs, and on the right the late slopes against −1/2."""
    shown = content.measures(comparison, scene)
    if not shown:
        return None, ""
    canvas = figure(10, (1.8 + 0.25 * max(len(methods), 4)) * len(shown) + 0.4)
    grid = canvas.subplots(len(shown), 2, squeeze=False, width_ratios=(3, 2))
    for axes in grid[1:, 1]:
        axes.sharex(grid[0, 1])
    for measure, (left, right) in zip(shown, grid):
        rows = {m.label: content.price(comparison, scene, measure, m.label) for m in methods}
        _halvings(left, rows, look)
        left.set_title(content.SHORT[measure], loc="left")
        _slopes(right, rows, look)
    grid[-1][0].set_xlabel("share of the start's error at which the halving ends")
    grid[-1][1].set_xlabel("d log error / d log seconds")
    cross = Line2D([], [], color=GREY, ls="", marker="x", label="not reached")
    legend(canvas, methods, look, [cross, Line2D([], [], color=GREY, ls=":", label="slope −1/2")])
    return canvas, (
        "Left: billed seconds for each halving of the error. Right: slope of log error against log "
        "seconds in the last decade of time; dotted: −1/2, Monte Carlo, where each halving costs "
        "four times the one before."
    )


def _halvings(axes: Axes, rows: dict[str, pandas.DataFrame], look: dict[str, Look]) -> None:
    """Marginal seconds of each halving, side by side; a cross at the top where not reached."""
    every = pandas.concat(rows.values())
    ends = every[["seconds", "seconds_low", "seconds_high"]].to_numpy().ravel()
    levels = sorted(every["level"].unique(), reverse=True)
    log_values(axes, ends)
    low, high = axes.get_ylim()
    for place, (label, own) in enumerate(rows.items()):
        colour = look[label].colour
        x = [levels.index(level) + 0.5 * (place + 0.5) / len(rows) - 0.25 for level in own["level"]]
        has = np.isfinite(own["seconds"])
        axes.plot(x, own["seconds"].where(has), color=colour, marker="o", ls=look[label].line)
        for at, row in zip(x, own.itertuples()):
            if math.isinf(row.seconds):
                axes.plot(at, 0.94, "x", color=colour, transform=axes.get_xaxis_transform())
            if not math.isnan(row.seconds_low) and math.isfinite(row.seconds):
                span = [max(row.seconds_low, low / 2), min(row.seconds_high, high * 2)]
                axes.plot([at, at], span, color=colour, linewidth=1)
    axes.set_xlim(-0.5, len(levels) - 0.5)
    axes.set_xticks(range(len(levels)), [content.level_name(level) for level in levels])
    axes.set_ylabel("billed seconds")
    if not np.isfinite(ends).any():
        axes.set_yticks([])


def _slopes(axes: Axes, rows: dict[str, pandas.DataFrame], look: dict[str, Look]) -> None:
    """The late slope of each method, with its interval."""
    for place, (label, own) in enumerate(rows.items()):
        if own.empty:
            continue
        row, colour = own.iloc[0], look[label].colour
        axes.plot(row["slope_seconds"], place, "o", color=colour)
        axes.plot([row["slope_seconds_low"], row["slope_seconds_high"]], [place] * 2, color=colour)
    axes.axvline(MONTE_CARLO, color=GREY, linestyle=":")
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_yticks(range(len(rows)), [cells.shortened(label, 1.6) for label in rows])
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axes.grid(False, axis="y")
