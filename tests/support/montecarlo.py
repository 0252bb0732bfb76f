"""Tests of means and distributions: written once, so that every estimator meets the same bar."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats


@dataclass
class Comparison:
    """Welch's test of two sets of repeated vector estimates, Bonferroni over the entries.

    ``worst``: the entry that differs most surely; of that entry ``difference`` of the means,
    ``interval`` (half the 95 % confidence interval of the difference) and ``smallest_visible``,
    the bias that 95 % of such tests would notice. ``always_visible``: the same for the entry where
    least can be seen, so a larger bias of any entry is noticed. ``p_value``: corrected.
    """

    p_value: float
    worst: int
    difference: float
    interval: float
    smallest_visible: float
    always_visible: float

    def __str__(self) -> str:
        return (
            f"{self.worst}: difference {self.difference:.3g} ± {self.interval:.2g}, corrected p "
            f"{self.p_value:.3g}, smallest bias that 95 % of such tests would notice: there "
            f"{self.smallest_visible:.3g}, anywhere {self.always_visible:.3g}"
        )


def welch(a: np.ndarray, b: np.ndarray, level: float = 0.001) -> Comparison:
    """``a (K, m)``, ``b (L, m)``: independent estimates of the same m means. ``level``: below
    which corrected p-value the caller rejects, for the smallest visible bias."""
    assert np.isfinite(a).all() and np.isfinite(b).all(), "estimates that are not finite"
    test = stats.ttest_ind(a, b, axis=0, equal_var=False)
    used = np.where(np.isnan(test.pvalue), 1.0, test.pvalue)  # entries that are constant
    worst = int(np.argmin(used))
    error = np.sqrt(a.var(axis=0, ddof=1) / len(a) + b.var(axis=0, ddof=1) / len(b))
    visible = (stats.norm.isf(level / a.shape[1] / 2) + stats.norm.isf(0.05)) * error
    return Comparison(
        p_value=float(min(1.0, used[worst] * a.shape[1])),
        worst=worst,
        difference=float(a[:, worst].mean() - b[:, worst].mean()),
        interval=float(stats.norm.isf(0.025) * error[worst]),
        smallest_visible=float(visible[worst]),
        always_visible=float(visible.max()),
    )


def z_against(a: np.ndarray, exact: np.ndarray) -> float:
    """Bonferroni-corrected p-value of the hypothesis that ``a (K, m)`` has the means ``exact``."""
    assert np.isfinite(a).all(), "estimates that are not finite"
    p = stats.ttest_1samp(a, exact, axis=0).pvalue
    return float(min(1.0, np.nanmin(p) * a.shape[1]))


def chi_square(counts: np.ndarray, probability: np.ndarray, least: float = 5.0) -> float:
    """p-value of drawn ``counts``; cells expected below ``least`` are pooled."""
    expected = probability * counts.sum()
    rare = expected < least
    observed = np.append(counts[~rare], counts[rare].sum())
    wanted = np.append(expected[~rare], expected[rare].sum())
    keep = wanted > 0
    if keep.sum() < 2:
        return 1.0
    assert observed[~keep].sum() == 0, "drew what has no probability"
    return float(stats.chisquare(observed[keep], wanted[keep] * counts.sum() / wanted.sum()).pvalue)
