"""How sure variances, their ratios and differences of means are."""

from __future__ import annotations

import numpy as np
from scipy import stats

from ...report.compare.bootstrap import Estimate

_RESAMPLES = 4000
_BLOCKS = 256  # rounds, or blocks of neighbouring ones, at most
_SEED = 20260101


class Bootstrap:
    """Variances of several samplers and their ratios, with bootstrap intervals.

    ``sums (rounds, m)``: Σ w of the m samplers' estimates in each round (``Tally``); ``counts
    (rounds,)``: how many terms a round has. The variance is Σ sums / Σ counts. Whole rounds are
    resampled, as all estimates of a round share one pmf: a lucky look is one piece of luck, not
    sixteen. (Of very many rounds, blocks of them.) The same rounds are taken for all samplers,
    whose estimates share random numbers. Percentile intervals: they are somewhat too narrow for few
    rounds, where a round's look keeps a share of those before (``stage1.average``), as it shares
    their luck, and where now and then an estimate is far off, as nothing that was not drawn can be
    resampled.
    """

    def __init__(self, sums: np.ndarray, counts: np.ndarray):
        self._values = _quotient(sums.sum(axis=0), counts.sum())
        if len(counts) > _BLOCKS:
            starts = np.linspace(0, len(counts), _BLOCKS, endpoint=False).astype(int)
            sums, counts = np.add.reduceat(sums, starts), np.add.reduceat(counts, starts)
        rounds = len(counts)
        self._drawn = None
        if rounds > 1:
            rng = np.random.default_rng(_SEED)
            times = rng.multinomial(rounds, np.full(rounds, 1 / rounds), _RESAMPLES)
            self._drawn = _quotient(times @ sums, (times @ counts)[:, None])

    def variance(self, index: int) -> Estimate:
        drawn = None if self._drawn is None else self._drawn[:, index]
        return _estimate(self._values[index], drawn)

    def ratio(self, above: int, below: int) -> Estimate:
        """variance(above) / variance(below)."""
        drawn = None
        if self._drawn is not None:
            drawn = _quotient(self._drawn[:, above], self._drawn[:, below])
        return _estimate(_quotient(self._values[above], self._values[below]), drawn)


def _quotient(above, below) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(above, float) / below


def _estimate(value: float, drawn: np.ndarray | None) -> Estimate:
    if drawn is None or not np.isfinite(drawn).all():
        return Estimate(float(value), np.nan, np.nan)
    return Estimate(float(value), *np.quantile(drawn, [0.025, 0.975]).tolist())


def bias(projections: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """Whether two sets of estimates have one mean: z of the direction that differs most surely, and
    the p-value, Bonferroni-corrected over all directions.

    ``projections``, ``reference``: ``(repeats, D)``; the same row has the same random numbers, so
    the differences of rows are tested (paired t). NaN where they do not differ at all.
    """
    away = projections - reference
    repeats, directions = away.shape
    if repeats < 2:
        return np.nan, np.nan
    error = away.std(axis=0, ddof=1) / np.sqrt(repeats)
    z = _quotient(away.mean(axis=0), error)
    if not np.isfinite(z).any():
        return np.nan, np.nan
    worst = float(z[np.nanargmax(np.abs(z))])
    p = 2 * float(stats.t.sf(abs(worst), repeats - 1)) * directions
    return worst, min(1.0, p)
