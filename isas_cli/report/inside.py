"""What happened inside runs: where the time went, and what the optimiser saw."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import matplotlib
import numpy as np
import pandas
from matplotlib.colors import to_hex

from ..records import Run
from .cells import shortened
from .chart import (
    Axis,
    Bars,
    Chart,
    Panel,
    Points,
    Style,
    cost_axis,
    count_axis,
    log_axis,
    rows_axis,
)

_TRAINING = {
    "loss": "loss",
    "gradient_norm": "norm of the gradient",
    "gradient_noise": "gradient noise (GN)",
    "nonfinite": "non-finite gradient entries",
}
_HALVES = {"billed": ("seconds_by_phase", "Greys"), "not billed": ("seconds_unbilled", "YlOrBr")}
_FEW = 60  # points that can still be told apart
_MANY = 500  # of a line, from twice as many on it is thinned to about so many


def training(
    runs: dict[str, list[Run]], styles: dict[str, Style], columns: Sequence[str]
) -> Chart | None:
    """Columns of the history against billed seconds, run by run; None where no run knows any.

    runs, styles: by entry of the legend. columns: of `_TRAINING`.
    """
    panels = [panel for name in columns if (panel := _course(runs, name)) is not None]
    if not panels:
        return None
    note = "What the optimiser saw at each evaluation; a line for each run."
    return Chart("training", "Gradients", note, [panels], styles)


def _course(runs: dict[str, list[Run]], name: str) -> Panel | None:
    marks = [
        Points(
            entry,
            *line,
            line=1.2,
            steps=name == "nonfinite",
            symbol=marker(line[0]) if len(runs) == 1 else "",
        )
        for entry, own in runs.items()
        for line in histories(own, name)
    ]
    if not marks:
        return None
    values = np.concatenate([mark.y for mark in marks])
    counted = name == "nonfinite"
    none = ": none" if counted and not values.any() else ""
    x = cost_axis("seconds", np.concatenate([mark.x for mark in marks]))
    y = count_axis(values) if counted else log_axis("", values)
    return Panel(x, y, marks, _TRAINING[name] + none, 3.0)


def histories(runs: list[Run], name: str) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Billed seconds and a column of the history, for each run that knows it; without gaps, of
    very many rows some, the last among them.

    Gradient noise begins with the second iteration: in the first the smoothed gradient is the
    gradient, and rounding is all that differs.
    """
    for run in runs:
        if name in run.history:
            known = run.history[np.isfinite(run.history[name])]
            known = known[known["iteration"] > 1] if name == "gradient_noise" else known
            if len(known):
                known = known.iloc[:: -max(1, len(known) // _MANY)][::-1]
                yield known["seconds"].to_numpy(), known[name].to_numpy()


def marker(points: np.ndarray) -> str:
    """A dot for each evaluation, as long as dots can be told apart."""
    return "o" if len(points) <= _FEW else ""


def times(runs: dict[str, list[Run]]) -> Chart | None:
    """Seconds by phase, median over the runs of each name, billed ones and others; None where no
    run has a summary."""
    panels, styles = [], {}
    several = any(len(own) > 1 for own in runs.values())
    for half, (key, colours) in _HALVES.items():
        table = phases(runs, key)
        if len(table.columns):
            shades = matplotlib.colormaps[colours](np.linspace(0.7, 0.25, len(table.columns)))
            own = {_entry(table, p, half): Style(to_hex(s)) for p, s in zip(table, shades)}
            panels.append(_stacked(table, list(own), half, several))
            styles |= own
    if not panels:
        return None
    note = "Only billed phases count against the budget."
    return Chart("time", "Time by phase", note, [panels], styles)


def _stacked(table: pandas.DataFrame, entries: list[str], half: str, several: bool) -> Panel:
    """Bars from left to right, a row for each method, of which one has ``several`` runs."""
    ends = table.cumsum(axis=1)
    marks = [
        Bars(
            entry,
            at=np.arange(len(table)),
            length=table[phase].to_numpy(),
            base=(ends[phase] - table[phase]).to_numpy(),
            width=0.75,
            words=[f"{seconds:.4g} s" for seconds in table[phase]],
            sideways=True,
        )
        for entry, phase in zip(entries, table)
    ]
    totals = [f"{total:.3g} s" for total in ends.iloc[:, -1]]
    names = totals
    if len(table) > 1:
        names = [f"{shortened(name, 1.6)}, {total}" for name, total in zip(table.index, totals)]
    title = f"{half} seconds" + (", median over runs" if several else "")
    return Panel(Axis("seconds"), rows_axis(names), marks, title, 1.0 + 0.35 * len(table))


def _entry(table: pandas.DataFrame, phase: str, half: str) -> str:
    """A phase in the legend; of one method alone with its seconds and their share."""
    if len(table) > 1:
        return f"{phase} ({half})"
    seconds, total = table[phase].iloc[0], table.to_numpy().sum()
    return f"{phase} ({half}): {seconds:.3g} s, {seconds / total:.0%}"


def phases(runs: dict[str, list[Run]], key: str) -> pandas.DataFrame:
    """Seconds by phase, median over runs: a row for each name, a column for each phase that took
    any. ``key``: of the summary; runs without one do not count."""
    found = {
        name: pandas.DataFrame([one for run in own if (one := (run.summary or {}).get(key))])
        for name, own in runs.items()
    }
    told = {name: each.fillna(0.0).median() for name, each in found.items() if len(each)}
    table = pandas.DataFrame(told).T
    table = table.astype(float).fillna(0.0)
    return table.loc[:, (table > 0).any()]
