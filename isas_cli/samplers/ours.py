"""The pmf of least gradient variance (ISAS Eq. 12): the paper's method."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .gradient import Gradient, Residuals
from .sampler import Sampler


class Product(Residuals):
    """``Ours`` at work."""

    def measured(self, values: dict, seed: int, iteration: int) -> list[mi.Color3f]:
        _, first = self._stage1.residual(values, seed, iteration)
        probes = self.settings.stage1.probes
        return [first, self._stage1.second_moment(values, probes, seed, iteration)]

    def weighed(self, images: list[mi.Color3f]) -> mi.Float:
        first, second = images
        # Denoising one evaluated image after the other: both moments are heavy-tailed on their
        # own, and their product would be more so.
        weights = dr.sqrt(dr.sum(self._denoise(first) * self._denoise(second)))
        dr.eval(weights)
        return weights

    @property
    def paths_per_look(self) -> int:
        derivatives = self.paths_per_derivative * self.settings.stage1.probes
        return self.paths_per_pass * (1 + derivatives)


@dataclass(frozen=True)
class Ours(Gradient):
    """p_j ∝ √(Σ_c p_j1c p_j2c), p_j1 = E[⟨∂ℒ/∂I⟩²], p_j2 = Σ_k E[⟨∂I/∂θ_k⟩²] (ISAS Eq. 12).

    The sum over channels c of one pixel is there because its three channels share a path (the
    paper's j runs over image components). Algorithm 1, stage 1: both moments at low resolution
    and sample count, denoised each, refreshed every ``refresh`` iterations. The square root of
    the product is taken per cell and upsampled once, instead of upsampling six channels: the two
    differ only within the width of a cell. ``floor`` bounds the weights 1/p.
    """

    uses = Sampler.uses
    needs = frozenset(("forward",))
    works = Product
