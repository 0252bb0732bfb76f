"""The pmf of least variance of the step that Adam takes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..runtime.errors import InputError
from .ours import Ours, Product


class Weighted(Product):
    """``Preconditioned`` at work."""

    settings: Preconditioned

    def look(self, values, seed, iteration, moments=None, spent=0.0) -> mi.Float:
        own = self.settings
        scale = None if moments is None else root_weights(moments.second, own.least)
        _, first = self._stage1.residual(values, seed, iteration)
        second = self._stage1.second_moment(values, own.stage1.probes, seed, iteration, scale)
        return self.weighed([first, second])


@dataclass(frozen=True)
class Preconditioned(Ours):
    """Eq. (12) with unknowns weighted as Adam weights them: p_j2 = Σ_k w_k E[⟨∂I_j/∂θ_k⟩²].

    **Derivation.** ISAS Eq. (10) minimises Σ_k V[g_k] of the gradient estimate g. Adam divides
    each component by √v̂_k, its running mean of g_k²: a large gradient makes no larger step, and
    an unknown with small ones is as much at the mercy of its noise as any. What the run sees is
    the variance of the divided gradient, Σ_k w_k V[g_k] with

        w_k = 1 / (v̂_k + ε).

    Eq. (11) with w_k before each term k and the minimiser (8) give p_j ∝ √(p_j1 p_j2), p_j2 as
    above, summed over channels as in ``ours``. With tangent entries ±√w_k in place of ±1 the
    random-sign estimate of p_j2 becomes the weighted one, E_ε[(Σ_k ε_k √w_k ∂I_j/∂θ_k)²] =
    Σ_k w_k (∂I_j/∂θ_k)²: no further path is traced.

    **Why these weights.** With small batches v̂_k ≈ μ_k² + s_k², μ_k the mean and s_k² = V[g_k] the
    variance of the estimate, and unknown k moves by η μ_k/√(μ_k² + s_k²) per step on average.
    Progress that is to be alike for all maximises

        Σ_k log(μ_k / √(μ_k² + s_k²)) = const - ½ Σ_k log(μ_k² + s_k²),

    whose derivative by s_k² is -½ /(μ_k² + s_k²) = -½ /v_k: to first order, a pmf that lowers
    Σ_k V[g_k]/v_k raises it. As the logarithm is concave, each round of (new p, new v̂) can only
    improve it, and log Σ_j A_jk/p_j is convex in log p: the fixed point is the maximum. There,
    with A_jk = E[(∂ℒ/∂I)_j²] E[(∂I_j/∂θ_k)²], K unknowns and μ_k² ≪ s_k²,

        p_j = 1/K Σ_k  (A_jk/p_j) / Σ_i (A_ik/p_i):

    each unknown has one K-th of the mass and spreads it by what each pixel contributes to its
    variance. It does not change when ℒ or an unknown is measured in another unit. For one
    unknown it is √A_j, Eq. (12); for a texture whose texels each have pixels of their own, equal
    mass per texel, p_j ∝ 1/n_k where a texel's n_k pixels are alike.

    **Settings.** ε = ``least`` × (mean of v̂ over the key's entries that a batch has touched). No
    batch has met an entry with v̂ = 0; it has the weight of an entry with that mean: 1/ε would give
    it everything, 0 would leave it for good to the ``floor``. A key of which nothing was touched
    takes the mean of all keys. Before the first step (``moments`` None) this is Eq. (12): no
    unit is known yet that would make keys comparable.

    A round halves a texel's distance from its mass (in log p), v̂ is a mean over the past and lags,
    and the first look has no moments: so looks come early, in iterations 0, 1, 2, 4, 8 … below
    ``refresh``, then every ``refresh``. On pottery this gained more than any setting did.
    """

    needs = Ours.needs | {"moments"}
    works = Weighted

    least: float = 1e-5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.refresh < 1:
            raise InputError(
                f"sampler.refresh={self.refresh}: the first look has no moments yet; at least 1"
            )
        if not (self.least > 0 and math.isfinite(self.least)):
            raise InputError(f"sampler.least={self.least}: must be a finite number above 0")

    def due(self, iteration: int) -> bool:
        early = iteration < self.refresh and iteration & (iteration - 1) == 0
        return early or super().due(iteration)


def root_weights(second: dict, least: float) -> dict:
    """√(m w_k) by key, w_k = 1/(v̂_k + ε), m the mean of all touched v̂: of order one in float32.

    ``second``: v̂ by key, flat, 0 where untouched; ``least``: ε over the key's own mean. Where
    nothing at all has been touched every weight is one. Evaluates.
    """
    counts = {key: mi.Float(dr.count(v > 0)) for key, v in second.items()}
    sums = {key: dr.sum(v) for key, v in second.items()}
    overall = sum(sums.values()) / dr.maximum(sum(counts.values()), 1)
    roots = {}
    for key, v in second.items():
        mean = dr.select(counts[key] > 0, sums[key] / dr.maximum(counts[key], 1), overall)
        held = dr.select(v > 0, v, mean) + least * mean
        roots[key] = dr.select(overall > 0, dr.sqrt(overall / held), 1)
    dr.eval(roots)
    return roots
