"""Which views see which unknowns, at a glance."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import streams
from ..scene.problem import Problem
from ..unknowns.parameters import as_numpy
from .coverage import spread

_PATHS = 1 << 12, 1 << 16  # a view, at least and at most


def of(problem: Problem) -> dict[str, list[int]]:
    """By key, the views in whose images a path has a derivative by some entry of it, at the
    scene's present values, dark lights lit. Of what path replay differentiates: nothing may move.
    Evaluates.

    A few paths a pixel at most: of a view that is left out little can be told, not nothing.
    """
    unknowns, views = problem.unknowns, problem.views
    found: dict[str, list[int]] = {key: [] for key in unknowns.keys}
    values = unknowns.values_of({u.key: u.lit for u in unknowns})
    for number, (width, height) in enumerate(views.sizes):
        unknowns.attach(values)
        lanes = int(np.clip(width * height, *_PATHS))
        first = dr.gather(mi.UInt32, views.offset, number)
        drawn = mi.UInt32(streams.seed(0, number, "coverage")), True
        add = spread(problem.integrator, lanes)
        add(*problem.traced, None, first, width * height / lanes, *drawn)
        for key, gradient in unknowns.taken().items():
            if np.any(as_numpy(gradient) != 0):
                found[key].append(number)
    unknowns.write(unknowns.loaded())
    return found
