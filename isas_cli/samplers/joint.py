"""The pmf of least gradient variance when a pixel's three channels share a path."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .sampler import Looking, Sampler
from .stage1.product import Product


class PerPath(Looking):
    """``Joint`` at work."""

    def __init__(self, settings, problem, loss, batch, freeze=True, blurred=None):
        super().__init__(settings, problem, loss, batch, freeze, blurred)
        self._product = Product(problem, loss, self.cells, settings.stage1.spp, freeze)

    def measured(self, values: dict, seed: int, iteration: int) -> list[mi.Color3f]:
        # The denoiser's images have three channels.
        probes = self.settings.stage1.probes
        return [mi.Color3f(self._product.second_moment(values, probes, seed, iteration))]

    def weighed(self, images: list[mi.Color3f]) -> mi.Float:
        weights = dr.sqrt(self._denoise(images[0]).x)
        dr.eval(weights)
        return weights

    @property
    def paths_per_look(self) -> int:
        pair = 1 + self.paths_per_derivative
        return self.paths_per_pass * self.settings.stage1.probes * pair


@dataclass(frozen=True)
class Joint(Sampler):
    """p_j ∝ √A_j, A_j = E‖Σ_c ⟨∂ℒ/∂I⟩_jc ⟨dI_jc/dθ⟩‖², residual and derivative from two paths.

    Stage 2 draws pixels, not image components, and one draw of pixel j contributes
    Σ_c ⟨∂ℒ/∂I⟩_jc ⟨dI_jc/dθ⟩ / p_j to the gradient (ISAS Eq. 4, summed over the channels c of one
    path). Eq. (10), Σ_k V[⟨∂ℒ/∂θ_k⟩], is Σ_j A_j / p_j less what p cannot change, and √A_j
    minimises it as in Eq. (8). Both factors are measured at once (``Product``): the square is
    averaged over a cell, denoised, and only then the root is taken.

    **How it differs from Eq. (12)** as ``ours`` reads it, √(Σ_c p_j1c p_j2c). The paths being
    independent,

        A_j = Σ_c p_j1c p_j2c + Σ_{c≠c'} E[⟨∂ℒ/∂I⟩_c ⟨∂ℒ/∂I⟩_c'] Σ_k E[⟨∂I_c/∂θ_k⟩ ⟨∂I_c'/∂θ_k⟩].

    - Where an unknown acts on one channel only, as a texel's red does, the second sum is zero and
      both agree. Where channels share an unknown, such as a roughness, it counts: grey paths with
      grey residuals have three times Eq. (12)'s A_j (in all pixels alike, which changes no pmf),
      and pixels where the channels' contributions have unlike signs have less, down to none.
    - Within a cell, Eq. (12) as ``ours`` has it multiplies two means; here it is the mean of
      products over the cell's pixels. Where large residuals and large derivatives share pixels
      (an edge, a highlight) the product of means is too small. For a pmf that is constant in a
      cell, the root of the mean of A_j is the best there is.
    - A product of two heavy-tailed numbers has a heavier tail than each: at equal ``spp`` this
      estimate is the noisier one, and it has one path pair per tangent where ``ours`` uses its
      residual paths for all.
    """

    needs = frozenset(("forward",))
    works = PerPath
