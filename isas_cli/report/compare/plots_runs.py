"""What happened inside the runs, drawn: where the time went, and what the optimiser saw."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ..figures import GREY, cost_axis, figure, log_values
from . import content
from .gather import Comparison, Method
from .looks import Look, legend


def times(
    comparison: Comparison, scene: str, methods: list[Method], look: dict[str, Look]
) -> tuple[Figure | None, str]:
    """Stacked bars: the phases that are billed on the left, the others on the right."""
    halves = {t: table for t, table in content.phases(methods).items() if len(table.columns)}
    if not halves:
        return None, ""
    entries = max(len(table.columns) for table in halves.values())
    canvas = figure(10, 1.3 + 0.32 * len(methods) + 0.2 * entries)
    row = canvas.subplots(1, len(halves), sharey=True, squeeze=False)[0]
    for axes, (title, table) in zip(row, halves.items()):
        shades = content.shades(title, len(table.columns))
        left = np.zeros(len(table))
        for phase, shade in zip(table.columns, shades):
            seconds = table[phase].to_numpy()
            axes.barh(table.index, seconds, left=left, color=shade, edgecolor="white", label=phase)
            left = left + seconds
        for place, total in enumerate(left):
            axes.annotate(
                f"{total:.3g} s", (total, place), (4, 0), textcoords="offset points", va="center"
            )
        axes.set_title(f"{title} (median over runs)")
        axes.set_xlabel("seconds")
        axes.set_xlim(0, max(left.max(), 1e-9) * 1.2)
        axes.grid(False, axis="y")
        axes.legend(loc="upper left", bbox_to_anchor=(0, -0.25), ncols=3, fontsize=8)
    row[0].invert_yaxis()
    for label in row[0].get_yticklabels():
        label.set_color(look[label.get_text()].colour)
    return canvas, "Where the time went. Only billed phases count against the budget."


def training(
    comparison: Comparison, scene: str, methods: list[Method], look: dict[str, Look]
) -> tuple[Figure | None, str]:
    """Gradient norm, gradient noise and non-finite counts against billed seconds, run by run."""
    known = {
        name: {m.label: list(content.histories(m, name)) for m in methods}
        for name in content.TRAINING
    }
    shown = [name for name, runs in known.items() if any(runs.values())]
    if not shown:
        return None, ""
    canvas = figure(10, 3.4)
    for name, axes in zip(shown, canvas.subplots(1, len(shown), squeeze=False)[0]):
        every = []
        for label, runs in known[name].items():
            own = look[label]
            style = {"color": own.colour, "linestyle": own.line, "linewidth": 1, "alpha": 0.8}
            for seconds, values in runs:
                if name == "nonfinite":
                    axes.step(seconds, values, where="post", **style)
                else:
                    axes.plot(seconds, values, **style)
                every.append((seconds, values))
        axes.set_title(content.TRAINING[name])
        values = np.concatenate([values for _, values in every])
        if name == "nonfinite":
            axes.set_ylim(bottom=0, top=max(1.0, 1.1 * values.max()))
            axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
            if not values.any():
                axes.text(0.5, 0.5, "none", ha="center", transform=axes.transAxes, color=GREY)
        else:
            log_values(axes, values)
        cost_axis(axes, "seconds", np.concatenate([seconds for seconds, _ in every]))
    legend(canvas, methods, look, [])
    return canvas, "What the optimiser saw at each evaluation, a line for each run."
