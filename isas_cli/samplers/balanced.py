"""Equal expected information per unknown."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi

from ..runtime.errors import InputError
from ..unknowns.parameters import flat, unflat
from .sampler import Looking, Sampler, Stage1Settings


class Shares(Looking):
    """``Balanced`` at work."""

    settings: Balanced
    lasting = True

    def look(self, values, seed, iteration, moments=None, spent=0.0) -> mi.Float:
        own = self.settings
        for u in self.problem.unknowns:
            # Mostly the only look, and a light that is dark as yet shows nothing of what it lights.
            if u.lit is not u.start and not dr.any(flat(values[u.key]) != 0):
                shape = tuple(values[u.key].shape)
                values = values | {u.key: u.kind.value(u.kind.coarse(u.lit, shape))}
        counting = self._stage1.counting(seed, iteration)
        sensitivity = self._stage1.sensitivity(values, own.passes, seed, iteration, counting)
        tangents = {}
        for key, c in sensitivity.items():
            seen = (c > 0) & dr.isfinite(c)  # one entry that is not must not spoil the mean
            c = dr.select(seen, c, 0)
            mean = dr.sum(c) / dr.maximum(dr.sum(dr.select(seen, mi.Float(1), 0)), 1)
            inverse = dr.select(seen, dr.rcp(dr.maximum(c, own.least * mean)), 0)
            tangents[key] = unflat(values[key], inverse)
            dr.eval(tangents[key])
        first = dr.zeros(mi.Color3f, self.cells.count)
        for probe in range(own.stage1.probes):
            number = iteration * own.stage1.probes + probe
            first += self._stage1.derivative(values, tangents, seed, number)[0]
        if counting is not None:
            first *= counting
        weights = dr.power(dr.sum(self._denoise(first)), own.power)
        dr.eval(weights)
        return weights

    @property
    def paths_per_look(self) -> int:
        passes = self.settings.passes + self.settings.stage1.probes
        return self.paths_per_pass * self.paths_per_derivative * passes


@dataclass(frozen=True)
class Balanced(Sampler):
    """p_j ∝ (Σ_k J_jk / c_k)^power, J_jk = |∂I_j/∂θ_k|, c_k = Σ_j J_jk.

    Why. With batches of a few per mille of the pixels Adam's step is dominated by noise: it
    divides each component by √v̂_k ≈ s_k, s_k² = Σ_j A_jk / p_j the variance of the gradient,
    A_jk = E[(∂ℒ/∂I)_j²] E[(∂I_j/∂θ_k)²] / N. Unknown k then moves μ_k/s_k per step. What p can
    do is to even out how much each unknown learns; for a texture that many pixels see, the fixed
    point is p_j ∝ 1/n_k(j), n_k the number of pixels that see texel k: equal probability mass per
    unknown, whatever the residual and the brightness, which Adam has divided out already. The
    expression above is that, with soft membership J.

    c_k comes from backward passes with unit adjoint (``passes`` of them), Σ_k J_jk/c_k from
    forward passes (``stage1.probes`` of them) along the tangent 1/c_k. Both depend little on θ, so
    they are taken once. c_k is held above ``least`` times its mean over the unknowns that are
    seen: an unknown that one grazing path meets must not draw all samples. Derivatives of one sign
    are assumed within a pixel (true for reflectances); with others the absolute value of their sum
    is used.
    """

    needs = frozenset(("forward", "backward"))
    works = Shares

    refresh: int = 0
    power: float = 0.5
    passes: int = 4
    least: float = 0.1
    stage1: Stage1Settings = field(default_factory=lambda: Stage1Settings(spp=2))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.power < math.inf:
            raise InputError(f"sampler.power={self.power}: must be above 0")
        if self.passes < 1:
            raise InputError(f"sampler.passes={self.passes}: at least 1")
        if not 0 < self.least < math.inf:
            raise InputError(f"sampler.least={self.least}: must be above 0")
