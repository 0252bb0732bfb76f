"""Plots of one run: errors against cost, what the optimiser saw, and where the time went."""

from __future__ import annotations

import numpy as np

from ..records import KEY_PREFIX, Run
from . import inside, static
from .chart import COST_LABELS, Chart, Panel, Points, Rule, Style, cost_axis, log_axis
from .figures import COLOURS, Picture, save

_UNITS = {
    "image_rmse": "image RMSE (linear radiance)",
    "parameter_rmse": "parameter RMSE",
}
_RUN = "run"


def write_plots(run: Run) -> list[Picture]:
    """Writes plots/*.png of a run and returns those that its records had something to show for."""
    style = {_RUN: Style(COLOURS[0])}
    charts = [
        _errors(run, style),
        _unknowns(run),
        inside.training({_RUN: [run]}, style, ("loss", "gradient_norm", "nonfinite")),
        inside.times({_RUN: [run]}),
    ]
    made = []
    for chart in charts:
        if chart is not None:
            path = run.folder / "plots" / f"{chart.name}.png"
            save(static.draw(chart), path)
            made.append(Picture(path, chart.note))
    return made


def _errors(run: Run, styles: dict[str, Style]) -> Chart | None:
    """Image error and, where the truth is known, parameter error against both costs."""
    shown = [name for name in _UNITS if _known(run, name)]
    if not shown:
        return None
    grid = [_panels(run, {_RUN: name}, _label(run, name)) for name in shown]
    note = "Error against billed seconds and against light paths."
    return Chart("errors", "Error against cost", note, grid, styles, alternatives=True)


def _label(run: Run, name: str) -> str:
    """What is plotted, and what it is in."""
    return f"{_UNITS[name]} ({run.parameter_rmse_is})" if name == "parameter_rmse" else _UNITS[name]


def _unknowns(run: Run) -> Chart | None:
    """One curve for each unknown, when there are several with a known truth."""
    columns = {key: KEY_PREFIX + key for key in run.keys if _known(run, KEY_PREFIX + key)}
    if len(columns) < 2:
        return None
    count = len(COLOURS)
    styles = {key: Style(COLOURS[i % count], i // count % 4) for i, key in enumerate(columns)}
    grid = [_panels(run, columns, "parameter RMSE (each in its own unit)", styles)]
    note = "Error of each unknown; the thin lines are at its value at the start."
    return Chart("unknowns", "Error of each unknown", note, grid, styles, alternatives=True)


def _panels(
    run: Run, columns: dict[str, str], title: str, styles: dict[str, Style] | None = None
) -> list[Panel]:
    """A panel for each cost, of columns of the history by entry, with rules at their starts."""
    made = []
    y = log_axis("", run.history[list(columns.values())].to_numpy())
    for cost in COST_LABELS:
        marks, costs = [], []
        for entry, name in columns.items():
            known = run.history[np.isfinite(run.history[name])]
            x, values = known[cost].to_numpy(), known[name].to_numpy()
            marks.append(Points(entry, x, values, symbol=inside.marker(x)))
            marks.append(
                Rule(values[0], colour=styles[entry].colour) if styles else Rule(values[0], "start")
            )
            costs.append(x)
        made.append(Panel(cost_axis(cost, np.concatenate(costs)), y, marks, title, 3.1))
        title = ""
    return made


def _known(run: Run, name: str) -> bool:
    """Whether the history has a column with at least one finite value."""
    return name in run.history and bool(np.isfinite(run.history[name]).any())
