"""The tables of the page: numbers to sort by, and the words that stand for them."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas

from . import content, tables
from .gather import Comparison, Method
from .series import AXES

# methods.csv in the order of the page; a heading, and what it means where that is not plain.
_COLUMNS = {
    "runs": "runs",
    "seeds": "seeds",
    "iterations": "iterations",
    "seconds": "billed seconds",
    "paths": "light paths",
    "parameter_rmse": "final parameter RMSE",
    "parameter_rmse_share": "parameter RMSE, final / start",
    "parameter_rmse_seconds_to_baseline": "seconds to the baseline's parameter error",
    "parameter_rmse_speed_up": "speed-up there, parameters",
    "image_rmse": "final image RMSE",
    "image_rmse_share": "image RMSE, final / start",
    "image_rmse_seconds_to_baseline": "seconds to the baseline's image error",
    "image_rmse_speed_up": "speed-up there, image",
    "RE": "RE",
    "MPEA": "MPEA",
    "CS": "CS",
    "GN": "GN",
    "nonfinite": "non-finite gradient entries",
    "stage1_seconds": "stage 1, seconds",
    "stage1_share": "stage 1, share of billed",
    "step_seconds": "steps, seconds",
    "unbilled_seconds": "unbilled seconds",
}
_MEANINGS = {
    "RE": "reconstruction error, 3 · image RMSE² (PBDR Eq. 7)",
    "MPEA": "material parameter error, parameter RMSE²: smaller is better (PBDR Eq. 8)",
    "CS": "convergence speed: iterations until the image error stays near its final value (PBDR)",
    "GN": "gradient noise: mean squared distance of gradient and smoothed gradient (PBDR Eq. 9)",
    "nonfinite": "of all runs together",
}


@dataclass(frozen=True)
class Cell:
    """A table's cell: what it is sorted by, its words, and the lines below them."""

    sort: str
    text: str
    below: tuple[str, ...] = ()
    best: bool = False


@dataclass(frozen=True)
class Heading:
    """The text of a column's head and what it means."""

    text: str
    meaning: str = ""


@dataclass(frozen=True)
class Table:
    """A row of cells for each method, under one heading each."""

    title: str
    headings: list[Heading]
    rows: list[tuple[str, list[Cell]]]


def accuracy(comparison: Comparison, scene: str, methods: list[Method]) -> list[Table]:
    """For each measure: billed seconds to each level, how sure, and the ratio to the baseline."""
    made = []
    for measure in content.measures(comparison, scene):
        start = number(content.start(methods, measure))
        columns = {}
        for level in content.levels(comparison, scene, measure):
            cells = {
                m.label: content.cell(comparison, scene, measure, m.label, level) for m in methods
            }
            columns[level] = {label: row for label, row in cells.items() if row is not None}
        base = comparison.baseline[scene]
        rows = [(m.label, [_accuracy(c, m.label, base) for c in columns.values()]) for m in methods]
        heads = [Heading(content.level_name(x), f"{x:g} of the start's {start}") for x in columns]
        made.append(Table(f"{content.SHORT[measure]}, {start} at the start", heads, rows))
    return made


def headlines(comparison: Comparison, scene: str, methods: list[Method]) -> list[str]:
    """For each measure a sentence: who is soonest at the hardest level that any method reached."""
    lines = []
    for measure in content.measures(comparison, scene):
        rows = comparison.accuracy
        rows = rows[(rows["scene"] == scene) & (rows["measure"] == measure)]
        rows = rows[np.isfinite(rows["seconds"])]
        if rows.empty:
            half = content.level_name(max(content.levels(comparison, scene, measure)))
            lines.append(
                f"No method reached {half} of the start's {content.SHORT[measure]} in most of its "
                "runs."
            )
            continue
        first = rows.sort_values(["level", "seconds"]).iloc[0]
        goal = f"{content.level_name(first['level'])} of the start's {content.SHORT[measure]}"
        spread = interval(first, "seconds", " s")
        line = f"{goal}: {first['method']} in {number(first['seconds'])} s {spread}".rstrip()
        if len(methods) > 1:
            line = f"Soonest to {line}{_against(first, comparison.baseline[scene])}"
        lines.append(f"{line}.")
        both = rows[(rows["method"] == first["method"]) & np.isfinite(rows["ratio"])]
        if math.isinf(first["ratio"]) and len(both):
            row = both.sort_values("level").iloc[0]
            goal = content.level_name(row["level"])
            lines[-1] += f" To {goal}: {number(row['seconds'])} s"
            lines[-1] += f"{_against(row, comparison.baseline[scene])}."
    return lines


def _against(row: pandas.Series, base: str) -> str:
    """How a row of accuracy_time compares with its baseline, as the end of a sentence."""
    if row["method"] == base:
        return ", the baseline"
    if math.isinf(row["ratio"]):
        return f"; {base} did not reach it in most of its runs"
    unclear = row["ratio_low"] <= 1 <= row["ratio_high"]
    end = ", so which is sooner is not clear" if unclear else ""
    return f", {_ratio(row)} as fast as {base}{end}"


def _ratio(row: pandas.Series) -> str:
    """A speed-up and its interval, if that says more."""
    both = [f"{end:g}" for end in (row["ratio_low"], row["ratio_high"])]
    spread = "" if both == ["inf", "inf"] else interval(row, "ratio")
    return f"{times(row['ratio'])} {spread}".rstrip()


def price(comparison: Comparison, scene: str, methods: list[Method]) -> list[Table]:
    """For each measure: seconds of each halving, and the late slopes."""
    made = []
    for measure in content.measures(comparison, scene):
        levels = content.levels(comparison, scene, measure)
        heads = [Heading(content.step_name(level), "of the start's error") for level in levels]
        heads += [Heading(f"slope, {axis}", "d log error / d log cost, late") for axis in AXES]
        rows = []
        for method in methods:
            own = content.price(comparison, scene, measure, method.label)
            cells = [_spread(row, "seconds", " s", tables.NOT_REACHED) for _, row in own.iterrows()]
            if len(own):
                cells += [_spread(own.iloc[0], f"slope_{axis}", "", "infinite") for axis in AXES]
                rows.append((method.label, cells))
        made.append(Table(f"{content.SHORT[measure]}: what each halving costs", heads, rows))
    return made


def methods(comparison: Comparison, scene: str) -> Table:
    """methods.csv of one scene, without columns of which nothing is known."""
    summary = comparison.summary[comparison.summary["scene"] == scene]
    shown = [name for name in _COLUMNS if name in summary and summary[name].notna().any()]
    rows = []
    for _, row in summary.iterrows():
        cells = []
        for name in shown:
            if name == "seeds":
                cells.append(Cell(str(row[name]), str(row[name])))
            elif name.endswith("_speed_up"):
                cells.append(Cell(sort_key(row[name]), times(row[name]), _below(row, name)))
            else:
                infinite = tables.NOT_CONVERGED if name == "CS" else tables.NOT_REACHED
                cells.append(_spread(row, name, "", infinite))
        rows.append((row["method"], cells))
    heads = [Heading(_COLUMNS[name], _MEANINGS.get(name, "")) for name in shown]
    return Table("Medians over runs, with intervals", heads, rows)


def effects(methods: list[Method]) -> list[tuple[list[str], dict[str, str]]]:
    """What was simulated, as far as the records say: the plan of effects, the integrator and the
    depth of its paths; methods that agree in all of it together, by label."""
    made: list[tuple[list[str], dict[str, str]]] = []
    for method in methods:
        run = method.runs[0]
        scene = run.config.get("scene")
        depth = scene.get("max_depth") if isinstance(scene, dict) else None
        known = {
            "plan of effects": run.manifest.get("effects"),
            "integrator": run.manifest.get("integrator"),
            "longest path": None if depth is None else f"{depth} segments",
            "targets": _noise(run.manifest.get("targets")),
        }
        told = {name: _text(value) for name, value in known.items() if value is not None}
        alike = next((labels for labels, other in made if other == told), None)
        if alike is not None:
            alike.append(method.label)
        elif told:
            made.append(([method.label], told))
    return made


def _noise(floor: dict | None) -> str | None:
    """Of the manifest's ``targets``."""
    if not floor:
        return None
    if "unknown" in floor:
        return f"noise unknown: {floor['unknown']}"
    told = f"noise of {floor['noise']:.2g} of their brightness"
    if "how" in floor:
        return f"{told}, {floor['how']}"
    if "image_rmse" in floor:
        told += f"; fitting it leaves an image error of {floor['image_rmse']:.2g}"
    return told


def number(value: float | None) -> str:
    """A number to three digits, whole ones whole; NaN and infinity in words."""
    if value is None or math.isnan(value):
        return "not known"
    if math.isinf(value):
        return "infinite"
    whole = abs(value) >= 999.5 or float(value).is_integer()
    shown = f"{value:,.0f}" if whole and abs(value) < 1e15 else f"{value:.3g}"
    return shown.replace("-", "−")


def times(ratio: float) -> str:
    """A speed-up; what an infinite one and none mean, in words."""
    if math.isinf(ratio):
        return "baseline: not reached"
    if ratio == 0:
        return tables.NOT_REACHED
    return "not known" if math.isnan(ratio) else f"{number(ratio)}×"


def interval(row: pandas.Series, name: str, unit: str = "") -> str:
    """The interval of a value as [low, high]; "" for a single run."""
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    if math.isnan(low) or math.isnan(high):
        return ""
    never = math.isinf(high) and not name.endswith(("ratio", "speed_up"))
    upper = tables.NOT_REACHED if never else _bound(high)
    return f"[{_bound(low)}, {upper}]{unit if math.isfinite(high) else ''}"


def sort_key(value: float) -> str:
    """What a cell is sorted by; unknown values stay empty and come last."""
    return "" if math.isnan(value) else str(float(value)).replace("inf", "Infinity")


def _accuracy(column: dict[str, pandas.Series], label: str, base: str) -> Cell:
    """Seconds, their interval and the ratio to the baseline of one method at one level."""
    if label not in column:
        return Cell("", "not known")
    row = column[label]
    below = []
    if row["reached"] < row["runs"] and row["runs"] > 1:
        below.append(f"{row['reached']} of {row['runs']} runs")
    if math.isinf(row["seconds"]):
        return Cell("Infinity", tables.NOT_REACHED, tuple(below))
    below.insert(0, interval(row, "seconds", " s") or tables.ONE_RUN)
    if label != base and not math.isnan(row["ratio"]):
        below.append(_ratio(row))
    soonest = min(other["seconds"] for other in column.values())
    best = len(column) > 1 and row["seconds"] == soonest
    return Cell(sort_key(row["seconds"]), f"{number(row['seconds'])} s", tuple(below), best)


def _spread(row: pandas.Series, name: str, unit: str, infinite: str) -> Cell:
    """A value and, where the table has it, its interval."""
    value = row[name]
    text = infinite if math.isinf(value) else number(value)
    text += unit if math.isfinite(value) else ""
    return Cell(sort_key(value), text, _below(row, name) if math.isfinite(value) else ())


def _below(row: pandas.Series, name: str) -> tuple[str, ...]:
    spread = interval(row, name) if f"{name}_low" in row else ""
    return (spread,) if spread else ()


def _bound(value: float) -> str:
    return "∞" if math.isinf(value) else number(value)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, indent=2, ensure_ascii=False)
