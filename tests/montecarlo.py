"""Tests of means and distributions: written once, so that every estimator meets the same bar."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats


@dataclass
class Comparison:
    """Welch's test of two sets of repeated vector estimates, Bonferroni over the entries."""

    p_value: float
    worst: int
    difference: float
    smallest_visible: float

    def __str__(self) -> str:
        return (
            f"{self.worst}: difference {self.difference:.3g}, corrected p {self.p_value:.3g}, "
            f"smallest bias that 95 % of such tests would notice there: {self.smallest_visible:.3g}"
        )


def welch(a: np.ndarray, b: np.ndarray) -> Comparison:
    """``a (K, m)``, ``b (L, m)``: independent estimates of the same m means."""
    test = stats.ttest_ind(a, b, axis=0, equal_var=False)
    used = np.where(np.isnan(test.pvalue), 1.0, test.pvalue)  # entries that are constant
    worst = int(np.argmin(used))
    error = np.sqrt(a[:, worst].var(ddof=1) / len(a) + b[:, worst].var(ddof=1) / len(b))
    alpha = 0.001 / a.shape[1]
    visible = (stats.norm.isf(alpha / 2) + stats.norm.isf(0.05)) * error
    difference = a[:, worst].mean() - b[:, worst].mean()
    return Comparison(min(1.0, used[worst] * a.shape[1]), worst, difference, visible)


def z_against(a: np.ndarray, exact: np.ndarray) -> float:
    """Bonferroni-corrected p-value of the hypothesis that ``a (K, m)`` has the means ``exact``."""
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
