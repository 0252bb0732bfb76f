"""What all pictures of a report share: the look, colours, axes and the way to the disk."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import (
    EngFormatter,
    FuncFormatter,
    LogFormatterSciNotation,
    LogLocator,
    MaxNLocator,
    NullFormatter,
)

from ..records import write_atomically

# Okabe and Ito's colours, which differ for colour-blind readers too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
GREY = "#666666"
COST_LABELS = {"seconds": "billed seconds", "paths": "light paths"}
STYLE = {
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.prop_cycle": matplotlib.cycler(color=COLOURS),
    "lines.linewidth": 1.6,
    "lines.markersize": 4,
    "legend.frameon": False,
    "svg.hashsalt": "isas",  # names inside an SVG are drawn by chance otherwise
}
_DPI = 110


@dataclass(frozen=True)
class Picture:
    """A finished PNG and the sentence that stands under it."""

    path: Path
    caption: str


def figure(width: float, height: float, layout: str | None = "constrained") -> Figure:
    """An empty figure of the given size in inches, drawn without pyplot's global state."""
    made = Figure(figsize=(width, height), dpi=_DPI, layout=layout)
    if layout == "constrained":
        made.get_layout_engine().set(w_pad=0.1, h_pad=0.1)
    FigureCanvasAgg(made)
    return made


def save(made: Figure, path: Path) -> None:
    """Writes the figure as its suffix says (.png, .svg), whole or not at all, the same bytes for
    the same figure; IsasError when the disk refuses."""
    kind = path.suffix.removeprefix(".")
    dateless = {"Date": None} if kind == "svg" else None
    write_atomically(
        path, lambda temporary: made.savefig(temporary, format=kind, metadata=dateless)
    )


def marker(points: np.ndarray) -> str:
    """A dot for each evaluation, as long as dots can be told apart."""
    return "o" if len(points) <= 60 else ""


def log_values(axes: Axes, values: np.ndarray) -> None:
    """A logarithmic y axis for `values`, with plain numbers or, below 0.001, powers of ten.

    Values that are not positive are left out; without any positive one the axis stays linear. Less
    than half a decade gets evenly spaced ticks, as powers of ten would leave it without a label.
    """
    known = values[np.isfinite(values) & (values > 0)]
    if known.size == 0:
        return
    low, high = float(known.min()), float(known.max())
    axes.set_yscale("log", nonpositive="mask")
    margin = max((high / low) ** 0.06, 1.02)
    axes.set_ylim(low / margin, high * margin)
    _log_ticks(axes.yaxis, low, high)


def log_costs(axes: Axes, name: str, cost: np.ndarray) -> None:
    """A logarithmic x axis for costs, `name` being `seconds` or `paths`; what costs nothing has no
    place on it. Without any positive cost the axis stays linear."""
    known = cost[np.isfinite(cost) & (cost > 0)]
    axes.set_xlabel(COST_LABELS[name])
    if known.size == 0:
        return
    low, high = float(known.min()), float(known.max())
    axes.set_xscale("log", nonpositive="mask")
    margin = max((high / low) ** 0.03, 1.02)
    axes.set_xlim(low / margin, high * margin)
    _log_ticks(axes.xaxis, low, high)
    if name == "paths":
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))


def _log_ticks(axis: Axis, low: float, high: float) -> None:
    """Places and labels the ticks of a logarithmic axis from `low` to `high`, whatever its span."""
    formatter = FuncFormatter(lambda value, _: f"{value:.4g}")
    if high / low < 3:
        axis.set_major_locator(MaxNLocator(5))
    else:
        steps = (1, 2, 5) if high / low < 1e3 else (1,)
        axis.set_major_locator(LogLocator(subs=steps, numticks=12))
        if low < 1e-3 or high >= 1e5:
            formatter = LogFormatterSciNotation(minor_thresholds=(np.inf, np.inf))
    axis.set_major_formatter(formatter)
    axis.set_minor_formatter(NullFormatter())


def cost_axis(axes: Axes, name: str, cost: np.ndarray) -> None:
    """Labels the x axis, `name` being `seconds` or `paths`; logarithmic over more than two decades.

    The start costs nothing and has no place on a logarithmic axis: draw it as a level line.
    """
    positive = cost[cost > 0]
    if positive.size > 1 and positive.max() > 100 * positive.min():
        axes.set_xscale("log")
    axes.set_xlabel(COST_LABELS[name])
    if name == "paths":
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    elif axes.get_xscale() == "log":
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    if axes.get_xscale() == "linear":
        axes.xaxis.set_major_locator(MaxNLocator(6))
    if not positive.size:  # stopped after the evaluation of the start
        axes.set_xlim(-0.05, 1.0)
        axes.set_xticks([0.0])
    axes.xaxis.set_minor_formatter(NullFormatter())
