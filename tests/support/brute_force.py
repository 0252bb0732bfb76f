"""What stage 1 estimates, taken path by path and one unknown at a time."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from isas_cli.rendering.kernels import recorded
from isas_cli.runtime import streams
from isas_cli.samplers.stage1.cell_moments import spawned
from isas_cli.unknowns.parameters import flat, own, unflat


class PerPath:
    """What every single path tells that stage 1 traces through ``cells``, at the start values.

    ``derivatives`` leave a tangent in the scene: write the values again when all is done.
    """

    def __init__(self, p, loss, cells, samples: int):
        self.problem, self.cells = p, cells
        integrator = p.integrator

        def derivative(scene, sensors, views, leaves, cells, seeds):
            with dr.suspend_grad():
                _, _, stream, ray, weight = spawned(sensors, views, cells, samples, seeds)
                found = integrator.forward(scene, stream, ray) * weight
                dr.eval(found)
                return found

        def residual(scene, sensors, views, leaves, cells, seeds, targets):
            with dr.suspend_grad():
                _, pixel, stream, ray, weight = spawned(sensors, views, cells, samples, seeds)
                radiance, _ = integrator.primal(scene, stream, ray)
                target = dr.gather(mi.Color3f, targets, pixel)
                found = loss.derivative(radiance * weight, target)
                dr.eval(found)
                return found

        self._derivative = recorded(derivative, p)
        self._residual = recorded(residual, p)

    def derivatives(self, base: int, iteration: int, purpose: str = "stage1_adjoint") -> np.ndarray:
        """∂I/∂θ_k by one forward pass per unknown entry with that entry's unit tangent:
        ``(m, 3, C · samples)``. ``purpose``: of the paths' stream."""
        unknowns, rows = self.problem.unknowns, []
        starts = unknowns.starts()
        widths = {key: dr.width(flat(value)) for key, value in starts.items()}
        for key, width in widths.items():
            for k in range(width):
                # No literal zeros: one recording is for all entries.
                units = {j: np.zeros(n, np.float32) for j, n in widths.items()}
                units[key][k] = 1
                tangents = {j: unflat(v, own(mi.Float, units[j])) for j, v in starts.items()}
                dr.eval(tangents)
                unknowns.push_tangent(starts, tangents)
                found = self._derivative(*self._arguments(base, iteration, purpose))
                rows.append(np.array(found, np.float64))
        return np.array(rows)

    def residuals(self, base: int, iteration: int) -> np.ndarray:
        """∂ℓ/∂I: ``(3, C · samples)``."""
        p = self.problem
        p.unknowns.write(p.unknowns.starts())
        arguments = self._arguments(base, iteration, "stage1_primal")
        return np.array(self._residual(*arguments, p.targets), np.float64)

    def _arguments(self, base: int, iteration: int, purpose: str) -> tuple:
        p = self.problem
        seeds = [
            dr.opaque(mi.UInt32, streams.seed(base, iteration, name))
            for name in ("stage1_place", purpose)
        ]
        return p.scene, p.sensors, p.views, p.unknowns.leaves, self.cells, seeds


def cell_means(values: np.ndarray, samples: int) -> np.ndarray:
    """``(…, C · samples)`` → ``(…, C)``."""
    return values.reshape(*values.shape[:-1], -1, samples).mean(axis=-1)
