"""The pmf of most progress of an Adam run per unit of time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi

from ..runtime.errors import InputError
from ..unknowns.parameters import flat, unflat
from .allocation import tangents
from .sampler import Looking, OnImages, Sampler, Stage1Settings
from .stage1.path_cost import PathCost
from .uniform import Uniform

# Paths of one pass over the cells, about: in batches, and at most.
_BATCHES, _LANES = 8, 1 << 18
# A key of at most so many entries has few.
_FEW = 8
# Number of the survey's streams, far from those of any iteration's look.
_SURVEY = (1 << 27) - (1 << 16)


class Masses(Looking):
    """``Progress`` at work."""

    settings: Progress

    def __init__(self, settings, problem, loss, batch, freeze=True, blurred=None):
        super().__init__(settings, problem, loss, batch, freeze, blurred)
        self._cost = PathCost(problem, self.cells, settings.stage1.spp, freeze)
        self._surveys: dict = {}  # by base seed and the unknowns' shapes
        rates = {u.key: u.lr for u in problem.unknowns}
        # Some without their own have the optimiser's, which is not known here.
        self._rates = rates if all(rates.values()) else None

    def usual_resolution(self, batch: int) -> int:
        # Fine cells: coarse ones cost more than noisy ones.
        return self._resolution_for(min(_LANES, _BATCHES * batch))

    def look(self, values, seed, iteration, moments=None, spent=0.0) -> mi.Float:
        # Anew at the first look of a run and of a level, which has no moments yet, and is billed
        # there. A continued run has none and finds the same numbers again.
        shapes = {k: tuple(value.shape) for k, value in values.items()}
        key = seed, *shapes.items()
        if moments is None or key not in self._surveys:
            self._surveys[key] = self._survey(seed, shapes)
        curvature, cost = self._surveys[key]
        # As many in a rehearsal, so that nothing is left to compile in a run's first look.
        passes = self.settings.passes if moments is None else 1
        first = iteration * self.settings.passes
        noise = sum(
            (self._stage1.residual(values, seed, first + i)[1] for i in range(passes)),
            mi.Color3f(0),
        )
        noise = dr.sqrt(self._denoise(noise))
        dr.eval(noise)
        weighted = noise * dr.sqrt(cost)
        dr.eval(weighted)
        sensitivity = self._stage1.sensitivity(values, passes, seed, first, weighted)
        unknowns = self.problem.unknowns
        staged = any(u.during != (0.0, 1.0) for u in unknowns)
        resting = [u.key for u in unknowns if not u.moves(spent)] if staged else None
        how = moments, self.settings.least, self._rates, resting
        along = tangents(sensitivity, curvature, *how)
        weights = mi.Float(0)
        for key, tangent in along.items():
            mean, second = self._along(values, key, tangent, passes, seed, first)
            image = dr.sum(noise * self._denoise(mean))
            if dr.width(tangent) <= _FEW:
                image = self._spread(image, second, noise, cost)
            weights += image
        weights *= dr.rsqrt(cost)
        dr.eval(weights)
        return weights

    def _spread(self, image, second, noise, cost) -> mi.Float:
        """The key's share of the weights in ``image``, spread by the root mean square of J."""
        exact = dr.sum(noise * dr.sqrt(self._denoise(second)))
        dr.eval(image, exact)
        share = [dr.sum(dr.sqrt(cost) * weights) for weights in (image, exact)]
        return exact * dr.select(share[1] > 0, share[0] / share[1], 0)

    def _survey(self, seed: int, shapes: dict) -> tuple[dict, mi.Float]:
        """h by key, flat, and c per cell, at the start values in these shapes, dark lights lit."""
        unknowns, passes = self.problem.unknowns, self.settings.passes
        starts = unknowns.starts(shapes, lit=True)
        unknowns.write(starts)
        cost = sum(self._cost(seed, i) for i in range(passes)) / passes + self.settings.overhead
        weight = self._stage1.curvature(seed, _SURVEY) * self.problem.share
        curvature = {}
        for key in unknowns.keys:
            ones = dr.opaque(mi.Float, 1, dr.width(flat(starts[key])))
            # A sum over its cells is next: noise in single ones is of no account.
            image = self._along(starts, key, ones, passes, seed, _SURVEY)[0] * weight
            dr.eval(image)
            found = self._stage1.sensitivity(starts, passes, seed, _SURVEY, image)
            curvature[key] = found[key]
        dr.eval(curvature, cost)
        return curvature, cost

    def _along(
        self, values: dict, key: str, tangent: mi.Float, passes: int, seed: int, first: int
    ) -> tuple[mi.Color3f, mi.Color3f]:
        """Means of |∂I_j/∂θ · tangent| and of its square per cell, ``(3, C)``, the tangent on one
        key."""
        tangents = {}
        for other, value in values.items():
            entries = dr.opaque(mi.Float, 0, dr.width(flat(value)))
            tangents[other] = unflat(value, tangent if other == key else entries)
        dr.eval(tangents)
        mean, second = mi.Color3f(0), mi.Color3f(0)
        for i in range(passes):
            found = self._stage1.derivative(values, tangents, seed, first + i)
            mean, second = mean + found[0] / passes, second + found[1] / passes
        dr.eval(mean, second)
        return mean, second

    def measured(self, values: dict, seed: int, iteration: int) -> list[mi.Color3f]:
        """The residual's second moment alone, which the noise of a look comes from."""
        return [self._stage1.residual(values, seed, iteration)[1]]

    def weighed(self, images: list[mi.Color3f]) -> mi.Float:
        weights = dr.sum(dr.sqrt(self._denoise(images[0])))
        dr.eval(weights)
        return weights

    @property
    def paths_per_look(self) -> int:
        derivatives = self.paths_per_derivative * (1 + len(self.problem.unknowns.keys))
        return self.paths_per_pass * (1 + derivatives)

    @property
    def paths_before(self) -> int:
        derivatives = self.paths_per_derivative * 2 * len(self.problem.unknowns.keys)
        survey, passes = self.paths_per_pass * (1 + derivatives), self.settings.passes
        return passes * survey + (passes - 1) * self.paths_per_look


@dataclass(frozen=True)
class Progress(Sampler):
    """p_j = Σ_k P_k p_j|k: every unknown has a mass P_k, spread by least variance per time.

    **What Adam leaves.** Let δ_k be the error of unknown k and h_k the loss's curvature along it:
    the mean gradient is μ_k = h_k δ_k. Its variance is s_k² = Σ_j A_jk/p_j, A_jk = r_j² J_jk²/N,
    r_j² = E[⟨∂ℒ/∂I⟩_j²], J_jk² = E[⟨∂I_j/∂θ_k⟩²]. Batches of a few per mille of the pixels have
    s ≫ μ, so Adam divides by √v̂_k ≈ s_k: at rate η a step takes η (h_k/s_k) δ_k off the error
    and adds noise of size η. They balance at E δ_k² = η s_k/(2 h_k). An unknown whose error is
    smaller than that, or which Adam cannot move that far, keeps δ_k²; with a smooth transition

        F_k = δ_k² x_k/(1 + x_k),   x_k = η s_k/(2 h_k δ_k²).

    **The best pmf** has the least Σ_k F_k in a given time. A pmf whose paths cost less, on average
    Σ_j p_j c_j, affords more of them, so what counts is s_k² Σ_j p_j c_j. For one unknown the
    least of (Σ_j A_jk/p_j)(Σ_j p_j c_j) is at p_j|k ∝ r_j J_jk/√c_j, with s_k = C_k/√P_k for

        C_k = Σ_j r_j J_jk √c_j,

    P_k the share of time that it gets. Where each unknown has pixels of its own, as the texels of
    a texture have, the choice of P_k is left (``allocation.py``):

        p_j = (r_j/√c_j) Σ_k P_k J_jk/C_k,   P_k ∝ (C_k/h_k)^⅔ (1 + x_k)^(-4/3).

    Keys of unlike units and sizes are made alike (``allocation.masses``).

    **What is in it.** One unknown: the sum has one term and p_j ∝ Σ_c r_jc J_jc/√c_j, Eq. (12) at
    equal cost but for the channels c of a path, which are summed and not squared first. A texture
    of like texels, n_k pixels to each: C_k = n_k r J, h_k ∝ n_k J², p_j ∝ 1/n_k: equal mass per
    texel, as in ``balanced``. Texels of unlike noise: mass ∝ (r/J)^⅔. An unknown that is done
    (δ → 0) or out of reach (s/h ≫ δ) has x → ∞ and gets nothing; ``floor`` keeps p > 0. Where
    unknowns share pixels this is no optimum but its mixture. J is measured as the mean of single
    paths' |∂I_j/∂θ|, smaller than the root of their mean square where paths differ: the latter
    would be exact and is so much noisier that runs on textures ended worse with it. A key of few
    entries is spread by the latter: there it is all that says where to look.

    **Estimation.** Fine cells, denoised, and means of values instead of products of single paths:
    at equal iterations coarse cells ended worse than noisy ones. Per cell:
    r as the root of p_j1 (as in ``ours``), J from a forward pass along ones, and Σ_k P_k J_jk/C_k
    from one along P_k/C_k. Per unknown, by backward passes with these images as adjoints: C_k, and
    h_k = Σ_j ℓ''_j J_j J_jk with J_j = Σ_k J_jk, the curvature along an error that all entries of a
    key share. Curvature and costs (``PathCost``; a path that meets nothing costs ``overhead``
    vertices or collisions) are taken once at each resolution of the unknowns, at the start values.
    The first look there takes everything ``passes`` times and x_k ≪ 1. It costs as much as many
    steps, and comes before them all the same: Adam's second moments remember those drawn otherwise
    for the rest of a short run. Later looks, after ``refresh``, 2 ``refresh``, 4 ``refresh`` …
    iterations as the unknowns slow down, take it once, with x_k from Adam's moments, and are
    averaged with the earlier ones. Derivatives of one sign
    are assumed within a pixel and key (reflectances, roughness, radiances have them); of others the
    absolute value of their sum is used.
    """

    refresh: int = 200
    passes: int = 1
    least: float = 0.001
    overhead: float = 0.5
    stage1: Stage1Settings = field(default_factory=lambda: Stage1Settings(average=0.75))

    uses = Sampler.uses - {"probes"}
    needs = frozenset(("forward", "backward", "moments"))
    works = Masses
    forgoes = staged = True

    def on(self, problem, loss, batch, freeze=True, blurred=None) -> OnImages:
        if problem.integrator.has_forward:
            return super().on(problem, loss, batch, freeze, blurred)
        problem.warnings.append(
            f"sampler={self.name}: the scene's integrator {problem.integrator.name} does not "
            "differentiate paths in forward mode, so pixels are drawn uniformly: sampler=gradient "
            "looks at residuals alone, sampler=uniform at nothing"
        )
        return Uniform().on(problem, loss, batch, freeze, blurred)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.passes < 1:
            raise InputError(f"sampler.passes={self.passes}: at least 1")
        for name in ("least", "overhead"):
            value = getattr(self, name)
            if not (value > 0 and math.isfinite(value)):
                raise InputError(f"sampler.{name}={value}: must be a finite number above 0")

    def due(self, iteration: int) -> bool:
        times = iteration // self.refresh if self.refresh else 0
        doubled = times * self.refresh == iteration and times & (times - 1) == 0
        return iteration == 0 or (times > 0 and doubled)
