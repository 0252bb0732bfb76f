"""What a light path costs at each place of the images."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ...rendering import rays
from ...rendering.kernels import recorded
from ...scene.problem import Problem
from .cells import Cells


class PathCost:
    """Mean work of a path per cell (``Integrator.work``): at how many surface points it gathers
    light, or in a medium of how many collisions it consists. A path that leaves the scene at once
    has none. On ``spp`` paths per cell. A count, not a clock: the same on every machine and in
    every run.
    """

    def __init__(self, problem: Problem, cells: Cells, spp: int, freeze: bool = True):
        self.problem, self.cells = problem, cells
        count, integrator = cells.count * spp, problem.integrator

        def kernel(scene, sensors, views, cells, seeds):
            with dr.suspend_grad():
                view, column, row = cells.place(views, spp, seeds[0])
                stream = rays.stream(seeds[1], count)
                ray, _ = rays.spawn(sensors, views, view, column, row, stream)
                met = integrator.work(scene, stream, ray)
                dr.eval(met)
                mean = dr.block_reduce(dr.ReduceOp.Add, met, spp) * (1.0 / spp)
                dr.eval(mean)
                return mean

        self._kernel = recorded(kernel, problem, freeze)

    def __call__(self, seed: int, iteration: int) -> mi.Float:
        """Work per path of every cell, ``(C,) float32``, at the scene's present values."""
        p = self.problem
        seeds = rays.seeds(seed, iteration, "stage1_place", "cost")
        return self._kernel(p.scene, p.sensors, p.views, self.cells, seeds)
