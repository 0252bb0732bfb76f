"""Which views see which unknowns, at a glance."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import streams
from ..scene.problem import Problem
from ..unknowns.parameters import as_numpy
from . import rays

_PATHS = 1 << 12, 1 << 16  # a view, at least and at most


def of(problem: Problem) -> dict[str, list[int]]:
    """By key, the views in whose images a path has a derivative by some entry of it, at the
    scene's present values. Of what path replay differentiates: nothing may move. Evaluates.

    A few paths a pixel at most: of a view that is left out little can be told, not nothing.
    """
    unknowns, views = problem.unknowns, problem.views
    found: dict[str, list[int]] = {key: [] for key in unknowns.keys}
    values = unknowns.values_of({u.key: u.kind.present for u in unknowns})
    for number, (width, height) in enumerate(views.sizes):
        unknowns.attach(values)
        _differentiate(problem, number, int(np.clip(width * height, *_PATHS)))
        for key, gradient in unknowns.taken().items():
            if np.any(as_numpy(gradient) != 0):
                found[key].append(number)
    unknowns.write(values)
    return found


def _differentiate(problem: Problem, number: int, lanes: int) -> None:
    """Add derivatives of ``lanes`` paths, spread over one view, to the leaves' gradients, each with
    a random sign, so that no sums vanish."""
    views = problem.views
    width, height = views.sizes[number]
    with dr.suspend_grad():
        lane = mi.Float64(dr.arange(mi.UInt32, lanes))
        pixel = mi.UInt32(lane * (width * height / lanes))
        view, column, row = views.locate(pixel + dr.gather(mi.UInt32, views.offset, number))
        stream = rays.stream(mi.UInt32(streams.seed(0, number, "coverage")), lanes)
        ray, weight = rays.spawn(problem.sensors, views, view, column, row, stream)
        sign = dr.select(stream.next_1d() < 0.5, mi.Float(-1), 1)
        problem.integrator.backward(problem.scene, stream, ray, mi.Color3f(sign) * weight)
