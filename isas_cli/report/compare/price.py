"""The price of accuracy: what the next halving of the error costs, and the curve's slope."""

from __future__ import annotations

import numpy as np
import pandas
from scipy import stats

from . import bootstrap
from .accuracy import levels_of, named
from .gather import Method, by_measure
from .series import AXES, Series, times

# The error of a mean falls with the square root of the number of independent samples.
MONTE_CARLO = -0.5
_LATE = 0.1  # share of a run's cost from which on its curve counts as late
_FEWEST = 3  # points of a line whose fit can be wrong

COLUMNS = [
    *("scene", "measure", "method", "level", "runs", "reached"),
    *("seconds", "seconds_low", "seconds_high", "paths", "paths_low", "paths_high"),
    *("slope_seconds", "slope_seconds_low", "slope_seconds_high"),
    *("slope_paths", "slope_paths_low", "slope_paths_high", "slope_monte_carlo"),
]


def table(methods: list[Method]) -> pandas.DataFrame:
    """One row per scene, measure, method and level.

    ``seconds``, ``paths``: what it took to get from twice the level to the level (for 1/2: from
    the start), median over seeds of each run's own difference, with its interval; +inf:
    not reached. Where each halving costs as much as the one before, the error falls exponentially;
    where it costs four times as much, like Monte Carlo's, which is the ``slope_monte_carlo`` of
    -1/2.

    ``slope_…``: of log error against log seconds or log paths in the late part of the curve
    (`late_slope`), median over seeds with its interval; one value for all levels of a
    method, repeated in each of its rows.
    """
    rows = []
    for scene, measure, found in by_measure(methods):
        levels = levels_of(found)
        for label, own in found.items():
            part = _of_method(own, levels).assign(scene=scene, measure=measure, method=label)
            rows.append(part[COLUMNS])
    return pandas.concat(rows, ignore_index=True) if rows else pandas.DataFrame(columns=COLUMNS)


def _of_method(series: list[Series], levels: np.ndarray) -> pandas.DataFrame:
    columns = {"level": levels, "runs": len(series), "slope_monte_carlo": MONTE_CARLO}
    for axis in AXES:
        costs = times(series, levels, axis)
        columns["reached"] = np.isfinite(costs).sum(axis=1)
        columns |= named(axis, bootstrap.median(_marginal(costs)))
        slopes = np.array([late_slope(s, axis) for s in series])
        columns |= named(f"slope_{axis}", bootstrap.median(slopes[np.isfinite(slopes)]))
    return pandas.DataFrame(columns)


def _marginal(costs: np.ndarray) -> np.ndarray:
    """Differences between successive levels, ``(levels, runs)``; +inf from where one is +inf."""
    with np.errstate(invalid="ignore"):
        steps = np.diff(costs, axis=0, prepend=0)
    return np.where(np.isfinite(costs), steps, np.inf)


def late_slope(series: Series, axis: str) -> float:
    """d log error / d log cost by least squares over the evaluations in the last decade of cost.

    A decade, because over less the noise of single evaluations tilts the line, and over more the
    steep beginning does. NaN with fewer than three evaluations there or none apart in cost. It
    says how the run went, learning-rate schedule included, and not what a longer one would do.
    """
    cost = series.cost[axis]
    late = (cost >= _LATE * cost[-1]) & (cost > 0)
    if late.sum() < _FEWEST or np.ptp(cost[late]) == 0:
        return float("nan")
    return float(stats.linregress(np.log(cost[late]), np.log(series.error[late])).slope)
