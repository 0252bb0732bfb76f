"""p ∝ |∂ℒ/∂I|, the sampler of Su & Gkioulekas (2024)."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .sampler import Looking, Sampler


class Residuals(Looking):
    """``Gradient`` at work."""

    def measured(self, values: dict, seed: int, iteration: int) -> list[mi.Color3f]:
        return [self._stage1.residual(values, seed, iteration)[0]]

    def weighed(self, images: list[mi.Color3f]) -> mi.Float:
        weights = dr.sum(self._denoise(images[0]))
        dr.eval(weights)
        return weights

    @property
    def paths_per_look(self) -> int:
        return self.paths_per_pass


@dataclass(frozen=True)
class Gradient(Sampler):
    """p_j ∝ Σ_c |(∂ℒ/∂I)_jc| (ISAS Eq. 5), mixed with a uniform ``floor`` so that p > 0.

    The mean over a cell of the absolute single-path derivative, denoised: noisy pixels count as
    wrong pixels, as they do in any low-sample rendering of the images.
    """

    uses = Sampler.uses - {"probes"}
    works = Residuals
