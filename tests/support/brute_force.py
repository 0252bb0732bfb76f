"""What stage 1 estimates, taken path by path and one unknown at a time."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from isas_cli.rendering import rays
from isas_cli.runtime import streams
from isas_cli.unknowns.parameters import flat, unflat


def _paths(p, cells, samples: int, base: int, iteration: int, purpose: str) -> tuple:
    """The pixels of stage 1's paths, their rays with weights, and the stream that goes on."""
    place, path = (
        dr.opaque(mi.UInt32, streams.seed(base, iteration, name))
        for name in ("stage1_place", purpose)
    )
    view, column, row = cells.place(p.views, samples, place)
    stream = rays.stream(path, cells.count * samples)
    ray, weight = rays.spawn(p.sensors, p.views, view, column, row, stream)
    return p.views.index(view, column, row), stream, ray, weight


def per_path_derivatives(
    p, cells, samples: int, base: int, iteration: int, purpose: str = "stage1_adjoint"
) -> np.ndarray:
    """∂I/∂θ_k of every path that stage 1 traces, by one forward pass per unknown entry with that
    entry's unit tangent: ``(m, 3, C · samples)``. ``purpose``: of the paths' stream."""
    starts = p.unknowns.starts()
    rows = []
    for key in p.unknowns.keys:
        for k in range(dr.width(flat(starts[key]))):
            tangents = {
                j: unflat(v, dr.zeros(mi.Float, dr.width(flat(v)))) for j, v in starts.items()
            }
            unit = np.zeros(dr.width(flat(starts[key])), np.float32)
            unit[k] = 1
            tangents[key] = unflat(starts[key], mi.Float(unit))
            p.unknowns.push_tangent(starts, tangents)
            with dr.suspend_grad():
                _, stream, ray, weight = _paths(p, cells, samples, base, iteration, purpose)
                derivative = p.integrator.forward(p.scene, stream, ray) * weight
            rows.append(np.array(derivative, np.float64))
    return np.array(rows)


def per_path_residuals(p, loss, cells, samples: int, base: int, iteration: int) -> np.ndarray:
    """∂ℓ/∂I of every path that stage 1 traces: ``(3, C · samples)``."""
    p.unknowns.write(p.unknowns.starts())
    pixel, stream, ray, weight = _paths(p, cells, samples, base, iteration, "stage1_primal")
    radiance, _ = p.integrator.primal(p.scene, stream, ray)
    derivative = loss.derivative(radiance * weight, dr.gather(mi.Color3f, p.targets, pixel))
    return np.array(derivative, np.float64)


def cell_means(values: np.ndarray, samples: int) -> np.ndarray:
    """``(…, C · samples)`` → ``(…, C)``."""
    return values.reshape(*values.shape[:-1], -1, samples).mean(axis=-1)
