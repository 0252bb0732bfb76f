"""Charts as pictures, drawn with Matplotlib."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from .chart import GREY, Bars, Chart, Panel, Points, Rule, Style
from .figures import figure, fit, styled

_WIDTH = 10  # inches
_LINES = ("-", "--", ":", "-.")
_HATCHES = ("", "//", "..", "xx")


def draw(chart: Chart) -> Figure:
    """The chart with all its panels, alternatives side by side, and one legend below them."""
    heights = [max(panel.height for panel in row) for row in chart.grid]
    with styled():
        named = len(chart.styles) > 1
        below = 0.2 + 0.2 * -(-len(chart.styles) // _columns(chart)) if named else 0.0
        canvas = figure(_WIDTH, sum(heights) + below)
        grid = canvas.subplots(
            len(heights), len(chart.grid[0]), squeeze=False, height_ratios=heights
        )
        for index, (panels, row) in enumerate(zip(chart.grid, grid)):
            below = chart.grid[index + 1] if index + 1 < len(heights) else [None] * len(panels)
            for panel, axes, under in zip(panels, row, below):
                _draw_panel(axes, panel, chart.styles)
                if under is not None and under.x == panel.x:
                    axes.set_xlabel("")
                    axes.tick_params(labelbottom=False)
                if panel is not panels[0] and panel.y == panels[0].y:
                    axes.set_ylabel("")
                    axes.tick_params(labelleft=False)
        if named:
            _legend(canvas, chart)
    return canvas


def _draw_panel(axes: Axes, panel: Panel, styles: dict[str, Style]) -> None:
    for mark in panel.placed:
        if isinstance(mark, Points):
            _draw_points(axes, mark, styles[mark.entry])
        elif isinstance(mark, Bars):
            _draw_bars(axes, mark, styles[mark.entry])
        else:
            _draw_rule(axes, mark)
    axes.set_title(panel.title, loc="left")
    for name, axis in (("x", panel.x), ("y", panel.y)):
        fit(axes, name, axis)
        axes.grid(axis.grid, axis=name)


def _draw_points(axes: Axes, mark: Points, style: Style) -> None:
    axes.plot(
        mark.x,
        mark.y,
        color=style.colour,
        linestyle=_LINES[style.kind] if mark.line else "",
        linewidth=mark.line,
        marker=mark.symbol,
        drawstyle="steps-post" if mark.steps else "default",
        zorder=3,
    )
    if mark.low is None:
        return
    if mark.band:
        axes.fill_between(mark.x, mark.low, mark.high, color=style.colour, alpha=0.18, linewidth=0)
    else:
        draw = axes.hlines if mark.sideways else axes.vlines
        draw(mark.y if mark.sideways else mark.x, mark.low, mark.high, style.colour, linewidth=1)


def _draw_bars(axes: Axes, mark: Bars, style: Style) -> None:
    has = np.isfinite(mark.length)
    fill = {"color": style.colour, "hatch": _HATCHES[style.kind], "edgecolor": "white"}
    draw, start = (axes.barh, "left") if mark.sideways else (axes.bar, "bottom")
    draw(mark.at[has], mark.length[has], mark.width, **{start: mark.base[has]}, **fill)
    if mark.low is not None:
        axes.vlines(mark.at[has], mark.low[has], mark.high[has], "#333333", linewidth=1.2, zorder=3)
    for at, base, text in zip(mark.at, mark.base, mark.instead):
        if text:
            axes.annotate(
                text,
                (at, base),
                xytext=(0, 4),
                textcoords="offset points",
                rotation=90,
                ha="center",
                va="bottom",
                fontsize=8,
                color=style.colour,
            )


def _draw_rule(axes: Axes, mark: Rule) -> None:
    line = {"color": mark.colour, "linestyle": ":" if mark.dotted else "-", "zorder": 1}
    if mark.upright:
        axes.axvline(mark.at, **line)
        return
    axes.axhline(mark.at, linewidth=0.8, **line)
    axes.annotate(
        mark.text,
        (1, mark.at),
        xycoords=("axes fraction", "data"),
        xytext=(3, 0),
        textcoords="offset points",
        va="center",
        fontsize=8,
        color=GREY,
    )


def _legend(canvas: Figure, chart: Chart) -> None:
    marks = [mark for row in chart.grid for panel in row for mark in panel.marks]
    first = {mark.entry: mark for mark in reversed(marks) if not isinstance(mark, Rule)}
    handles = [
        _handle(first[name], name, own) for name, own in chart.styles.items() if name in first
    ]
    canvas.legend(handles=handles, loc="outside lower center", ncols=_columns(chart))


def _columns(chart: Chart) -> int:
    """Of the legend: as many as there is room for."""
    longest = max(map(len, chart.styles))
    return next((n for n, most in ((6, 13), (4, 21), (3, 33), (2, 50)) if longest <= most), 1)


def _handle(mark: Points | Bars, name: str, own: Style) -> Line2D | Patch:
    if isinstance(mark, Bars):
        return Patch(facecolor=own.colour, hatch=_HATCHES[own.kind], edgecolor="white", label=name)
    line = _LINES[own.kind] if mark.line else ""
    return Line2D([], [], color=own.colour, linestyle=line, marker=mark.symbol, label=name)
