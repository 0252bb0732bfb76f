"""All scenes together, as a table and two charts."""

from __future__ import annotations

import math

import numpy as np

from ..chart import Axis, Chart, Panel, Points, Style, log_axis
from . import across, content
from .across import SHARES, Problems
from .facts import Cell, Heading, Table, number, times
from .gather import Comparison, by_scene, names

_HEADS = {
    "reached": ("reached", "share of (scene, seed, level) that it reached"),
    **{
        f"time_{share:g}": (
            f"time to {share:g}",
            f"expected running time to what the baseline has after {share:g} of its budget, over "
            "the baseline's: geometric mean over scenes; ≥: the method never reached it on some, "
            "≤: the baseline did not",
        )
        for share in SHARES
    },
    "speed_up": ("speed-up", "geometric mean over scenes and levels, and its 95 % interval"),
    "p": ("p", "signed-rank test over scenes of final errors against the baseline, by Holm"),
}


def styled(comparison: Comparison, styles: dict[str, Style]) -> dict[str, Style]:
    """A style for each method of `across`, which has no rate in its name: that of the first scene's
    method that it stands for."""
    made = {}
    for group in by_scene(comparison.methods).values():
        for label, name in names(group).items():
            made.setdefault(name, styles[label])
    return made


def tables(comparison: Comparison) -> list[Table]:
    """One for each measure."""
    frame = across.table(comparison.across) if comparison.across else None
    made = []
    for of in comparison.across:
        rows = []
        for row in content.rows(frame, measure=of.measure).to_dict("records"):
            rows.append((row["method"], [_cell(row, name, of.baseline) for name in _HEADS]))
        heads = [Heading(*head) for head in _HEADS.values()]
        made.append(Table(content.SHORT[of.measure], heads, rows))
    return made


def _cell(row: dict, name: str, baseline: str) -> Cell:
    value = row[name]
    if math.isnan(value):
        return Cell("", "–")
    if name == "reached":
        return Cell(str(value), f"{value:.0%}")
    if name == "speed_up":
        words = f"{row['bound']} {times(value)}".strip()
        low, high = row["speed_up_low"], row["speed_up_high"]
        known = not math.isnan(low) and row["method"] != baseline
        return Cell(str(value), words, (f"[{number(low)}, {number(high)}]",) if known else ())
    sign = "" if name == "p" else _SIGNS[row[name.replace("time", "bound")]]
    return Cell(str(value), sign + number(value))


# By what ``across.table`` has in its columns ``bound_…``.
_SIGNS = {"": "", "at least": "≥ ", "at most": "≤ ", "about": "≈ "}


def charts(comparison: Comparison, styles: dict[str, Style]) -> list[Chart]:
    """Arrivals and profiles, a panel a measure."""
    if not comparison.across:
        return []
    arrivals = [
        _panel(of, across.arrivals(of), "budgets of the baseline") for of in comparison.across
    ]
    profiles = [
        _panel(of, across.profiles(of), "times the soonest method's running time")
        for of in comparison.across
    ]
    own = {name: style for name, style in styles.items() if name in comparison.across[0].times}
    return [
        Chart(
            "arrivals",
            "How many levels are reached, and how soon",
            "Of all scenes, seeds and levels (what the baseline has after 1/8, 1/4, 1/2 and 3/4 of "
            "its budget) the share that a method has reached by then, and stays at.",
            [arrivals],
            own,
        ),
        Chart(
            "profiles",
            "Performance profiles",
            "Of all scenes and levels the share that a method reaches within so many times the "
            "expected running time of the soonest method: at 1 how often it is the soonest, at the "
            "right how often it arrives at all.",
            [profiles],
            own,
        ),
    ]


def _panel(of: Problems, found: dict[str, tuple], label: str) -> Panel:
    every = np.concatenate([x for x, _ in found.values()])
    x = log_axis(label, every[every > 0])
    end = x.limits[1] if x.limits else 1.0
    marks = []
    for name, (at, share) in found.items():
        # From nothing, and on to the right end, where nothing more is reached.
        share = np.concatenate([[0.0], share, share[-1:]]) if at.size else np.zeros(2)
        begin = at[:1] if at.size else x.limits[:1] if x.limits else np.ones(1)
        at = np.concatenate([begin, at, [end]])
        marks.append(Points(name, at, share, steps=True, line=1.8))
    return Panel(x, Axis("share", (0.0, 1.03)), marks, content.SHORT[of.measure], 3.4)
