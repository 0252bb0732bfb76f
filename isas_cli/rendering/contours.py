"""The contours of moving meshes against alpha or masks: what these say of shapes and poses."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene.problem import Problem
from ..scene.topology import Topology
from ..scene.views import Views
from ..unknowns.parameters import own
from . import rays
from .border import Border
from .outline import crossed, draw, pull
from .silhouettes import lengths, meet, met_by

# How far beside an edge its other side is looked at, in pixels: far above rounding, far below what
# a mask can show.
_BESIDE = 0.01
# Pixels that ``apart`` looks at, at most, and how near to 0 or 1 those are that it asks.
_MOST, _SURE = 1 << 18, 0.02


class Contours(Border):
    """Adds to the gradient of one mesh's vertices, and of unknown cameras and lenses, that of
    ``weight`` times the coverage term

        C = 1/N Σ_j (c_j - m_j)² ,

    c_j the share of pixel j that surfaces fill, m_j the share that the object fills by alpha or
    masks (``Problem.part``), N the number of pixels of which that is known; where views have
    weights, pixels have that of their view. It asks for no light and no material. c steps from 1 to
    0 at the contours alone, so, as for ``Silhouettes``, whose terms these are,

        ∂C/∂θ ≈ 1/M Σ_i 2/N ⟨c - m⟩_{j(q_i)} s(q_i) |dq/dt| n·∂q_i/∂θ / P_i ,

    s(q) = 1 where a ray just outside the edge meets nothing, else 0: edges before the object itself
    or behind something else change no coverage. ⟨c⟩ from ``paths`` rays through the pixel.

    Bias: none for closed meshes, but for what is nearer to an edge than ``_BESIDE`` pixels; edges
    that reach behind a camera are left out.
    """

    tells_cameras = True

    def __init__(
        self, problem: Problem, topologies: dict[int, Topology], weight: float, samples: int,
        paths: int, adaptive: bool = True, freeze: bool = True,
    ):  # fmt: skip
        super().__init__(problem, topologies, samples, paths + 1)
        views = len(problem.film_sizes)
        self.met = met_by(views)
        ends = np.cumsum([width * height for width, height in problem.film_sizes])[:-1]
        parts = np.split(np.array(problem.part), ends)
        known = float(np.dot([np.count_nonzero(each >= 0) for each in parts], self.factors))
        share = own(mi.Float, np.float32(2 * weight * self.factors / (known or 1.0)))

        def kernel(
            scene, sensors, films, positions, outline, cameras, targets, mask, seeds, _, met, part,
            share,
        ):  # fmt: skip
            with dr.suspend_grad():
                now = dr.detach(positions)
                weights = lengths(now, outline, cameras, films, views, met if adaptive else None)
                drawn = draw(weights, outline, samples, seeds[0])
                point, _, _, crossing = crossed(now, outline, cameras, films, drawn)
                stream = rays.stream(seeds[1], samples)
                filled = dr.gather(mi.Float, part, crossing.pixel, crossing.valid)
                valid = crossing.valid & (filled >= 0)
                covered = mi.Float(0)
                for _ in range(paths):
                    place = crossing.view, crossing.column, crossing.row
                    ray, _weight = rays.spawn(sensors, films, *place, stream)
                    covered += dr.select(scene.ray_test(ray, valid), 1.0 / paths, 0)
                own_share = dr.gather(mi.Float, share, crossing.view, valid)
                adjoint = dr.select(valid, (covered - filled) * own_share, 0)
                beside = cameras.project(drawn.eye, point) + crossing.away * _BESIDE
                steps = ~scene.ray_test(_through(sensors, films, crossing.view, beside), valid)
                weight = adjoint * crossing.speed / (drawn.probability * samples)
                weight = dr.select(valid & steps, weight, 0)
                dr.eval(weight, adjoint)
                if adaptive:
                    meet(met, crossing, films, mi.Color3f(dr.select(steps, adjoint, 0)))
                pull(positions, cameras, drawn, crossing.away, weight)

        self._made(kernel, freeze, self.met, problem.part, share)


def _through(sensors, films: Views, view: mi.UInt32, place: mi.Point2f) -> mi.Ray3f:
    """The ray through a point of the image, in pixels, which may lie beyond its border. Traced."""
    corner = mi.UInt32(dr.maximum(place.x, 0)), mi.UInt32(dr.maximum(place.y, 0))
    within = mi.Point2f(place.x - mi.Float(corner[0]), place.y - mi.Float(corner[1]))
    return rays.through(sensors, films, view, *corner, within, mi.Point2f(0.5))[0]


def apart(problem: Problem) -> float:
    """How far the object's outline, where unknowns are now, is from alpha or masks: the area by
    which they differ, of the area of these. Of pixels that they fill in part nothing is asked.
    Waits."""
    total = problem.views.total
    count = min(total, _MOST)
    chosen = np.minimum((np.arange(count) + 0.5) * (total / count), total - 1).astype(np.uint32)
    pixel = own(mi.UInt32, chosen)
    place = problem.views.locate(pixel)
    ray, _ = rays.spawn(problem.sensors, problem.views, *place, rays.stream(mi.UInt32(0), count))
    covered = np.array(problem.scene.ray_test(ray))
    part = np.array(dr.gather(mi.Float, problem.part, pixel))
    filled, empty = part >= 1 - _SURE, (part >= 0) & (part <= _SURE)
    off = np.count_nonzero(filled & ~covered) + np.count_nonzero(empty & covered)
    return off / max(np.count_nonzero(filled), 1)
