"""Where a pair of blurred renderings differs and is wrong: pixels for plateau-reduced gradients."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np

from ..rendering import rays
from ..rendering.kernels import recorded
from ..runtime import streams
from ..unknowns import smoothing
from .gradient import Gradient, Residuals
from .sampler import Sampler, Stage1Settings
from .stage1.cell_moments import cell_mean, cell_moments, spawned


class Pairs(Residuals):
    """``Differences`` at work."""

    def __init__(self, settings, problem, loss, batch, freeze=True, blurred=None):
        super().__init__(settings, problem, loss, batch, freeze, blurred)
        self.blur, self.smooth = blurred
        wrap = partial(recorded, problem=problem, freeze=freeze)
        samples = settings.stage1.spp
        paths = 1 if self.smooth == "image" else 2
        self._trace = wrap(_trace_kernel(problem.integrator, samples, paths))
        self._moments = wrap(_difference_kernel(samples))
        self._losses = wrap(_loss_kernel(loss, samples))

    def look(self, values, seed, iteration, moments=None, spent=0.0) -> mi.Float:
        θ, moving = self.blur.vector(values), self.blur.moving(spent)
        σ = self.blur.widths(θ, spent) * moving
        rng = np.random.default_rng(streams.seed(seed, iteration, "offset_look"))
        probes = self.settings.stage1.probes
        found = [
            self._pair(θ, σ, pair.spread(moving), seed, iteration * probes + probe, rng)
            for probe, pair in enumerate(smoothing.joint(σ[moving], probes, rng))
        ]
        images = [sum(kind) / len(found) for kind in zip(*found)]
        weights = dr.sqrt(dr.sum(_product([self._denoise(image) for image in images])))
        dr.eval(weights)
        return weights

    def measured(self, values, seed, iteration):
        """None: looks differ by their offsets, whatever their paths are."""

    def _pair(self, θ, σ, pair: smoothing.Pair, seed: int, number: int, rng) -> list[mi.Color3f]:
        """Second moments per cell: of r and of D, or of Δℓ."""
        p = self.problem
        place, path = rays.seeds(seed, number, "stage1_place", "stage1_adjoint")
        sides = []
        for offset in (pair.plus, pair.minus):
            self.blur.write(θ + offset)
            sides.append(self._trace(*p.traced, self.cells, (place, path)))
        if self.smooth == "loss":
            targets = p.views, self.cells, p.targets, p.mask
            return [self._losses(*targets, sides, (place, path))]
        at = self.blur.clamped(θ + smoothing.blurred(σ, rng))
        return [self._stage1.residual(at, seed, number)[1], self._moments(sides)]

    @property
    def paths_per_look(self) -> int:
        paths = 3 if self.smooth == "image" else 4
        return self.paths_per_pass * self.settings.stage1.probes * paths


@dataclass(frozen=True)
class Differences(Gradient):
    """p_j of least variance for the differences that ``estimators.plateau`` sums over pixels, with
    pairs of its scheme joint, one path a pixel, common random numbers, a residual from one
    rendering and no ``reach`` (else an approximation).

    In image space a drawn pixel j gives Σ_c r_jc D_jc / p_j, r = ∂ℒ/∂I at P(θ + τ') and
    D = P(θ + τ) - P(θ - τ), τ' and τ independent, hence

        p_j ∝ √(Σ_c E[r_jc²] E[D_jc²])

    (with Σ_c as in ``Ours``); in loss space Δℓ_j / p_j, hence p_j ∝ √E[(Σ_c Δℓ_jc)²]. Moments over
    paths and offsets at present, per cell as in stage 1 of ISAS Algorithm 1: ``stage1.probes``
    offsets a look, both of a pair with the same random numbers, denoised, refreshed every
    ``refresh`` iterations. Only for ``estimator=plateau``.
    """

    uses = Sampler.uses
    needs = frozenset(("blur",))
    works = Pairs
    staged = True

    # One offset shows where that one's pair differs; averages over many, where pairs do.
    stage1: Stage1Settings = field(default_factory=lambda: Stage1Settings(probes=8, average=0.7))


def _product(images: list[mi.Color3f]) -> mi.Color3f:
    return images[0] if len(images) == 1 else images[0] * images[1]


def _trace_kernel(integrator, samples: int, paths: int):
    """Radiance of every cell's samples, ``paths`` times independently, one after the other."""

    def kernel(scene, sensors, views, leaves, cells, seeds):
        with dr.suspend_grad():
            found = []
            for path in range(paths):
                own = seeds[0], seeds[1] + path * 0x9E3779B9
                _, _, stream, ray, weight = spawned(sensors, views, cells, samples, [*own])
                radiance, _ = integrator.primal(scene, stream, ray)
                found.append(radiance * weight)
            dr.eval(found)
            return found

    return kernel


def _difference_kernel(samples: int):
    def kernel(sides):
        (plus,), (minus,) = sides
        return cell_moments(plus - minus, samples)[1]

    return kernel


def _loss_kernel(loss, samples: int):
    """E[(Δℓ)²] per cell, as a colour whose sum over channels it is."""

    def kernel(views, cells, targets, mask, sides, seeds):
        view, column, row = cells.place(views, samples, seeds[0])
        pixel = views.index(view, column, row)
        target = dr.gather(mi.Color3f, targets, pixel)
        plus, minus = (loss.measured(*halves, target) for halves in sides)
        difference = rays.masked(dr.sum(plus - minus), mask, pixel)
        second = cell_mean(dr.square(difference), samples)
        dr.eval(second)
        return mi.Color3f(second / 3)

    return kernel
