"""`isas compare`: tables, plots and one page over finished runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import pandas
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from ..engine.display import say
from ..report import compare
from ..report.compare.facts import number
from ..report.compare.tables import NOT_REACHED
from . import one


def main(
    folders: list[Path],
    output: Path | None = None,
    baseline: str | None = None,
    warnings: Sequence[str] = (),
) -> int:
    """Compare, print a short table for each scene and, as the last line, where the page is.

    Warnings, and those of whoever calls, go to standard error and into the page. Returns 0; raises
    InputError like `compare.compare`, before anything is read where nothing can be written.
    """
    target = compare.output_of(folders, output)
    one.check_writable(target, "give another with --output DIR")
    comparison = compare.build(folders, baseline, warnings)
    page = compare.write(comparison, target)
    for warning in comparison.warnings:
        say(f"warning: {warning}")
    console = Console()
    for scene, label in comparison.baseline.items():
        console.print(short_table(comparison, scene, label))
    print(f"report: {page}")
    return 0


def short_table(comparison: compare.Comparison, scene: str, baseline: str) -> Table:
    """Final errors, and seconds with their ratio to the baseline for a few levels.

    The levels are of the parameters' error where any method halved it, else of the image's.
    """
    rows = comparison.summary[comparison.summary["scene"] == scene]
    costs = comparison.accuracy[comparison.accuracy["scene"] == scene]
    known = [m for m in ("parameter_rmse", "image_rmse") if m in set(costs["measure"])]
    reached = set(costs[costs["seconds"] < math.inf]["measure"])
    measure = next((m for m in known if m in reached), known[0])
    costs = costs[costs["measure"] == measure]
    levels = _levels(costs, baseline)
    errors = known[::-1]
    what = measure.replace("_rmse", "")
    table = Table(
        Column("method", overflow="fold"),  # a label cut short would be another's
        "runs",
        *(f"final {name.replace('_rmse', '')}" for name in errors),
        *(f"s to {Fraction(level)}" for level in levels),
        title=f"{escape(scene)}: errors (share of the start's), and billed seconds to a share of "
        f"the start's {what} error (× faster than {escape(baseline)})",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for _, row in rows.iterrows():
        cells = [f"{row[name]:.3g} ({row[f'{name}_share']:.1%})" for name in errors]
        own = costs[costs["method"] == row["method"]].set_index("level")
        cells += [_cost(own, level) for level in levels]
        table.add_row(escape(row["method"]), str(row["runs"]), *cells)
    return table


def _levels(costs: pandas.DataFrame, baseline: str) -> list[float]:
    """Where the methods can be told apart: the last two levels that the baseline reaches, and the
    deepest that any does. All others are in accuracy_time.csv."""
    reached = costs[costs["seconds"] < math.inf].sort_values("level", ascending=False)
    shared = reached[reached["method"] == baseline]["level"]
    return sorted({*shared[-2:], *reached["level"][-1:]}, reverse=True) or [0.5]


def _cost(own: pandas.DataFrame, level: float) -> str:
    if level not in own.index:
        return "–"
    seconds, ratio = own.loc[level, "seconds"], own.loc[level, "ratio"]
    if math.isinf(seconds):
        return NOT_REACHED
    return number(seconds) + (f" (×{ratio:.2f})" if math.isfinite(ratio) else "")
