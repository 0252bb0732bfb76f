"""The results: one row for each sampler, on the disk and in a terminal."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas
from rich.markup import escape
from rich.table import Table

from ...engine.display import number
from ...records.files import write_text
from ...report.compare.accuracy import named
from ...report.compare.bootstrap import Estimate
from .best import Best
from .intervals import Bootstrap, bias
from .rounds import Contestant

FILE = "variance.csv"
UNIFORM, GRADIENT, BEST = "uniform", "gradient", "best pmf"
COLUMNS = (
    "sampler",
    *("variance", "variance_low", "variance_high"),
    *("ratio_to_uniform", "ratio_to_uniform_low", "ratio_to_uniform_high"),
    *("ratio_to_gradient", "ratio_to_gradient_low", "ratio_to_gradient_high"),
    *("ratio_to_best", "ratio_to_best_low", "ratio_to_best_high"),
    *("variance_iid", "variance_iid_bound"),
    *("seconds_per_estimate", "seconds_step", "seconds_look", "looks_per_estimate"),
    "paths_per_estimate",
    "efficiency",
    *("bias_z", "bias_p"),
    *("nonfinite", "repeats", "batch"),
)


@dataclass
class Results:
    """What ``table`` needs to know of the measurement besides the contestants."""

    batch: int
    paths: int  # of an estimate
    best: Best | None


def rows(contestants: list[Contestant], rounds: list[int], results: Results) -> list[dict]:
    """A row for each contestant, in their order, from all whole rounds. What is not known is NaN.

    variance: trace of the gradient's covariance, in (∂ℒ/∂θ)². ratio_…: of variances, intervals as
    ``Bootstrap`` has them. variance_iid: what independent draws would have, in closed form from the
    pixels' second moments; variance_iid_bound: the least that it can be with any pmf, too low on
    average (see ``Best``). Seconds are medians; per estimate: a step, from the unknowns put into
    the scene to their gradients, without Adam's own step, and the share of a look that a run of
    1,000 steps takes with each (the one at its start, with a survey or a mask, does not count).
    efficiency: 1/(variance × seconds per estimate), uniform's is 1. bias_z, bias_p: see ``bias``,
    against uniform. batch: pixels drawn per estimate.
    """
    counts = np.array(rounds)
    repeats = int(counts.sum())
    ends = np.cumsum(counts)[:-1]
    sums = np.array(
        [
            [part.sum() for part in np.split(np.array(c.tally.steps[:repeats]), ends)]
            for c in contestants
        ]
    ).T
    # The first estimate has no earlier one to differ from: one step fewer than estimates.
    terms = counts - (np.arange(len(counts)) == 0)
    bootstrap = Bootstrap(sums, terms)
    place = {c.label: i for i, c in enumerate(contestants)}
    squared = _squared_gradient(contestants, bootstrap)
    made = [
        _row(c, i, bootstrap, place, repeats, squared, results) for i, c in enumerate(contestants)
    ]
    own = made[place[UNIFORM]]
    price = own["variance"] * own["seconds_per_estimate"]
    reference = np.array(contestants[place[UNIFORM]].tally.projections[:repeats])
    for row, contestant in zip(made, contestants):
        cost = row["variance"] * row["seconds_per_estimate"]
        row["efficiency"] = price / cost if cost > 0 else math.nan
        row["bias_z"] = row["bias_p"] = math.nan
        if contestant.label != UNIFORM:
            projections = np.array(contestant.tally.projections[:repeats])
            row["bias_z"], row["bias_p"] = bias(projections, reference)
    return made


def _row(
    contestant: Contestant,
    index: int,
    bootstrap: Bootstrap,
    place: dict[str, int],
    repeats: int,
    squared: float,
    results: Results,
) -> dict:
    step = float(np.median(contestant.estimates[:repeats]))
    look = float(np.median(contestant.looks)) if contestant.looks else 0.0
    share = contestant.looks_per_estimate
    row = {"sampler": contestant.label}
    row |= named("variance", bootstrap.variance(index))
    nothing = Estimate(*[math.nan] * 3)
    for name, other in (("uniform", UNIFORM), ("gradient", GRADIENT), ("best", BEST)):
        known = other in place
        ratio = bootstrap.ratio(index, place[other]) if known else nothing
        row |= named(f"ratio_to_{name}", ratio)
    row["variance_iid"] = row["variance_iid_bound"] = math.nan
    if contestant.second_moments:
        second = float(np.mean(contestant.second_moments))
        row["variance_iid"] = (second - squared) / results.batch
    if contestant.label == BEST:
        row["variance_iid"] = (results.best.second_moment - squared) / results.batch
        row["variance_iid_bound"] = (results.best.bound - squared) / results.batch
    return row | {
        "seconds_per_estimate": step + share * look,
        "seconds_step": step,
        "seconds_look": look,
        "looks_per_estimate": share,
        "paths_per_estimate": results.paths + share * contestant.paths_per_look,
        "nonfinite": contestant.tally.nonfinite,
        "repeats": repeats,
        "batch": results.batch,
    }


def _squared_gradient(contestants: list[Contestant], bootstrap: Bootstrap) -> float:
    """‖∇‖² without the noise of the mean, from the contestant that knows it best."""
    variances = [bootstrap.variance(i).value for i in range(len(contestants))]
    if not np.isfinite(variances).all():
        return math.nan
    surest = int(np.argmin(variances))
    tally = contestants[surest].tally
    # Of an interrupted round as well: the mean is of all estimates.
    return tally.squared_norm - variances[surest] / len(tally.steps)


def write(table: list[dict], folder: Path) -> None:
    """variance.csv; a blank is what is not known. Raises IsasError when the disk refuses."""
    write_text(folder / FILE, pandas.DataFrame(table, columns=COLUMNS).to_csv(index=False))


def shown(table: list[dict], title: str) -> Table:
    """What a person sees."""
    made = Table(box=None, pad_edge=False, title=escape(title), title_justify="left")
    made.add_column("sampler", overflow="fold")
    titles = ("variance", "of uniform's (95 %)", "of |∂ℒ|'s (95 %)", "of the best's (95 %)")
    for name in (*titles, "ms", "efficiency", "bias z"):
        made.add_column(name, justify="right", overflow="fold")
    for row in table:
        made.add_row(
            escape(row["sampler"]),
            number(row["variance"]),
            *(_with_span(row, f"ratio_to_{name}") for name in ("uniform", "gradient", "best")),
            number(1e3 * row["seconds_per_estimate"]),
            number(row["efficiency"]),
            _flagged(row),
        )
    return made


def _with_span(row: dict, name: str) -> str:
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    span = "" if math.isnan(low) or low == high else f" ({low:.3g} … {high:.3g})"
    return f"{number(row[name])}{span}"


def _flagged(row: dict) -> str:
    z = row["bias_z"]
    if math.isnan(z):
        return "–"
    return f"[red]{z:.1f} biased[/]" if biased(row) else f"{z:.1f}"


def biased(row: dict) -> bool:
    """Whether chance alone would make the mean differ so from uniform's once in 10,000 times."""
    return row["bias_p"] < 1e-4
