"""Any sampler's pmf summed over a pyramid of resolutions (ISAS §4.2)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import drjit as dr
import mitsuba as mi

from ..rendering.kernels import recorded
from ..runtime.errors import InputError
from .ours import Ours
from .sampler import OnImages, Sampler
from .stage1.cells import Cells


class Pyramid(OnImages):
    """``Multiresolution`` at work."""

    def __init__(self, settings, problem, loss, batch, freeze=True, blurred=None):
        self.base = settings.base.on(problem, loss, batch, freeze, blurred)
        super().__init__(settings, problem, loss, batch, freeze, blurred)
        levels, share = settings.levels, 4 * settings.factor

        def combine(weights, cells):
            return pyramid(weights, cells, [share**d for d in range(levels + 1)])

        self._combine = recorded(combine, problem, freeze)

    def resolution(self, batch: int) -> int:
        return self.base.resolution(batch)

    def look(self, values, seed, iteration, moments=None, spent=0.0) -> mi.Float:
        return self._combined(self.base.look(values, seed, iteration, moments, spent))

    def measured(self, values: dict, seed: int, iteration: int) -> list[mi.Color3f] | None:
        return self.base.measured(values, seed, iteration)

    def weighed(self, images: list[mi.Color3f]) -> mi.Float:
        return self._combined(self.base.weighed(images))

    def _combined(self, weights: mi.Float) -> mi.Float:
        weights = self._combine(weights, self.cells)
        dr.eval(weights)
        return weights

    @property
    def paths_per_look(self) -> int:
        return self.base.paths_per_look

    @property
    def paths_before(self) -> int:
        return self.base.paths_before


@dataclass(frozen=True)
class Multiresolution(Sampler):
    """p_j ∝ Σ_{d=0}^D 4^d p_{j_d,d} (ISAS Eq. 18), D = ``levels``, around the sampler ``base``.

    p_{·,d} is the pmf at a resolution coarser by 2^d × 2^d, which sums to one over that level's
    pixels, and j_d the coarse pixel that holds j. Level 0 is the finest that stage 1 sees, its
    cells, and a coarse pixel's probability is the sum of its cells' under ``base``. A block B of
    4^d cells thus gives each of them 4^d Σ_B p_i = 16^d mean_B p_i. At the right and lower border
    blocks are cut off; 16^d mean_B p_i is kept there, so that level d has the mass 16^d exactly.

    **What it does.** The moments of Eq. (12) are those of single paths. A path through a random
    point of a coarse pixel has the mean of its pixels' moments, so coarse levels hold nothing
    that level 0 does not: Eq. (18) is a blur, Σ_d 16^d (mean of p over blocks) / Σ_d 16^d. As it
    is printed the coarsest level has 15/16 of the mass, for D = 4 nearly one probability for each
    block of 16 × 16 cells: it lifts what is dim beside what is bright, and it spreads over the
    silhouette onto the background. With 4^-d in place of 4^d (``factor`` = 0.25) all levels have
    the same mass. Levels count cells: with ``base.stage1.resolution`` at the films' own they are
    the paper's pixels; with coarser cells, as here by default, blocks are as much larger.

    **What the paper claims** (§4.2, Fig. 5): that a coarse pixel "affected by many parameters"
    draws more samples, so that a textured object beside an untextured one converges as fast. It
    computes p_{j',d} by stage 1 anew for each target resolution, where two things differ from
    block sums: residuals are taken against the block's mean target, and √(p_j1 p_j2) is taken of
    the means, which is at least the mean of the roots. Neither counts parameters. What does is the
    weighting of unknowns by 1/v̂ (``preconditioned``) or by coverage (``balanced``).

    ``base`` keeps its settings: its looks, cells, moments and ``floor``, which is mixed in once,
    after the sum.
    """

    uses: ClassVar[frozenset[str]] = frozenset()
    works = Pyramid

    base: Sampler = field(default_factory=Ours)
    levels: int = 4
    factor: float = 4.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.base, Multiresolution):
            raise InputError(
                "sampler.base=multiresolution: it goes around another sampler, such as "
                "sampler.base=ours"
            )
        if "blur" in self.base.needs:
            raise InputError(
                "sampler.base: multiresolution goes around a sampler that draws pixels for path "
                "replay, such as sampler.base=ours"
            )
        if not 0 <= self.levels <= 16:
            raise InputError(f"sampler.levels={self.levels}: must lie in [0, 16]")
        if not 0 < self.factor <= 1024:
            raise InputError(f"sampler.factor={self.factor}: must lie in (0, 1024]")
        for name in ("floor", "refresh", "stage1"):
            object.__setattr__(self, name, getattr(self.base, name))

    @property
    def needs(self) -> frozenset[str]:  # type: ignore[override]
        return self.base.needs

    @property
    def staged(self) -> bool:  # type: ignore[override]
        return self.base.staged

    def due(self, iteration: int) -> bool:
        return self.base.due(iteration)


def pyramid(weights: mi.Float, cells: Cells, shares: list[float]) -> mi.Float:
    """Σ_d share_d (mean of ``weights`` over each cell's block of 2^d × 2^d cells) / Σ_d share_d.

    Blocks begin at a view's upper left corner, end with the view, and keep the sum of its weights.
    ``weights (C,) float32``; non-finite and negative ones count as zero. Traced.
    """
    weights = dr.select(dr.isfinite(weights) & (weights > 0), weights, 0)
    view, column, row = cells.views.locate(dr.arange(mi.UInt32, cells.count))
    first = dr.gather(mi.UInt32, cells.views.offset, view)
    columns = dr.gather(mi.UInt32, cells.views.width, view)
    rows = dr.gather(mi.UInt32, cells.views.height, view)
    result = dr.zeros(mi.Float, cells.count)
    for d, share in enumerate(shares):
        side = 1 << d
        # A view has no more blocks than cells: they are numbered in the cells' own range.
        block = first + (row >> d) * ((columns + side - 1) >> d) + (column >> d)
        total = dr.zeros(mi.Float, cells.count)
        dr.scatter_add(total, weights, block)
        width = dr.minimum(columns - (column >> d << d), side)
        height = dr.minimum(rows - (row >> d << d), side)
        mean = dr.gather(mi.Float, total, block) / mi.Float(width * height)
        result += mean * (share / sum(shares))
    return result
