"""What all pictures of a report share: style, colours, axes and the way to the disk."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from ..records import write_atomically
from .chart import Axis, log_axis

# Okabe and Ito's colours, which differ for colour-blind readers too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
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
    """A finished PNG or WebP file and the sentence that stands under it."""

    path: Path
    caption: str


def styled(grid: bool = True) -> AbstractContextManager[None]:
    """Within the context pictures have ``STYLE`` and otherwise Matplotlib's own defaults, whatever
    a program or a user's file has set."""
    return matplotlib.style.context(["default", {**STYLE, "axes.grid": grid}])


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
    with styled():
        write_atomically(
            path, lambda temporary: made.savefig(temporary, format=kind, metadata=dateless)
        )


def fit(axes: Axes, name: str, axis: Axis) -> None:
    """Gives an axis, x or y, its label, scale, limits and ticks; limits come last, as scales and
    ticks move them."""
    axes.set(**{f"{name}label": axis.label})
    if axis.log:
        axes.set(**{f"{name}scale": "log"})
    if axis.ticks is not None:
        own = getattr(axes, f"{name}axis")
        own.set_ticks(list(axis.ticks), list(axis.ticks.values()))
        own.set_minor_locator(NullLocator())
    if axis.limits is not None:
        axes.set(**{f"{name}lim": axis.limits})


def log_values(axes: Axes, values: np.ndarray) -> None:
    """A logarithmic y axis for `values`, with plain numbers; see `chart.log_axis`."""
    fit(axes, "y", replace(log_axis("", values), label=axes.get_ylabel()))
