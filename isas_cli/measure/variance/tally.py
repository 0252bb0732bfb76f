"""Repeated estimates of one gradient, reduced to a few numbers each as they come."""

from __future__ import annotations

import numpy as np

# Unknowns of up to so many entries are compared entry by entry.
_FEW = 8
_RANDOM = 4


class Directions:
    """Fixed unit vectors along which the means of two sets of estimates are compared.

    Of an unknown with few entries, each entry. Of a texture: the mean gradient of a ``pilot``, as a
    missing weight scales the gradient and shows there first; all entries alike; and four of random
    signs, for what neither would show. A vector lies within one unknown, whatever its unit.
    """

    def __init__(self, pilot: dict[str, np.ndarray], seed: int):
        """``pilot``: by key, flat, independent of all estimates that will be compared."""
        rng = np.random.default_rng(seed)
        self._vectors = {key: self._of(mean, rng) for key, mean in pilot.items()}

    @staticmethod
    def _of(pilot: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        size = pilot.size
        if size <= _FEW:
            return np.eye(size, dtype=np.float32)
        rows = [np.ones(size, np.float32)]
        for _ in range(_RANDOM):
            rows.append(rng.integers(0, 2, size, np.int8).astype(np.float32) * 2 - 1)
        rows = [row / np.float32(size**0.5) for row in rows]
        norm = np.linalg.norm(pilot.astype(np.float64))
        if norm > 0:
            rows.append((pilot / norm).astype(np.float32))
        return np.array(rows)

    def __call__(self, gradients: dict[str, np.ndarray]) -> np.ndarray:
        """``gradients`` (by key, flat) along every vector, ``(D,) float64``."""
        parts = []
        for key, vectors in self._vectors.items():
            # Row by row in double precision, without a copy of all vectors.
            parts += [np.dot(row.astype(np.float64), gradients[key]) for row in vectors]
        return np.array(parts)


class Tally:
    """What is kept of the estimates g_1, g_2, … of one gradient: a mean per entry, and per estimate
    one number for the variance and a few for the mean.

    The number is the step of Welford's recursion, here for all entries together,

        w_r = (r - 1)/r ‖g_r - ḡ_{r-1}‖²,   ḡ_r the mean of the first r.

    Their sum from 2 to R is Σ_r ‖g_r - ḡ_R‖² exactly, so Σ w_r / (R - 1) is the usual unbiased
    estimate of the trace of the covariance. Each w_r has that trace as its expectation by itself,
    they are uncorrelated for Gaussian estimates (Helmert's transformation), and w_r tends to the
    squared deviation from the true mean: they can be resampled like squared deviations from the
    pooled mean, which a second pass over all estimates would be needed for. In double precision.

    ``steps``: w_r, the first 0; ``projections``: ``(D,)`` each; ``nonfinite``: entries that were
    not finite and count as zero, as in Adam's step.
    """

    def __init__(self, directions: Directions):
        self._directions = directions
        self.mean: dict[str, np.ndarray] = {}
        self.steps: list[float] = []
        self.projections: list[np.ndarray] = []
        self.nonfinite = 0

    def add(self, gradients: dict[str, np.ndarray]) -> None:
        """One more estimate, by key, flat. Non-finite entries are replaced in place."""
        number, step = len(self.steps) + 1, 0.0
        for key, entries in gradients.items():
            bad = ~np.isfinite(entries)
            if bad.any():
                self.nonfinite += int(bad.sum())
                entries[bad] = 0
            if number == 1:
                self.mean[key] = entries.astype(np.float64)
                continue
            away = entries - self.mean[key]
            step += float(np.dot(away, away)) * (number - 1) / number
            away /= number
            self.mean[key] += away
        self.steps.append(step)
        self.projections.append(self._directions(gradients))

    @property
    def squared_norm(self) -> float:
        """Of the mean: ‖ḡ‖², which is ‖∇‖² and the variance of the mean together."""
        return float(sum(np.dot(mean, mean) for mean in self.mean.values()))
