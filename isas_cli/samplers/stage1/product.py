"""Second moments of residual times derivative, both from one cell's pixels."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ...rendering import rays
from ...rendering.kernels import recorded
from ...runtime import streams
from ...scene.problem import Problem
from .cell_moments import random_signs
from .cells import Cells


class Product:
    """Estimates A_j = E Σ_k (Σ_c ⟨∂ℒ/∂I⟩_jc ⟨∂I_jc/∂θ_k⟩)² per cell, from a few pixels of each.

    As in stage 2, two independent paths go through each of ``spp`` random pixels of a cell: the
    first gives the residual r (3 channels), the second the derivative d along a tangent ε of
    independent random signs. Then E_ε[(Σ_c r_c d_c)²] = Σ_k (Σ_c r_c ∂I_c/∂θ_k)², because
    E[ε_k ε_l] = 0 for k ≠ l: one pass, no product over channels, no unknown by itself. With
    entries ±√w_k in place of ±1, k counts w_k times.

    The result is ``(C,) float32``, the mean over a cell of what single draws of stage 2 will
    contribute there, up to one common factor.
    """

    def __init__(self, problem: Problem, loss, cells: Cells, spp: int, freeze: bool = True):
        self.problem, self.cells, self.spp = problem, cells, spp
        integrator = problem.integrator
        count = cells.count * spp

        def kernel(scene, sensors, views, leaves, cells, targets, mask, seeds):
            with dr.suspend_grad():
                view, column, row = place = cells.place(views, spp, seeds[0])
                pixel = views.index(view, column, row)

                first = rays.stream(seeds[1], count)
                radiance = rays.radiance(integrator, scene, sensors, views, place, first)
                target = dr.gather(mi.Color3f, targets, pixel)
                residual = rays.masked(loss.derivative(radiance, target), mask, pixel)

                second = rays.stream(seeds[2], count)
                ray, weight = rays.spawn(sensors, views, view, column, row, second)
                derivative = integrator.forward(scene, second, ray) * weight
                square = dr.square(dr.sum(residual * derivative))
                dr.eval(square)
                mean = dr.block_reduce(dr.ReduceOp.Add, square, spp) * (1.0 / spp)
                dr.eval(mean)
                return mean

        self._kernel = recorded(kernel, problem, freeze)

    def along(self, values: dict, tangents: dict, seed: int, iteration: int) -> mi.Float:
        """Mean of (Σ_c ⟨∂ℒ/∂I⟩_c ⟨dI_c/dθ⟩·tangent)² per cell at ``values``."""
        p = self.problem
        p.unknowns.push_tangent(values, tangents)
        purposes = "stage1_place", "stage1_primal", "product_adjoint"
        seeds = rays.seeds(seed, iteration, *purposes)
        return self._kernel(*p.traced, self.cells, p.targets, p.mask, seeds)

    def second_moment(
        self, values: dict, probes: int, seed: int, iteration: int, scale: dict | None = None
    ) -> mi.Float:
        """A_j per cell, the mean over ``probes`` random-sign tangents, new paths for each.

        ``scale``: √w_k by key, flat, which makes it Σ_k w_k E(Σ_c …)².
        """
        total = dr.zeros(mi.Float, self.cells.count)
        for number in range(iteration * probes, (iteration + 1) * probes):
            tangents = random_signs(values, streams.seed(seed, number, "stage1_sign"), scale)
            total += self.along(values, tangents, seed, number)
        return total / probes
