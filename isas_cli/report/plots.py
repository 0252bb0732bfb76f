"""Curves of one run: errors against cost, what the optimiser saw, and where the time went."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from ..records import KEY_PREFIX, Run
from .figures import COLOURS, GREY, STYLE, Picture, cost_axis, figure, log_values, marker, save

_COSTS = ("seconds", "paths")
_UNITS = {
    "image_rmse": "image RMSE (linear radiance)",
    "parameter_rmse": "parameter RMSE",
    "loss": "loss",
    "gradient_norm": "norm of the gradient",
    "nonfinite": "non-finite gradient entries",
}


def write_plots(run: Run) -> list[Picture]:
    """Writes plots/*.png of a run and returns those that its records had something to show for."""
    folder = run.folder / "plots"
    with matplotlib.rc_context(STYLE):
        made = [
            _errors(run, folder / "errors.png"),
            _unknowns(run, folder / "unknowns.png"),
            _training(run, folder / "training.png"),
            _time(run, folder / "time.png"),
        ]
    return [picture for picture in made if picture is not None]


def _errors(run: Run, path: Path) -> Picture | None:
    """Image error and, where the truth is known, parameter error against both costs."""
    shown = [name for name in ("image_rmse", "parameter_rmse") if _known(run, name)]
    if not shown:
        return None
    canvas = figure(9.5, 3.1 * len(shown))
    grid = canvas.subplots(len(shown), 2, squeeze=False, sharey="row")
    for name, row, colour in zip(shown, grid, COLOURS):
        for cost, axes in zip(_COSTS, row):
            _curve(axes, run, cost, name, colour=colour)
            log_values(axes, run.history[name].to_numpy())
        words = f" ({run.parameter_rmse_is})" if name == "parameter_rmse" else ""
        row[0].set_ylabel(_UNITS[name] + words)
    grid[0][0].legend(loc="best")
    save(canvas, path)
    return Picture(path, "Error against billed seconds and against light paths.")


def _unknowns(run: Run, path: Path) -> Picture | None:
    """One curve for each unknown, when there are several with a known truth."""
    keys = [key for key in run.keys if _known(run, KEY_PREFIX + key)]
    if len(keys) < 2:
        return None
    canvas = figure(9.5, 3.1 + 0.2 * len(keys))
    row = canvas.subplots(1, 2, sharey=True)
    for cost, axes in zip(_COSTS, row):
        for index, key in enumerate(keys):
            colour = COLOURS[index % len(COLOURS)]
            _curve(axes, run, cost, KEY_PREFIX + key, colour=colour, label=key)
        log_values(axes, run.history[[KEY_PREFIX + key for key in keys]].to_numpy())
    row[0].set_ylabel("parameter RMSE\n(each in its own unit)")
    handles, labels = row[0].get_legend_handles_labels()
    keep = [i for i, label in enumerate(labels) if label != "start"]
    canvas.legend(
        [handles[i] for i in keep], [labels[i] for i in keep], loc="outside lower center", ncols=1
    )
    save(canvas, path)
    return Picture(path, "Error of each unknown; dashed: its value at the start.")


def _training(run: Run, path: Path) -> Picture | None:
    """The loss, the gradient's norm and the count of non-finite gradient entries."""
    shown = [name for name in ("loss", "gradient_norm", "nonfinite") if _known(run, name)]
    if not shown:
        return None
    canvas = figure(9.5, 2.9)
    for name, axes in zip(shown, canvas.subplots(1, len(shown), squeeze=False)[0]):
        seconds, values = run.history["seconds"].to_numpy(), run.history[name].to_numpy()
        axes.set_title(_UNITS[name])
        if name == "nonfinite":
            axes.step(seconds, values, where="post", marker=marker(seconds), color=COLOURS[1])
            axes.set_ylim(bottom=0, top=max(1.0, 1.1 * values.max()))
            axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
        else:
            axes.plot(seconds, values, marker=marker(seconds), color=COLOURS[0])
            log_values(axes, values)
        cost_axis(axes, "seconds", seconds)
    save(canvas, path)
    return Picture(path, "Loss, gradient and non-finite gradient entries at each evaluation.")


def _time(run: Run, path: Path) -> Picture | None:
    """Two stacked bars: the phases that are billed and those that are not."""
    summary: dict[str, Any] = run.summary or {}
    bars = {
        "billed": (summary.get("seconds_by_phase") or {}, "Blues"),
        "not billed": (summary.get("seconds_unbilled") or {}, "Oranges"),
    }
    if not any(phases for phases, _ in bars.values()):
        return None
    entries = sum(len(phases) + 1 for phases, _ in bars.values())
    canvas = figure(9.5, max(2.2, 0.55 + 0.21 * entries))
    axes = canvas.subplots()
    handles: list[Patch] = []
    for row, (title, (phases, map_name)) in enumerate(bars.items()):
        total = sum(phases.values())
        handles.append(Patch(alpha=0.0, label=f"{title}: {total:.4g} s"))
        shades = matplotlib.colormaps[map_name](np.linspace(0.85, 0.3, max(len(phases), 1)))
        left = 0.0
        for (phase, seconds), shade in zip(phases.items(), shades):
            share = f"{seconds / total:.0%}" if total > 0 else "–"
            label = f"{phase}, {seconds:.3g} s ({share})"
            axes.barh(row, seconds, left=left, color=shade, edgecolor="white", height=0.6)
            handles.append(Patch(color=shade, label=label))
            left += seconds
    axes.set_yticks(range(len(bars)), list(bars))
    axes.invert_yaxis()
    axes.grid(False, axis="y")
    axes.set_xlabel("seconds")
    canvas.legend(handles=handles, loc="outside right upper", handlelength=1.2)
    save(canvas, path)
    return Picture(path, "Time by phase. Only billed phases count against the budget.")


def _curve(
    axes: Axes, run: Run, cost: str, name: str, *, colour: str, label: str | None = None
) -> None:
    """One column of the history against a cost; the start is a ring and a dashed level."""
    known = run.history[np.isfinite(run.history[name])]
    x, y = known[cost].to_numpy(), known[name].to_numpy()
    start = colour if label else GREY
    axes.axhline(y[0], color=start, linestyle="--", linewidth=0.9, label="start")
    axes.plot(x, y, color=colour, marker=marker(x), label=label)
    cost_axis(axes, cost, x)
    axes.plot([x[0]], [y[0]], "o", color=start, markersize=9, markerfacecolor="none")


def _known(run: Run, name: str) -> bool:
    """Whether the history has a column with at least one finite value."""
    return name in run.history and bool(np.isfinite(run.history[name]).any())
