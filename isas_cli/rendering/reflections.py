"""Silhouettes of meshes that other surfaces show: in reflections and in scattered light."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..scene.problem import Problem
from ..scene.topology import Topology
from . import rays
from .border import Border, residual, shown
from .outline import Eyes, Outline, at, backward_ray, draw, pair, sample, side
from .projective import without_film


class Reflections(Border):
    """Adds to the gradient of one mesh's vertices, θ, what its silhouettes bring that a camera sees
    by way of one other surface.

    From a point x that a camera sees, radiance differs by ΔL = L_front - L_behind across a
    silhouette of the mesh. Of all lines that touch it, an estimate draws M, ``samples``: an edge,
    with probability P proportional to its length l times the angle φ by which its faces turn; a
    point b on it and a direction ω of its silhouettes, uniformly (4 φ, as a solid angle). The line
    is followed back to x, which is connected with one view of V, drawn uniformly, in its pixel j.
    With s the sine between line and edge and J the area in pixels of a unit of the surface at x
    (the boundary integral of Zhang et al. 2023, 'Projective Sampling', for one bounce, in pixels):

        V/M Σ_i ⟨∂ℒ/∂I⟩_{j(x_i)} f(x_i) J_i s_i / |n_x·ω_i| 4 φ l / P_i
            · (ΔL n·∂b/∂θ + L_behind (1 - r) n·∂x/∂θ),

    f the BSDF with its cosine, n the normal of line and edge away from the object. The last term is
    that of an x that moves, along the camera's ray; r: the share of the way from x to what is
    behind at which b lies, 0 under a sky. ``emission=False``: without light that comes directly
    from an emitter behind, which is the part of ``Shadows``.

    Bias: none for this mesh's silhouettes by way of one surface that is neither an ideal mirror nor
    clear, under the conditions of ``Silhouettes``; left out are ways by two surfaces and more. A
    mesh that stands still has none but the last term. Edges that a point or directed light sees
    are no silhouettes here. The variance is infinite where a surface of smooth normals shows them
    edge on.
    """

    def __init__(
        self, problem: Problem, loss, id: str, topologies: dict[int, Topology], samples: int,
        paths: int, emission: bool = True, freeze: bool = True,
    ):  # fmt: skip
        super().__init__(problem, topologies, samples, paths + 3)
        (shape,) = [each for each in problem.scene.shapes() if each.id() == id]
        still = id not in problem.unknowns.moved
        integrator, differences = problem.integrator, without_film(problem.integrator)
        views = len(problem.film_sizes)
        moved = [each for each in problem.scene.shapes() if each.id() in problem.unknowns.moved]

        def kernel(scene, sensors, films, positions, outline, cameras, targets, mask, seeds, share):
            with dr.suspend_grad():
                now = dr.detach(positions)
                every = dr.arange(mi.UInt32, outline.count)
                drawn = draw(_turn(now, outline, every)[0], outline, samples, seeds[0])
                random = rays.stream(seeds[1], samples)
                start, end = at(now, drawn.a), at(now, drawn.b)
                point = dr.lerp(start, end, drawn.t)
                measure, across, beyond, turn = _turn(now, outline, drawn.edge)
                way = _direction(end - start, across, beyond, turn, random)
                number = dr.arange(mi.UInt32, samples)
                far, drawn = Eyes(-way, dr.zeros(mi.Float, samples)), replace(drawn, eye=number)
                plane, inner = side(now, outline, far, drawn)
                found = sample(now, outline, drawn, point, way, plane, inner, mi.ShapePtr(shape))
                valid = drawn.probability > 0
                si = scene.ray_intersect(backward_ray(found), valid)
                valid &= si.is_valid()
                # What stands still shows no motion of its own.
                own = mi.Bool(False)
                for each in moved:
                    own |= si.shape == mi.ShapePtr(each)
                valid = valid & own if still else valid

                frame = mi.Frame3f(si.n)
                crossing, begin, valid = shown(
                    *(scene, cameras, films, si, frame.s, frame.t, valid, random)
                )
                value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(way), valid)
                valid &= dr.any(value > 0)
                s, t = (cameras.along(crossing.view, si.p, each) for each in (frame.s, frame.t))
                value *= dr.abs(s.x * t.y - s.y * t.x)
                value *= dr.norm(dr.cross(way, dr.normalize(end - start)))
                value *= measure / dr.abs(dr.dot(way, si.n))

                step = mi.Color3f(0)  # moves nothing where the edges stand still
                if not still:
                    step, _ = differences.sample_radiance_difference(
                        scene, found, mi.UInt32(1), random, mi.Color0f(), valid
                    )
                own &= valid
                ray = found.spawn_ray()
                behind, _, _, _ = differences.sample(
                    *(dr.ADMode.Primal, scene, random, ray, mi.UInt32(1)),
                    *(None, None, own, False, None),
                )
                met = scene.ray_intersect(ray, valid)
                if not emission:
                    light = met.emitter(scene, valid).eval(met, valid)
                    step, behind = step + light, behind - light
                near = dr.norm(point - si.p)
                pivot = dr.select(met.is_valid(), 1 - near / (near + dr.norm(met.p - point)), 1)
                adjoint = residual(
                    *(integrator, loss, scene, sensors, films, targets, mask, share, crossing),
                    *(random, paths),
                )
                adjoint *= value * views / (drawn.probability * samples)
                moves, shows = dr.sum(adjoint * step), dr.sum(adjoint * behind) * pivot
                valid &= dr.isfinite(moves) & dr.isfinite(shows)
                own &= valid
                moves, shows = dr.select(valid, moves, 0), dr.select(own, shows, 0)
                # An edge without a direction has none, and no derivative.
                normal = dr.select(valid, found.n, 0)
                seen = mi.Ray3f(begin, dr.normalize(si.p - begin))
                hit = scene.ray_intersect_preliminary(seen, active=own)
                dr.eval(moves, shows, normal, valid, own, seen, hit)
                with dr.resume_grad():
                    moved_by = dr.lerp(at(positions, drawn.a), at(positions, drawn.b), drawn.t)
                    surface = hit.compute_surface_interaction(seen, mi.RayFlags.Minimal, own)
                    total = dr.select(valid, moves * dr.dot(normal, moved_by), 0)
                    total += dr.select(own, shows * dr.dot(normal, surface.p), 0)
                    dr.backward_from(total)

        self._made(kernel, freeze)


def _turn(
    positions: mi.Float, outline: Outline, edge: mi.UInt32
) -> tuple[mi.Float, mi.Vector3f, mi.Vector3f, mi.Float]:
    """Of each edge, its length times the solid angle of the directions that it is a silhouette in
    (of a valley's, too, whose lines are in the object); the unit vectors from it into one of its
    faces, and across that, towards the other; and the angle from that face to the other. Traced."""
    start, end = (at(positions, each) for each in pair(outline.ends, edge))
    along = dr.normalize(end - start)
    into = []
    for vertex in pair(outline.across, edge):
        way = at(positions, vertex) - start
        into.append(dr.normalize(way - along * dr.dot(way, along)))
    beyond = dr.cross(along, into[0])
    beyond = dr.select(dr.dot(beyond, into[1]) < 0, -beyond, beyond)
    angle = dr.atan2(dr.dot(beyond, into[1]), dr.dot(into[0], into[1]))
    measure = dr.norm(end - start) * 4 * (dr.pi - angle)
    return dr.select(dr.isfinite(measure), measure, 0), into[0], beyond, angle


def _direction(
    edge: mi.Vector3f, across: mi.Vector3f, beyond: mi.Vector3f, turn: mi.Float, random: mi.Sampler
) -> mi.Vector3f:
    """Uniform among the directions that an edge is a silhouette in, ``_turn``. Traced."""
    which, (first, second) = random.next_1d(), random.next_2d()
    sine, cosine = dr.sincos(turn + first * (dr.pi - turn) + dr.select(which < 0.5, dr.pi, 0))
    height = 2 * second - 1
    flat = dr.sqrt(dr.maximum(0, 1 - dr.square(height)))
    way = (across * cosine + beyond * sine) * flat + dr.normalize(edge) * height
    return mi.Vector3f(way)
