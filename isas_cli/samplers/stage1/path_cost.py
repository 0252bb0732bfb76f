"""What a light path costs at each place of the images."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ...rendering import rays
from ...runtime import streams
from ...scene.problem import Problem
from .cells import Cells

# Vertices followed at most: beyond, the mean path of any scene has ended.
_MOST_VERTICES = 8


class PathCost:
    """Mean number of surface points per path at which light is gathered, per cell.

    At each such vertex a path samples an emitter, traces a shadow ray, evaluates the BSDF and
    samples where to go on: that work is what a path's time grows with. A path that leaves the
    scene at once has none. Counted on ``spp`` paths per cell that follow the BSDF as the
    integrator's do, without Russian roulette, up to eight vertices. A count, not a clock: the same
    on every machine and in every run.
    """

    def __init__(self, problem: Problem, cells: Cells, spp: int, freeze: bool = True):
        self.problem, self.cells = problem, cells
        count = cells.count * spp
        # The last edge of a path of greatest length only looks for emitters.
        vertices = min(problem.integrator.max_depth - 1, _MOST_VERTICES)

        def kernel(scene, sensors, views, cells, seeds):
            with dr.suspend_grad():
                view, column, row = cells.place(views, spp, seeds[0])
                stream = rays.stream(seeds[1], count)
                ray, _ = rays.spawn(sensors, views, view, column, row, stream)
                met, active = dr.zeros(mi.Float, count), mi.Bool(True)
                for _ in range(vertices):
                    si = scene.ray_intersect(ray, active)
                    active &= si.is_valid()
                    met += dr.select(active, mi.Float(1), 0)
                    sample, weight = si.bsdf(ray).sample(
                        mi.BSDFContext(), si, stream.next_1d(), stream.next_2d(), active
                    )
                    active &= dr.max(weight) > 0
                    ray = si.spawn_ray(si.to_world(sample.wo))
                dr.eval(met)
                mean = dr.block_reduce(dr.ReduceOp.Add, met, spp) * (1.0 / spp)
                dr.eval(mean)
                return mean

        self._kernel = dr.freeze(kernel) if freeze else kernel

    def __call__(self, seed: int, iteration: int) -> mi.Float:
        """Vertices per path of every cell, ``(C,) float32``, at the scene's present values."""
        p = self.problem
        seeds = [
            dr.opaque(mi.UInt32, streams.seed(seed, iteration, purpose))
            for purpose in ("stage1_place", "cost")
        ]
        return self._kernel(p.scene, p.sensors, p.views, self.cells, seeds)
