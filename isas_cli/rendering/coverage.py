"""Which entries of the unknowns any view sees."""

from __future__ import annotations

import hashlib

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import streams
from ..runtime.cache import cached, digest
from ..runtime.errors import InputError
from ..scene.problem import Problem
from ..unknowns.parameters import flat
from . import rays

# An entry counts as seen from this share of a well seen one's sensitivity on. Texels that only
# light the seen ones by interreflection, or that a view grazes, lie far below it: no view pins
# them down, and an error there says nothing about a method. Well seen is a high quantile, not the
# median: where most texels are grazed, the median is one of those.
_THRESHOLD, _WELL_SEEN = 0.05, 0.9
_LANES = 1 << 20
_MOST = 1 << 24  # pixels visited; above this a stratified subset of them


def fill_in(problem: Problem, base: int) -> None:
    """Set ``seen`` of every unknown, from the cache where possible.

    Raises InputError for an unknown that no view sees: nothing could be learnt about it. Where
    objects move all entries count: what is hidden at the start need not stay so.
    """
    if problem.unknowns.poses:
        for unknown in problem.unknowns:
            unknown.seen = np.ones(unknown.start.shape, bool)
        return
    # What is seen depends on the start: a light that starts at zero shows nothing.
    starts = [hashlib.blake2b(u.start.tobytes()).hexdigest() for u in problem.unknowns]
    masked = "" if problem.mask is None else problem.target_hash
    what = (problem.content_hash, problem.unknowns.keys, starts, masked, base)
    key = digest("coverage", 4, *what, mi.__version__, _THRESHOLD, _WELL_SEEN)
    arrays = cached(f"coverage-{key}", lambda: _measure(problem, base))
    for index, unknown in enumerate(problem.unknowns):
        unknown.seen = arrays[f"seen{index}"].reshape(unknown.start.shape)
        if not unknown.seen.any():
            raise InputError(
                f"scene.unknowns['{unknown.key}']: no view sees it, so no image can tell its "
                "value; turn a camera towards it or take it off the list"
            )


def _measure(problem: Problem, base: int) -> dict[str, np.ndarray]:
    """Largest of |Σ_j ∂I_j/∂θ_k| and |Σ_j ±∂I_j/∂θ_k| per entry, thresholded.

    Two backward passes over all pixels: one with unit adjoint, which is strong for reflectances,
    and one with random signs, which does not vanish where derivatives of both signs meet. Taken
    at the start values: what is visible must not depend on the truth.
    """
    unknowns, integrator = problem.unknowns, problem.integrator

    def kernel(scene, sensors, views, leaves, mask, first, stride, seed, signed):
        with dr.suspend_grad():
            count = lanes
            chosen = first + mi.UInt32(mi.Float64(dr.arange(mi.UInt32, count)) * stride)
            inside = chosen < views.total  # the last pass may reach beyond
            pixel = dr.minimum(chosen, views.total - 1)
            view, column, row = views.locate(pixel)
            stream = rays.stream(seed, count)
            ray, weight = rays.spawn(sensors, views, view, column, row, stream)
            sign = dr.select(stream.next_1d() < 0.5, mi.Float(-1), 1)
            counts = dr.select(inside, mi.Float(1), 0)
            if mask is not None:
                counts *= dr.gather(mi.Float, mask, pixel)
            adjoint = mi.Color3f(dr.select(signed, sign, 1) * counts) * weight
            integrator.backward(scene, stream, ray, adjoint)

    total = problem.views.total
    visited = min(total, _MOST)
    lanes = min(visited, _LANES)
    passes = -(-visited // lanes)
    samples = 4 if visited <= _LANES else 1
    run = dr.freeze(kernel)
    largest = None
    for signed in (False, True):
        unknowns.attach(unknowns.starts())
        for i in range(passes * samples):
            chunk, stride = i % passes, total / visited
            run(
                problem.scene,
                problem.sensors,
                problem.views,
                unknowns.leaves,
                problem.mask,
                dr.opaque(mi.UInt32, int(chunk * lanes * stride)),
                dr.opaque(mi.Float64, stride),
                dr.opaque(mi.UInt32, streams.seed(base, 2 * i + signed, "coverage")),
                dr.opaque(mi.Bool, signed),
            )
            dr.sync_thread()
        found = [np.abs(np.array(flat(g))) for g in unknowns.gradients().values()]
        largest = found if largest is None else [np.fmax(a, b) for a, b in zip(largest, found)]
    unknowns.write(unknowns.starts())
    return {f"seen{i}": _threshold(c) for i, c in enumerate(largest)}


def _threshold(sensitivity: np.ndarray) -> np.ndarray:
    finite = np.where(np.isfinite(sensitivity), sensitivity, 0)
    positive = finite[finite > 0]
    if positive.size == 0:
        return np.zeros(finite.shape, bool)
    return finite > _THRESHOLD * np.quantile(positive, _WELL_SEEN)
