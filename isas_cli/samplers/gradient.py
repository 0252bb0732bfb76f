"""p ∝ |∂ℒ/∂I|, the sampler of Su & Gkioulekas (2024)."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .sampler import Sampler
from .stage1.cell_moments import Stage1
from .stage1.denoise import Denoiser


@dataclass
class Gradient(Sampler):
    """p_j ∝ Σ_c |(∂ℒ/∂I)_jc| (ISAS Eq. 5), mixed with a uniform ``floor`` so that p > 0.

    The mean over a cell of the absolute single-path derivative, denoised: noisy pixels count as
    wrong pixels, as they do in any low-sample rendering of the images.
    """

    uses = Sampler.uses - {"probes"}

    def prepare(self, problem, loss, batch: int, freeze: bool = True) -> None:
        super().prepare(problem, loss, batch, freeze)
        self._stage1 = Stage1(problem, loss, self.cells, self.stage1.spp, freeze)
        denoise = self.stage1.denoise
        self._denoise = Denoiser(self.cells, denoise) if denoise != "none" else (lambda x: x)

    def look(self, values: dict, seed: int, iteration: int, moments=None) -> mi.Float:
        return self.weighed(self.measured(values, seed, iteration))

    def measured(self, values: dict, seed: int, iteration: int) -> list[mi.Color3f]:
        return [self._stage1.residual(values, seed, iteration)[0]]

    def weighed(self, images: list[mi.Color3f]) -> mi.Float:
        weights = dr.sum(self._denoise(images[0]))
        dr.eval(weights)
        return weights

    @property
    def paths_per_look(self) -> int:
        return self.cells.count * self.stage1.spp
