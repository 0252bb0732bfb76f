"""What accuracy costs, as charts: curves, speed-ups, the price of the next halving."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas

from .. import inside
from ..cells import shortened
from ..chart import (
    COST_LABELS,
    GREY,
    Axis,
    Bars,
    Chart,
    Panel,
    Points,
    Rule,
    Style,
    log_axis,
    names_axis,
    rows_axis,
)
from . import content
from .gather import Comparison, Method
from .price import MONTE_CARLO

_SLOPE = "slope −1/2"
_ENDS = ("", "_low", "_high")


def of_costs(
    comparison: Comparison, scene: str, methods: list[Method], styles: dict[str, Style]
) -> list[Chart]:
    """What accuracy costs, without what was not recorded. styles: of all methods, by label."""
    own = {method.label: styles[method.label] for method in methods}
    every = [
        errors(comparison, scene, methods, own),
        speedups(comparison, scene, own),
        prices(comparison, scene, own),
    ]
    return [chart for chart in every if chart is not None]


def of_insides(methods: list[Method], styles: dict[str, Style]) -> list[Chart]:
    """What happened inside the runs, without what was not recorded."""
    own = {method.label: styles[method.label] for method in methods}
    runs = {method.label: method.runs for method in methods}
    columns = ("gradient_norm", "gradient_noise", "nonfinite")
    every = [inside.times(runs), inside.training(runs, own, columns)]
    return [chart for chart in every if chart is not None]


def errors(
    comparison: Comparison, scene: str, methods: list[Method], styles: dict[str, Style]
) -> Chart | None:
    """Error against both costs, log-log: a row of panels for each measure that is known."""
    curves = content.rows(comparison.curves, scene=scene)
    curves = curves[(curves["x"] > 0) & np.isfinite(curves["median"])]
    shown = content.measures(comparison, scene)
    if not shown:
        return None
    x = {
        c: log_axis(COST_LABELS[c], _values(curves[curves["axis"] == c], "x")) for c in COST_LABELS
    }
    grid = []
    for measure in shown:
        own = content.rows(curves, measure=measure)
        start = content.start(methods, measure)
        y = log_axis("", np.append(_values(own, "median", "low", "high"), start))
        rules = [
            Rule(level * start, "start" if level == 1 else content.level_name(level))
            for level in [1.0, *content.levels(comparison, scene, measure)]
            if y.limits and y.limits[0] < level * start < y.limits[1]
        ]
        row = []
        for cost, axis in x.items():
            title = "" if row else content.label(measure, methods)
            of_cost = content.rows(own, axis=cost)
            marks = [m for method in methods for m in _curves(of_cost, method)]
            marks.append(_guide(axis, _values(of_cost, "median")))
            row.append(Panel(axis, y, [*rules, *marks], title, 3.5))
        grid.append(row)
    note = (
        "Median over runs with its 95 % band (up to eight runs: their range; of one run "
        "none); thin where only some runs went so far. Levels: 1/2, 1/4, … of the start's error. "
        "Dotted: the slope −1/2 of Monte Carlo."
    )
    styles = {**styles, _SLOPE: Style(GREY, 2)}
    return Chart("errors", "Error against cost", note, grid, styles, alternatives=True)


def _curves(rows: pandas.DataFrame, method: Method) -> list[Points]:
    """A method's curve as far as all its runs went, and the thin pieces to which some went.

    In pieces, one for each number of runs that went so far: where a run ends the median jumps, and
    a line across the jump would pass for a gain or a loss.
    """
    rows = content.rows(rows, method=method.label).sort_values("x")
    pieces = rows.groupby((rows["runs"] != rows["runs"].shift()).cumsum())
    parts: dict[float, list[np.ndarray]] = {2.0: [], 1.0: []}
    for _, piece in pieces:
        values = piece[["x", "median", "low", "high"]].to_numpy(dtype=float)
        whole = piece["runs"].iloc[0] == len(method.runs)
        parts[2.0 if whole else 1.0] += [values, np.full((1, 4), np.nan)]
    made = []
    for width, own in parts.items():
        x, median, low, high = np.concatenate([np.empty((0, 4)), *own[:-1]]).T
        made.append(Points(method.label, x, median, low, high, band=True, line=width))
    return made


def _guide(x: Axis, medians: np.ndarray) -> Points:
    """A line of slope −1/2 through the middle of a log-log panel, as long as the panel holds it."""
    if not x.log or not medians.size:
        return Points(_SLOPE, np.empty(0), np.empty(0), line=1.2)
    (left, right), low, high = x.limits, medians.min(), medians.max()
    middle_x, middle_y = math.sqrt(left * right), math.sqrt(low * high)
    reach = min(math.sqrt(right / left), high / low)  # in x each way; y goes half as far
    ends = np.array([1 / reach, reach])
    return Points(_SLOPE, middle_x * ends, middle_y / np.sqrt(ends), line=1.2)


def speedups(comparison: Comparison, scene: str, styles: dict[str, Style]) -> Chart | None:
    """Bars: how many times sooner than the baseline each method reaches each level."""
    base = comparison.baseline[scene]
    others = {label: style for label, style in styles.items() if label != base}
    shown = [m for m in content.measures(comparison, scene) if content.levels(comparison, scene, m)]
    if not others or not shown:
        return None
    grid = [[_speedup_panel(comparison, scene, measure, list(others))] for measure in shown]
    note = (
        f"Billed seconds of {base}, the baseline, divided by the method's own: above 1 is sooner. "
        "Lines: 95 % bootstrap interval."
    )
    return Chart("speedup", "Speed-up over the baseline", note, grid, others)


def _speedup_panel(comparison: Comparison, scene: str, measure: str, labels: list[str]) -> Panel:
    """A group for each level, in it a bar or words for each method."""
    base, levels = comparison.baseline[scene], content.levels(comparison, scene, measure)
    table = content.rows(comparison.accuracy, scene=scene, measure=measure)
    reference = content.rows(table, method=base).set_index("level")["seconds"].reindex(levels)
    found, marks = {}, []
    for label in labels:
        own = content.rows(table, method=label).set_index("level").reindex(levels)
        never = ~np.isfinite(own["seconds"]), ~np.isfinite(reference)
        found[label] = own[["ratio", "ratio_low", "ratio_high"]].mask(never[0] | never[1])
        found[label]["instead"] = np.select(never, ["not reached", "baseline: not reached"], "")
    ends = _values(pandas.concat(found.values()), *(f"ratio{end}" for end in _ENDS))
    ends = ends[np.isfinite(ends) & (ends > 0)]
    y = log_axis("speed-up", np.array([0.55, *ends, 1.8]))
    width = 0.8 / len(labels)
    for place, (label, own) in enumerate(found.items()):
        ratio, low, high = (own[f"ratio{end}"].to_numpy() for end in _ENDS)
        marks.append(
            Bars(
                label,
                at=np.arange(len(levels)) - 0.4 + width * (place + 0.5),
                length=ratio - 1,
                base=np.ones(len(levels)),
                width=width * 0.9,
                **_within(y, low, high),
                instead=own["instead"].tolist(),
                words=[
                    instead or f"{ratio:.3g}×" + (f" [{low:.3g}, {high:.3g}]" if low == low else "")
                    for ratio, low, high, instead in own.itertuples(index=False)
                ],
            )
        )
    x = names_axis([content.level_name(x) for x in levels], "share of the start's error", 3)
    rule = Rule(1.0, base, colour="black")
    return Panel(x, y, [*marks, rule], content.SHORT[measure], 3.1)


def prices(comparison: Comparison, scene: str, styles: dict[str, Style]) -> Chart | None:
    """What each halving of the error costs, and beside it the late slopes against −1/2."""
    shown = content.measures(comparison, scene)
    if not shown:
        return None
    rows = {
        measure: {label: content.price(comparison, scene, measure, label) for label in styles}
        for measure in shown
    }
    every = pandas.concat([own for each in rows.values() for own in each.values()])
    slopes = _values(every, *(f"slope_seconds{end}" for end in _ENDS))
    slopes = np.append(slopes[np.isfinite(slopes)], MONTE_CARLO)
    margin = 0.05 * np.ptp(slopes) + 0.02
    across = Axis("d log error / d log seconds", (slopes.min() - margin, slopes.max() + margin))
    grid = [
        [_halvings(own, content.SHORT[measure]), _slopes(own, across, content.SHORT[measure])]
        for measure, own in rows.items()
    ]
    note = (
        "What it took from twice the level to the level (cross: not reached), and the slope of log "
        "error against log seconds over the last decade of time. Dotted: −1/2, Monte Carlo, where "
        "each halving costs four times the one before."
    )
    return Chart("price", "Price of accuracy", note, grid, styles)


def _halvings(rows: dict[str, pandas.DataFrame], measure: str) -> Panel:
    """Marginal seconds of each halving, side by side; a cross at the top where not reached."""
    rows = {label: own for label, own in rows.items() if len(own)}
    every = pandas.concat(rows.values())
    levels = sorted(every["level"].unique(), reverse=True)
    y = log_axis("billed seconds", _values(every, *(f"seconds{end}" for end in _ENDS)), 0.12)
    if y.limits is None:  # no method has halved its error even once
        y = Axis(y.label, (0.1, 10.0), log=True, ticks={}, grid=False)
    marks = []
    for place, (label, own) in enumerate(rows.items()):
        x = np.searchsorted(-np.array(levels), -own["level"].to_numpy())
        x = x + 0.5 * (place + 0.5) / len(rows) - 0.25
        seconds, low, high = (own[f"seconds{end}"].to_numpy() for end in _ENDS)
        has = np.isfinite(seconds)
        ends = _within(y, np.where(has, low, np.nan), np.where(has, high, np.nan))
        words = [f"{value:.4g} s" for value in seconds]
        own_points = np.where(has, seconds, np.nan)
        marks.append(Points(label, x, own_points, **ends, line=1.0, symbol="o", words=words))
        top = np.full((~has).sum(), y.limits[1] / 1.1)
        words = ["not reached"] * len(top)
        marks.append(Points(label, x[~has], top, line=0, symbol="x", words=words))
    names = [content.level_name(level) for level in levels]
    x = names_axis(names, "share of the start's error at which the halving ends", 3)
    return Panel(x, y, marks, f"{measure}: seconds of each halving", 2.9)


def _slopes(rows: dict[str, pandas.DataFrame], across: Axis, measure: str) -> Panel:
    """The late slope of each method, with its interval."""
    marks: list[Points | Rule] = [Rule(MONTE_CARLO, colour=GREY, dotted=True, upright=True)]
    for place, (label, own) in enumerate(rows.items()):
        slope, low, high = (own[f"slope_seconds{end}"].to_numpy()[:1] for end in _ENDS)
        at = np.full(len(slope), float(place))
        words = [f"{value:.3f}" for value in slope]
        marks.append(
            Points(label, slope, at, low, high, sideways=True, line=0, symbol="o", words=words)
        )
    names = [shortened(label, 1.6) for label in rows]
    title = f"{measure}: late slope"
    return Panel(across, rows_axis(names), marks, title, 1.3 + 0.25 * len(rows))


def _within(y: Axis, low: Sequence[float], high: Sequence[float]) -> dict[str, np.ndarray]:
    """Ends of intervals; one at 0 or infinity runs out of the panel."""
    bottom, top = y.limits
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    return {"low": np.maximum(low, bottom / 2), "high": np.minimum(high, top * 2)}


def _values(table: pandas.DataFrame, *columns: str) -> np.ndarray:
    return table[list(columns)].to_numpy(dtype=float).ravel()
