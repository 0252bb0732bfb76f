"""Plateau-reduced gradients from plain renderings (PRDPT Eq. 9, its Our_∂κP)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import streams
from ..pixels import PixelDistribution
from . import smoothing
from .blur import Blur
from .renderings import Renderings

if TYPE_CHECKING:
    from ..problem import Problem

SCHEMES = {"joint": smoothing.joint, "separate": smoothing.separate}


class Plateau:
    """Estimates the gradient of a smoothed objective from values of the objective alone, by the
    derivative of the smoothing kernel. No rendering is differentiated.

    P(θ): the images; κ: Gaussian of widths σ; τ: offsets (``smoothing``). One of two objectives:

    - ``smooth="image"``, the paper's: Q = κ ⋆ P, and ℒ(Q(θ)) is minimised (Eq. 6, 9),

          dℒ/dθ_k = Σ_j ∂ℒ/∂I(Q_j) ∂Q_j/∂θ_k.

      The two factors come from independent offsets and paths: one rendering P(θ + τ'), τ' ~ κ, for
      ∂ℒ/∂I, a pair P(θ ± τ), τ ~ |∂κ|, for ∂Q_j/∂θ_k. Unbiased for losses of linear derivative.
      (One offset for both would not be: its error is correlated with itself.) At the truth Q is
      blurred and the target is not, so the minimum lies elsewhere while σ is large.
    - ``smooth="loss"``, that of the paper's public code: F = κ ⋆ (ℒ ∘ P),

          ∂F/∂θ_k = E[weight_k (ℒ(P(θ + τ)) - ℒ(P(θ - τ)))].

      Each ℒ from two independent renderings A, B as (A - T)(B - T), so that the paths' variance,
      which depends on θ too, is not descended along. Unbiased for L2 and relative L2; where a loss
      is not quadratic, of the loss of a mean of two renderings.

    ``scheme``: joint (one pair for all D entries) or separate (one for each), both unbiased for
    the Gaussian of all entries; ``pairs`` of either per step. ``common``: both of a pair follow
    the same random numbers, so that what τ does not change cancels: less variance, the same mean.
    An unknown with a ``reach`` is estimated from the pixels near its parts (``Locality``).
    Pixels from any distribution (``Renderings``), ``batch`` for each pair, ``spp`` paths a pixel
    and rendering; three renderings a pair in image space, four in loss space.

    ``values``, offsets and sums are on the host, in double precision.
    """

    def __init__(
        self,
        problem: "Problem",
        loss,
        batch: int,
        smooth: str = "image",
        scheme: str = "joint",
        pairs: int = 1,
        common: bool = True,
        freeze: bool = True,
        spp: int = 1,
    ):
        self.batch, self.smooth, self.pairs, self.common = batch, smooth, pairs, common
        self.blur = Blur(problem, "sampler=plateau")
        self._scheme = SCHEMES[scheme]
        self._renderings = Renderings(problem, loss, batch, self.blur, freeze, spp)
        differences = pairs * (self.blur.size if scheme == "separate" else 1)
        self._paths = batch * spp * differences

    @property
    def paths_per_step(self) -> int:
        """Light paths of one estimate."""
        return (3 if self.smooth == "image" else 4) * self._paths

    def estimate(
        self,
        values: dict,
        distribution: PixelDistribution,
        base: int,
        iteration: int,
        progress: float,
    ) -> dict:
        """The gradient at ``values``, by key, in the unknowns' own shapes; ``progress`` of the
        budget decides the widths. Waits."""
        θ = self.blur.vector(values)
        σ = self.blur.widths(θ, progress)
        # One stream for the offsets and for the seeds of the step's renderings.
        rng = np.random.default_rng(streams.seed(base, iteration, "offset"))
        total = np.zeros(θ.size)
        for pair in self._scheme(σ, self.pairs, rng):
            total += pair.weight * self._difference(θ, σ, pair, distribution, rng)
        return self.blur.values(total / self.pairs)

    def _difference(self, θ, σ, pair, distribution, rng) -> np.ndarray:
        seeds = rng.integers(1 << 32, size=4)
        if self.common:
            seeds[-1] = seeds[-2]
        if self.smooth == "loss":
            return self._renderings.of_losses(θ, pair, distribution, seeds[1:])
        other = smoothing.blurred(σ, rng)
        return self._renderings.of_images(θ, pair, other, distribution, seeds)
