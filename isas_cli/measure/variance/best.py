"""The best that any pmf can do."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import uniform_filter

from ...rendering.pixels import PixelDistribution
from .moments import Moments

# Uniform share: no pixel may become unreachable because none of its paths counted.
_FLOOR = 0.01
_WIDTHS = (3, 7)  # of the neighbourhood, pixels (tiles of large films)
_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the neighbourhood's mean


@dataclass
class Best:
    """p_j ∝ √A_j, the pmf that minimises Σ_j A_j / p_j (ISAS Eq. 8, with the channels of a pixel on
    one path, and no cells, denoiser or product of means).

    From measured A_j. Their noise makes the pmf worse than the true one, so some of each A_j is
    replaced by the mean of its neighbourhood: ``share`` and ``width`` are those of least Σ A/p with
    p from one half of the paths and A from the other, both ways.

    ``second_moment``: that least sum. It is what a pmf from half of the paths does, measured by
    others: the true best is lower. ``bound``: (Σ_j √A_j)² with the measured A_j, below the true
    best on average, as the root of a noisy number is too small on average. The truth lies between.
    """

    distribution: PixelDistribution
    share: float
    width: int
    second_moment: float
    bound: float


def find(moments: Moments) -> Best:
    """The best pmf that ``moments`` tell of. Evaluates."""
    order = _Order(moments)
    crossed = {}
    for share in _SHARES:
        for width in _WIDTHS if share else _WIDTHS[:1]:
            sums = []
            for own, other in ((0, 1), (1, 0)):
                weights = order.roots(moments.halves[own], share, width)
                total = np.sum(moments.pixels * weights)
                uniform = 1 / moments.problem.views.total
                p = (1 - _FLOOR) * weights / total + _FLOOR * uniform if total > 0 else uniform
                sums.append(moments.sum_over(p, moments.halves[other]))
            crossed[share, width] = float(np.mean(sums))
    share, width = min(crossed, key=crossed.get)
    weights = order.roots(moments.mean, share, width)
    top = weights.max()
    distribution = PixelDistribution.from_weights(
        mi.Float((weights / (top if top > 0 else 1)).astype(np.float32)), moments.tiles, _FLOOR
    )
    dr.eval(distribution.cdf)
    roots = np.sqrt(np.maximum(moments.mean, 0))
    bound = float(np.sum(moments.pixels * roots) ** 2)
    return Best(distribution, share, width, crossed[share, width], bound)


class _Order:
    """Between slots and the rows and columns of each view's tiles."""

    def __init__(self, moments: Moments):
        grid = moments.tiles.grid
        place = grid.index(*grid.locate_slot(dr.arange(mi.UInt32, grid.total)))
        self._place, self._sizes = np.array(place), grid.sizes

    def roots(self, contributions: np.ndarray, share: float, width: int) -> np.ndarray:
        """√A by slot, ``share`` of A from the mean over ``width`` × ``width`` tiles around."""
        mixed = contributions
        if share:
            stored = np.empty_like(contributions)
            stored[self._place] = contributions
            offset = 0
            for columns, rows in self._sizes:
                part = slice(offset, offset + columns * rows)
                image = stored[part].reshape(rows, columns)
                stored[part] = uniform_filter(image, width, mode="nearest").ravel()
                offset += columns * rows
            mixed = (1 - share) * contributions + share * stored[self._place]
        return np.sqrt(np.maximum(mixed, 0))
