"""Silhouettes of moving meshes in the images: what they add to the loss gradient."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..scene.problem import Problem
from ..scene.topology import Topology
from ..scene.views import Views
from . import rays
from .border import Border, hidden_by_nothing, residual
from .outline import (
    Cameras,
    Crossing,
    Outline,
    at,
    backward_ray,
    crossed,
    draw,
    every,
    pair,
    pull,
    sample,
    silhouettes,
    spans,
)
from .projective import without_film

# Cells a view, along each side, whose residuals are known apart; what a step's samples count for
# in the next one; the least that a cell counts for, of the mean.
_CELLS, _KEPT, _FLOOR = 16, 0.9, 0.1


class Silhouettes(Border):
    """Adds to the gradient of one mesh's vertices what its silhouettes in the images bring.

    The derivative of a pixel I_j, the mean of radiance L over its square, has a part on the curves
    at which L steps by ΔL = L_front - L_behind (Li et al. 2018, Eq. 7):

        ∂I_j/∂θ = … + ∫ ΔL(q) n·∂q/∂θ dl(q)    over the silhouettes within pixel j, in pixels,

    n the normal in the image away from the object. So ∂ℒ/∂θ has one integral over the silhouettes
    of all views, estimated by ``samples`` stratified points q_i: an edge of a view that separates a
    face turned to the camera from one turned away, with probability P proportional to its length
    in pixels (``adaptive``: times the root mean square of ∂ℒ/∂I that earlier steps met around
    there), and a point t on it, uniformly:

        1/M Σ_i ⟨∂ℒ/∂I⟩_{j(q_i)} ΔL(q_i) |dq/dt| n·∂q_i/∂θ / P_i .

    ΔL from two paths, one on each side and of random numbers of its own, by Mitsuba's
    ``sample_radiance_difference`` on the face that is turned to the camera; ∂ℒ/∂I from ``paths``
    others through the same pixel. Hidden edges bring nothing: a ray to the camera, or to its near
    clip plane, says so.

    Bias: none for losses of linear derivative and closed meshes of smooth normals; edges that
    reach behind a camera are left out, and so are silhouettes that mirrors and glass show, the
    lines where a mesh passes through another thing, and the rims where clip planes cut what moves;
    what lies beyond the far one counts as if it were seen behind an edge. Those that shadows show
    are ``shadows.Shadows``.
    """

    def __init__(
        self, problem: Problem, loss, id: str, topologies: dict[int, Topology], samples: int,
        paths: int, adaptive: bool = True, freeze: bool = True,
    ):  # fmt: skip
        super().__init__(problem, topologies, samples, paths + 2)
        (shape,) = [each for each in problem.scene.shapes() if each.id() == id]
        integrator, differences = problem.integrator, without_film(problem.integrator)
        views = len(problem.film_sizes)
        self.met = met_by(views)

        def kernel(
            scene, sensors, films, positions, outline, cameras, targets, mask, seeds, share, met
        ):
            with dr.suspend_grad():
                now = dr.detach(positions)
                weights = lengths(now, outline, cameras, films, views, met if adaptive else None)
                drawn = draw(weights, outline, samples, seeds[0])
                point, plane, inner, crossing = crossed(now, outline, cameras, films, drawn)
                away = cameras.eyes.away(drawn.eye, point)
                found = sample(now, outline, drawn, point, away, plane, inner, mi.ShapePtr(shape))
                back = backward_ray(found)
                begin = cameras.begin(drawn.eye, point)
                back.maxt = dr.norm(begin - back.o) * (1 - mi.math.ShadowEpsilon)
                seen = crossing.valid & hidden_by_nothing(scene, back, crossing.valid)
                step, _ = differences.sample_radiance_difference(
                    *(scene, found, mi.UInt32(0), rays.stream(seeds[1], samples)),
                    *(mi.Color0f(), seen),
                )
                adjoint = residual(
                    *(integrator, loss, scene, sensors, films, targets, mask, share, crossing),
                    *(rays.stream(seeds[2], samples), paths),
                )
                weight = dr.sum(adjoint * step) * crossing.speed / (drawn.probability * samples)
                weight = dr.select(seen & dr.isfinite(weight), weight, 0)
                dr.eval(weight, adjoint)
                if adaptive:
                    meet(met, crossing, films, adjoint)
                pull(positions, cameras, drawn, crossing.away, weight)

        self._made(kernel, freeze, self.met)


def met_by(views: int) -> list[mi.Float]:
    """Of each cell, the sum of the squares of ∂ℒ/∂I met there, and their number: none so far."""
    return [dr.opaque(mi.Float, 0, views * _CELLS**2) for _ in range(2)]


def _cell(view: mi.UInt32, x: mi.Float, y: mi.Float) -> mi.UInt32:
    """``x``, ``y`` in [0, 1]: shares of a film's sides. Traced."""
    column, row = (mi.UInt32(dr.clip(each * _CELLS, 0, _CELLS - 1)) for each in (x, y))
    return (view * _CELLS + row) * _CELLS + column


def meet(met: list, crossing: Crossing, films: Views, adjoint: mi.Color3f) -> None:
    """Put ``adjoint`` into the cells where it was met. Traced."""
    width = mi.Float(dr.gather(mi.UInt32, films.width, crossing.view))
    height = mi.Float(dr.gather(mi.UInt32, films.height, crossing.view))
    cell = _cell(crossing.view, mi.Float(crossing.column) / width, mi.Float(crossing.row) / height)
    square = dr.sum(dr.square(adjoint))
    ok = crossing.valid & dr.isfinite(square)
    for i, value in enumerate((square, mi.Float(1))):
        fresh = dr.zeros(mi.Float, dr.width(met[i]))
        dr.scatter_add(fresh, value, cell, ok)
        met[i] = met[i] * _KEPT + fresh
    dr.eval(met)


def lengths(
    positions: mi.Float, outline: Outline, cameras: Cameras, films: Views, views: int, met
) -> mi.Float:
    """Of each edge in each view, its length in pixels if it is a silhouette and may lie in the
    image, else 0, ``(views E,)``; with what was ``met``, times the root mean square there.
    Traced."""
    edge, view = every(outline, views)
    found = silhouettes(positions, outline, cameras.eyes, edge, view)
    ends = [at(positions, vertex) for vertex in pair(outline.ends, edge)]
    x, y, length = spans(cameras, films, view, ends)
    if met is not None:
        squares, counts = met
        mean = dr.maximum(dr.sum(squares) / dr.maximum(dr.sum(counts), 1), 1e-30)
        # A cell without samples counts as the mean.
        each = (squares + mean) / (counts + 1)
        sides = (mi.Float(dr.gather(mi.UInt32, n, view)) for n in (films.width, films.height))
        cell = _cell(view, *(dr.mean(place) / size for place, size in zip((x, y), sides)))
        length *= dr.sqrt(dr.maximum(dr.gather(mi.Float, each, cell, found), _FLOOR * mean) / mean)
    return dr.select(found, length, 0)
