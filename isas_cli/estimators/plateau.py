"""Plateau-reduced gradients from plain renderings (PRDPT Eq. 9, its Our_∂κP)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..config.schema import MOST_LANES
from ..runtime import streams
from ..runtime.errors import InputError
from ..samplers.sampler import Blurred, Sampler
from ..scene.problem import Problem
from ..unknowns import smoothing
from ..unknowns.blur import Blur
from .estimator import Comparing, Gradients, at_least_one, choice
from .mitsuba import SILHOUETTES, WholeImages
from .renderings import Renderings

SCHEMES = {"joint": smoothing.joint, "separate": smoothing.separate}


@dataclass(frozen=True)
class Settings(Comparing):
    """Plateau-reduced gradients (PRDPT): of the objective blurred over the unknowns. ``gradient``:
    kernel (∂κP, Eq. 9: ``Plateau``) or renderer (κ∂P, Eq. 8: ``mitsuba.WholeImages``)."""

    name: ClassVar[str] = "plateau"
    gives: ClassVar[frozenset[str]] = frozenset(("blur",))

    @property
    def plannable(self) -> bool:
        return self.gradient == "kernel"

    @property
    def black_box(self) -> bool:
        return self.gradient == "kernel"

    @property
    def draws(self) -> bool:
        return self.gradient == "kernel"

    @property
    def chosen(self) -> str:
        return super().chosen if self.draws else "estimator.gradient=renderer"

    gradient: str = "kernel"
    smooth: str = "image"
    scheme: str = "joint"
    pairs: int = 1
    common: bool = True
    residual: str = "pair"
    residual_spp: int | None = None
    silhouettes: str = "uniform"

    def __post_init__(self) -> None:
        super().__post_init__()
        choice("silhouettes", self.silhouettes, SILHOUETTES)
        choice("gradient", self.gradient, ("kernel", "renderer"))
        choice("smooth", self.smooth, ("image", "loss"))
        choice("scheme", self.scheme, SCHEMES)
        choice("residual", self.residual, ("pair", "one"))
        at_least_one(self, "pairs")
        self._check_residual()
        if self.gradient == "renderer":
            for name in ("scheme", "common", "spp", "freeze"):
                if getattr(self, name) != getattr(type(self), name):
                    raise InputError(
                        f"estimator.{name}={getattr(self, name)}: the renderer's derivative has no "
                        "pairs of drawn pixels, and is never frozen; leave it out (paths a pixel "
                        "follow from estimator.batch), or take estimator.gradient=kernel"
                    )
        elif self.silhouettes != "uniform":
            raise InputError(
                f"estimator.silhouettes={self.silhouettes}: only estimator.gradient=renderer "
                "differentiates silhouettes; leave it out"
            )

    def _check_residual(self) -> None:
        for name, usual in (("residual", "pair"), ("residual_spp", None)):
            given = getattr(self, name)
            if given != usual and (self.smooth == "loss" or self.gradient == "renderer"):
                raise InputError(
                    f"estimator.{name}={given}: only estimator.smooth=image with "
                    "estimator.gradient=kernel has a residual of its own; leave it out"
                )
        if self.residual_spp is not None and (self.residual_spp < 2 or self.residual_spp % 2):
            raise InputError(
                f"estimator.residual_spp={self.residual_spp}: even, at least 2: half of them go to "
                "either rendering"
            )

    def blurred_on(self, problem: Problem, sampler: Sampler) -> Blurred | None:
        if "blur" not in sampler.needs:
            return None
        return Blurred(Blur(problem, "estimator=plateau"), self.smooth)

    def paths_at_once(self, problem: Problem) -> int:
        if self.gradient == "renderer":
            return self.batch
        if self.smooth == "loss":
            return super().paths_at_once(problem)
        entries = sum(u.start.size for u in problem.unknowns) if self.scheme == "separate" else 1
        return self.batch * max(self.spp, (self.residual_spp or self.spp * entries) // 2)

    def made(self, problem: Problem, loss) -> Gradients:
        if self.gradient == "renderer":
            return WholeImages(problem, loss, self.batch, self.smooth, self.pairs, self.silhouettes)
        settings = self.smooth, self.scheme, self.pairs, self.common, self.freeze, self.spp
        return Plateau(problem, loss, self.batch, *settings, self.residual, self.residual_spp)

    def derivatives(self, problem: Problem) -> str:
        if self.gradient == "renderer":
            return "Mitsuba's, of whole images at blurred values (PRDPT Eq. 8)"
        return "none taken: plain renderings, weighted by the blur's derivative (PRDPT Eq. 9)"


class Plateau(Gradients):
    """Estimates the gradient of a smoothed objective from values of the objective alone, by the
    derivative of the smoothing kernel. No rendering is differentiated.

    P(θ): the images; κ: Gaussian of widths σ; τ: offsets (``smoothing``). One of two objectives:

    - ``smooth="image"``, the paper's: Q = κ ⋆ P, and ℒ(Q(θ)) is minimised (Eq. 6, 9),

          dℒ/dθ_k = Σ_j ∂ℒ/∂I(Q_j) ∂Q_j/∂θ_k.

      The two factors come from independent offsets and paths: Q itself from (P(θ + τ') +
      P(θ - τ')) / 2, τ' ~ κ, and ∂Q_j/∂θ_k from a pair P(θ ± τ), τ ~ |∂κ|. Unbiased for losses of
      linear derivative. (One offset for both factors would not be: its error is correlated with
      itself.) The paper has one rendering for Q. Its error is what τ' changes in the image, which
      stays where nothing is left to be found, so that a run cannot end much nearer than σ over the
      root of its last steps; what τ' changes and -τ' changes back is not in the mean of both
      (benchmarks/plateau_variance.py --of residual). At the truth Q is blurred and the target is
      not, so the minimum lies elsewhere while σ is large.
    - ``smooth="loss"``, that of the paper's public code: F = κ ⋆ (ℒ ∘ P),

          ∂F/∂θ_k = E[weight_k (ℒ(P(θ + τ)) - ℒ(P(θ - τ)))].

      Each ℒ from two independent renderings A, B as (A - T)(B - T), so that the paths' variance,
      which depends on θ too, is not descended along. Unbiased for L2 and relative L2; where a loss
      is not quadratic, of the loss of a mean of two renderings.

    ``scheme``: joint (one pair for all D entries) or separate (one for each, which share pixels and
    Q), both unbiased for the Gaussian of all entries; ``pairs`` of either per step. ``residual``:
    pair, as above, or one, the paper's, Q from P(θ + τ') twice. ``common``: both of a pair follow
    the same random numbers, so that what τ does not change cancels: less variance, the same mean.
    An unknown with a ``reach`` is estimated from the pixels near its parts (``Locality``).
    Pixels from any distribution (``Renderings``), ``batch`` for each Q, ``spp`` paths a pixel in
    each rendering of a pair, in loss space twice as many; ``residual_spp`` in both of Q's
    together, an even number. None: as many as the pairs have on one side, ``spp`` or D ``spp``,
    rounded down to even, at least 2: the paths' noise in Q meets every difference, and beside
    the truth, with narrow blurs, little else of Q is left.

    ``values``, offsets and sums are on the host, in double precision.
    """

    def __init__(
        self,
        problem: Problem,
        loss,
        batch: int,
        smooth: str = "image",
        scheme: str = "joint",
        pairs: int = 1,
        common: bool = True,
        freeze: bool = True,
        spp: int = 1,
        residual: str = "pair",
        residual_spp: int | None = None,
    ):
        self.problem, self.batch, self.smooth = problem, batch, smooth
        self.pairs, self.common = pairs, common
        self.blur, self.blurs = Blur(problem, "estimator=plateau"), True
        self._scheme, self._mirrored = SCHEMES[scheme], residual == "pair"
        if scheme == "separate":
            self.blur.check_single("estimator.scheme=separate")
        self._together = self.blur.size if scheme == "separate" else 1
        # The same in both renderings.
        half = max(1, (residual_spp or spp * self._together) // 2)
        if smooth == "image" and batch * half > MOST_LANES:
            usual = "" if residual_spp else " (as many as the pairs have on one side)"
            raise InputError(
                f"estimator.residual_spp={2 * half}{usual} times estimator.batch={batch}: at most "
                f"{2 * MOST_LANES} paths; set fewer"
            )
        self._renderings = Renderings(problem, loss, batch, self.blur, freeze, spp, half)

    @property
    def nonfinite(self) -> int:
        return self._renderings.nonfinite

    @property
    def paths_per_step(self) -> int:
        """Light paths of one estimate, the latest."""
        renderings = self._renderings
        if self.smooth == "image":
            each = 2 * renderings.half + 2 * renderings.spp * self._together
        else:
            each = 4 * renderings.spp * self._together
        return self.batch * self.pairs * each

    def estimate(self, values: dict, distribution, seed: int, iteration: int, spent: float) -> dict:
        """The gradient at ``values``, by key, in the unknowns' own shapes; the share ``spent``
        of the budget decides the widths, and what rests, whose gradient is 0. Waits."""
        θ, moving = self.blur.vector(values), self.blur.moving(spent)
        σ = self.blur.widths(θ, spent) * moving
        # One stream for the offsets and for the seeds of the step's renderings.
        rng = np.random.default_rng(streams.seed(seed, iteration, "offset"))
        total = np.zeros(θ.size)
        drawn = [pair.spread(moving) for pair in self._scheme(σ[moving], self.pairs, rng)]
        self._together = len(drawn) // self.pairs
        # One of every entry, or one of all entries.
        for number in range(self.pairs):
            pairs = drawn[number :: self.pairs]
            differences = self._differences(θ, σ, pairs, distribution, rng)
            total += sum(pair.weight * found for pair, found in zip(pairs, differences))
        return self.blur.values(total / self.pairs)

    def _differences(self, θ, σ, pairs, distribution, rng) -> list[np.ndarray]:
        seeds = rng.integers(1 << 32, size=(len(pairs), 2))
        if self.common:
            seeds[:, 1] = seeds[:, 0]
        if self.smooth == "loss":
            pixels = rng.integers(1 << 32, size=len(pairs))
            return [
                self._renderings.of_losses(θ, pair, distribution, np.append(pixel, own))
                for pair, pixel, own in zip(pairs, pixels, seeds)
            ]
        other = smoothing.blurred(σ, rng)
        others = (other, -other) if self._mirrored else (other, other)
        seeds = np.append(rng.integers(1 << 32, size=3), seeds)
        return self._renderings.of_images(θ, pairs, others, distribution, seeds)
