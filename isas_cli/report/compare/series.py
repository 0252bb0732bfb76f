"""One run's error as a function of what it has cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...records import Run

MEASURES = ("image_rmse", "parameter_rmse")
AXES = ("seconds", "paths")


@dataclass(frozen=True)
class Series:
    """A run's error at its evaluations: ``error (rows,)`` above 0, ``cost[axis] (rows,)``
    non-decreasing, row 0 the start, which costs nothing but what measured the plan."""

    seed: int | None
    error: np.ndarray
    cost: dict[str, np.ndarray]

    def at(self, x: np.ndarray, axis: str) -> np.ndarray:
        """The error at costs ``x``: the start's before the first row, NaN beyond the last.

        Between evaluations log error is linear in log cost, which is exact for a power law; in
        the first gap, where the logarithm of the start's cost is not finite, in cost itself.
        """
        cost, log_error = self.cost[axis], np.log(self.error)
        row = np.clip(np.searchsorted(cost, x, side="right") - 1, 0, len(cost) - 2)
        begin, end = cost[row], cost[row + 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(begin > 0, np.log(x / begin) / np.log(end / begin), x / end)
        share = np.where(begin == end, 1.0, share)
        error = np.exp(log_error[row] + share * (log_error[row + 1] - log_error[row]))
        error = np.where(x < cost[0], self.error[0], error)
        return np.where(x > cost[-1], np.nan, error)

    def reached(self, level: float, axis: str) -> float:
        """The cost from which on the error stays at or below ``level``; +inf when it does not.

        Not the first time below it: an Adam step that swings a scalar through its true value has
        an error of 0 for a moment, and a biased method may pass a level on its way to a worse end.
        Neither has the accuracy that a first crossing would credit it with. The evaluation's own
        noise is no reason against the stricter rule: it repeats its random numbers, so that ups
        and downs between evaluations are moves of the parameters, and the parameters' own error
        has no noise at all. Reached means thus that the *final* error is at or below the level.
        The price: where a curve runs flat along a level, the cost hangs on small moves; the
        interval over seeds shows how much.
        """
        cost = self.cost[axis]
        above = np.flatnonzero(self.error > level)
        if above.size == 0:
            return float(cost[0])
        last = above[-1]
        if last == len(cost) - 1:
            return float("inf")
        before, after = self.error[last], self.error[last + 1]
        share = np.log(before / level) / np.log(before / after)
        begin, end = cost[last], cost[last + 1]
        if begin > 0:
            return float(begin * (end / begin) ** share)
        return float(end * share)


def read(run: Run, measure: str) -> Series | None:
    """The series of a measure, None where it is not known (no truth) or its start is not.

    Evaluations without a finite error are left out. An error of 0 is one that the evaluation
    could not tell from 0: it counts as the smallest one that it could tell, so that it reaches
    what this run was seen to reach, and not every level there is. Where that is the start's, it
    counts as half of it: it was seen to fall.
    """
    error = run.history[measure].to_numpy()
    finite = np.isfinite(error)
    if finite.sum() < 2 or not finite[0] or not error[0] > 0:
        return None
    cost = {axis: run.history[axis].to_numpy(dtype=float)[finite] for axis in AXES}
    error = error[finite]
    least = error[error > 0].min()
    told = least if least < error[0] else error[0] / 2
    return Series(seed(run), np.where(error > 0, error, told), cost)


def known(runs: list[Run], measure: str) -> list[Series]:
    """The series of those runs that have one."""
    return [series for run in runs if (series := read(run, measure))]


def seed(run: Run) -> int | None:
    """The seed of the run's own random streams."""
    known = run.config.get("seed")
    return (run.manifest.get("seeds") or {}).get("run") if known is None else known


def times(series: list[Series], levels: np.ndarray, axis: str) -> np.ndarray:
    """Costs ``(levels, runs)`` of ``levels``, shares of each run's own start; +inf: not reached."""
    return np.array(
        [[s.reached(level * s.error[0], axis) for s in series] for level in levels]
    ).reshape(len(levels), len(series))


def same_seeds(first: list[Series], second: list[Series]) -> bool:
    """Whether runs can be paired, one by one, by their seeds."""
    seeds = [s.seed for s in first]
    return seeds == [s.seed for s in second] and None not in seeds
