"""Stage 1 of ISAS Algorithm 1: second moments per cell, from a few paths."""

from __future__ import annotations

from functools import partial

import drjit as dr
import mitsuba as mi

from ...rendering import rays
from ...rendering.kernels import recorded
from ...runtime import streams
from ...scene.problem import Problem
from ...unknowns.parameters import flat, unflat
from .cells import Cells


class Stage1:
    """Estimates p_j1 = E[⟨∂ℒ/∂I⟩²] and p_j2 = Σ_k E[⟨∂I/∂θ_k⟩²] per cell (ISAS Eq. 12, 16).

    Each cell traces paths through ``samples`` random full-resolution pixels, compares them with
    those pixels' own targets, and averages: the mean over a cell of the single-path second
    moments that stage 2 will meet there, noise of the paths included.

    p_j2 comes from forward differentiation along a tangent ε of independent random signs:
    E_ε[(Σ_k ε_k ∂I_j/∂θ_k)²] = Σ_k (∂I_j/∂θ_k)², so one pass estimates Eq. (20) without bias and
    without touching the AD system; a parameter that a path meets twice is summed before it is
    squared, as it should be.

    Results are per colour channel, ``(3, C)``; both are up to one common factor.
    """

    def __init__(self, problem: Problem, loss, cells: Cells, samples: int, freeze: bool = True):
        self.problem, self.cells, self.samples = problem, cells, samples
        wrap = partial(recorded, problem=problem, freeze=freeze)
        self._residual = wrap(_residual_kernel(problem.integrator, loss, samples))
        self._derivative = wrap(_derivative_kernel(problem.integrator, samples))
        self._sensitivity = wrap(_sensitivity_kernel(problem.integrator, samples))
        self._curvature = wrap(_pixels_kernel(loss.curvature, samples))
        self._counting = wrap(_pixels_kernel(lambda target: mi.Color3f(1), samples))

    def _arguments(self):
        return *self.problem.traced, self.cells

    def residual(self, values: dict, seed: int, iteration: int) -> tuple[mi.Color3f, mi.Color3f]:
        """Mean of |⟨∂ℒ/∂I⟩| and of its square (p_j1) per cell at ``values``."""
        p = self.problem
        p.unknowns.write(values)
        seeds = rays.seeds(seed, iteration, "stage1_place", "stage1_primal")
        return self._residual(*self._arguments(), p.targets, p.mask, seeds)

    def derivative(
        self, values: dict, tangents: dict, seed: int, iteration: int
    ) -> tuple[mi.Color3f, mi.Color3f]:
        """Mean of |⟨dI/dθ⟩·tangent| and of its square per cell at ``values``."""
        self.problem.unknowns.push_tangent(values, tangents)
        seeds = rays.seeds(seed, iteration, "stage1_place", "stage1_adjoint")
        return self._derivative(*self._arguments(), seeds)

    def second_moment(
        self, values: dict, probes: int, seed: int, iteration: int, scale: dict | None = None
    ) -> mi.Color3f:
        """p_j2 per cell: the mean over ``probes`` random-sign tangents (Eq. 15, 16).

        ``scale``: √w_k by key, flat, which makes it Σ_k w_k E[⟨∂I/∂θ_k⟩²].
        """
        total = dr.zeros(mi.Color3f, self.cells.count)
        for probe in range(probes):
            drawn = streams.seed(seed, iteration * probes + probe, "stage1_sign")
            tangents = random_signs(values, drawn, scale)
            _, second = self.derivative(values, tangents, seed, iteration * probes + probe)
            total += second
        return total / probes

    def curvature(self, seed: int, iteration: int) -> mi.Color3f:
        """Mean ∂²ℓ/∂I² of a cell's pixels, times their mask."""
        p = self.problem
        seeds = rays.seeds(seed, iteration, "stage1_place")
        return self._curvature(p.views, self.cells, p.targets, p.mask, seeds)

    def counting(self, seed: int, iteration: int) -> mi.Color3f | None:
        """How much a cell's pixels count, in the mean; None where all count."""
        p = self.problem
        if p.mask is None:
            return None
        seeds = rays.seeds(seed, iteration, "stage1_place")
        return self._counting(p.views, self.cells, p.targets, p.mask, seeds)

    def sensitivity(
        self, values: dict, passes: int, seed: int, iteration: int, image: mi.Color3f | None = None
    ) -> dict:
        """|Σ_j a_j ⟨∂I_j/∂θ_k⟩| over all pixels, by key, flat: ``passes`` backward passes.

        ``image``: a per cell and channel, ``(3, C)``; None for 1.
        """
        unknowns = self.problem.unknowns
        unknowns.attach(values)
        total: dict = {}
        for i in range(passes):
            # Streams of their own: a derivative must not be divided by a sum of itself.
            seeds = rays.seeds(seed, iteration + i, "balance_place", "balance_adjoint")
            self._sensitivity(*self._arguments(), image, seeds)
            for key, gradient in unknowns.taken().items():
                total[key] = total.get(key, 0) + flat(gradient)
        return {key: dr.abs(sums) / passes for key, sums in total.items()}


def random_signs(values: dict, seed: int, scale: dict | None = None) -> dict:
    """Tangents of independent ±1 entries, one per entry of every value, times ``scale`` (by key,
    flat) where it is given. Traced."""
    tangents = {}
    for key, value in values.items():
        count = dr.width(flat(value))
        state = dr.opaque(mi.UInt64, seed)
        rng = mi.PCG32(size=count, initstate=state)
        seed = (seed * 0x9E3779B1 + 1) & 0xFFFFFFFF  # another stream for the next unknown
        signs = dr.select(rng.next_float32() < 0.5, mi.Float(-1), 1)
        tangents[key] = unflat(value, signs if scale is None else signs * scale[key])
    return tangents


def _residual_kernel(integrator, loss, samples: int):
    def kernel(scene, sensors, views, leaves, cells, targets, mask, seeds):
        with dr.suspend_grad():
            _, pixel, stream, ray, weight = spawned(sensors, views, cells, samples, seeds)
            radiance, _ = integrator.primal(scene, stream, ray)
            target = dr.gather(mi.Color3f, targets, pixel)
            derivative = rays.masked(loss.derivative(radiance * weight, target), mask, pixel)
            return cell_moments(derivative, samples)

    return kernel


def _derivative_kernel(integrator, samples: int):
    def kernel(scene, sensors, views, leaves, cells, seeds):
        with dr.suspend_grad():
            _, _, stream, ray, weight = spawned(sensors, views, cells, samples, seeds)
            return cell_moments(integrator.forward(scene, stream, ray) * weight, samples)

    return kernel


def _sensitivity_kernel(integrator, samples: int):
    def kernel(scene, sensors, views, leaves, cells, image, seeds):
        with dr.suspend_grad():
            view, _, stream, ray, weight = spawned(sensors, views, cells, samples, seeds)
            # A sample stands for all pixels of its cell, of which large films have more.
            pixels = dr.gather(mi.Float, cells.scale_x, view)
            pixels *= dr.gather(mi.Float, cells.scale_y, view) * (1.0 / samples)
            adjoint = mi.Color3f(pixels)
            if image is not None:
                cell = dr.arange(mi.UInt32, cells.count * samples) // samples
                adjoint *= dr.gather(mi.Color3f, image, cell)
            integrator.backward(scene, stream, ray, adjoint * weight)

    return kernel


def _pixels_kernel(of, samples: int):
    """The mean over each cell of ``of`` what its pixels' targets are, times their mask."""

    def kernel(views, cells, targets, mask, seeds):
        view, column, row = cells.place(views, samples, seeds[0])
        pixel = views.index(view, column, row)
        weight = rays.masked(of(dr.gather(mi.Color3f, targets, pixel)), mask, pixel)
        zero = dr.zeros(mi.Float, cells.count * samples)
        weight = mi.Color3f(*[cell_mean(weight[c] + zero, samples) for c in range(3)])
        dr.eval(weight)
        return weight

    return kernel


def spawned(sensors, views, cells: Cells, samples: int, seeds: list) -> tuple:
    """A path for each sample of each cell: view, pixel, stream, ray, ray weight. Traced."""
    view, column, row = cells.place(views, samples, seeds[0])
    stream = rays.stream(seeds[1], cells.count * samples)
    ray, weight = rays.spawn(sensors, views, view, column, row, stream)
    return view, views.index(view, column, row), stream, ray, weight


def cell_mean(values: mi.Float, samples: int) -> mi.Float:
    return dr.block_reduce(dr.ReduceOp.Add, values, samples) * (1.0 / samples)


def cell_moments(derivative: mi.Color3f, samples: int) -> tuple[mi.Color3f, mi.Color3f]:
    """Mean over each cell of |derivative| and of its square. Evaluates."""
    dr.eval(derivative)
    size = dr.abs(derivative)
    first = mi.Color3f(*[cell_mean(size[c], samples) for c in range(3)])
    second = mi.Color3f(*[cell_mean(dr.square(size[c]), samples) for c in range(3)])
    dr.eval(first, second)
    return first, second
