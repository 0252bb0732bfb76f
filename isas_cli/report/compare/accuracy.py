"""What accuracy costs: seconds and paths that each method needs for each level of error."""

from __future__ import annotations

import itertools

import numpy as np
import pandas

from . import bootstrap
from .bootstrap import Estimate
from .gather import Method, by_measure
from .series import AXES, Series, same_seeds, times

COLUMNS = [
    *("scene", "measure", "level", "method", "runs", "reached"),
    *("seconds", "seconds_low", "seconds_high", "paths", "paths_low", "paths_high"),
    *("ratio", "ratio_low", "ratio_high"),
]


def table(methods: list[Method], baseline: dict[str, str]) -> pandas.DataFrame:
    """One row per scene, measure, level and method.

    ``level``: share of the start's error, 1/2, 1/4, … down to the deepest that any run of the scene
    reaches and the one below it, which none does. ``seconds`` (billed) and ``paths``: median over
    seeds of the cost from which on the error stays at or below the level (`Series.reached`), with
    an interval; +inf: not reached. A median is +inf unless more than half of the ``runs``
    have ``reached`` it, whatever more budget would have brought.

    ``ratio``: the baseline's ``seconds`` divided by this method's, above 1 where this method is
    faster. +inf: of the two only this method reached the level; 0: only the baseline did; NaN:
    neither. Where both have the same seeds, these are resampled in pairs, so that what a seed
    does to both cancels. Bounds are NaN where a side has one run only.
    """
    rows = []
    for scene, measure, found in by_measure(methods):
        levels, base = levels_of(found), found.get(baseline[scene], [])
        parts = [_of_method(own, base, levels).assign(method=m) for m, own in found.items()]
        if parts:
            part = pandas.concat(parts).sort_values("level", ascending=False, kind="stable")
            rows.append(part.assign(scene=scene, measure=measure)[COLUMNS])
    return pandas.concat(rows, ignore_index=True) if rows else pandas.DataFrame(columns=COLUMNS)


def levels_of(found: dict[str, list[Series]]) -> np.ndarray:
    """1/2, 1/4, … down to the first that no run's final error is at or below."""
    deepest = 1
    for s in itertools.chain(*found.values()):
        while s.error[-1] <= s.error[0] * 0.5**deepest:
            deepest += 1
    return 0.5 ** np.arange(1, deepest + 1)


def _of_method(series: list[Series], base: list[Series], levels: np.ndarray) -> pandas.DataFrame:
    costs = {axis: times(series, levels, axis) for axis in AXES}
    columns = {
        "level": levels,
        "runs": len(series),
        "reached": np.isfinite(costs["seconds"]).sum(axis=1),
    }
    for axis in AXES:
        columns |= named(axis, bootstrap.median(costs[axis]))
    return pandas.DataFrame(columns | named("ratio", _ratio(series, base, levels, costs)))


def _ratio(series: list[Series], base: list[Series], levels: np.ndarray, costs: dict) -> Estimate:
    own = costs["seconds"]
    return speed_up(times(base, levels, "seconds"), own, same_seeds(base, series), series is base)


def speed_up(base: np.ndarray, own: np.ndarray, paired: bool, itself: bool) -> Estimate:
    """Ratio of the medians of ``base`` and ``own (…, runs)``; exactly 1 of a method to itself."""
    estimate = bootstrap.ratio(base, own, paired)
    if not itself:
        return estimate
    return Estimate(
        estimate.value, *(np.where(np.isnan(b), b, estimate.value) for b in estimate[1:])
    )


def named(stem: str, estimate: Estimate) -> dict[str, np.ndarray]:
    """Columns ``stem``, ``stem_low`` and ``stem_high``."""
    return {stem: estimate.value, f"{stem}_low": estimate.low, f"{stem}_high": estimate.high}
