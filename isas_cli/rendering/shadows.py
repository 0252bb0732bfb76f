"""Silhouettes of moving meshes that lights see: the edges of shadows in the images."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.errors import InputError
from ..scene.problem import Problem
from ..scene.topology import Topology
from . import rays
from .border import Border, hidden_by_nothing, residual, shown
from .outline import Eyes, Outline, at, backward_ray, draw, every, pair, sample, side
from .outline import silhouettes as seen_from

# Of edges and points of lamps, the pairs that a step looks at, at most; one point a lamp it does.
_MOST = 1 << 21
# Each is traced by itself, and a step takes a point of each.
MOST_LAMPS = 256


@dataclass
class Lamps:
    """Points on emitters, ``(K,)`` each. ``eyes``: where; ``emitter``; ``normal`` and ``uv`` of
    those on surfaces (``flat``: 1, else 0); ``density``: expected number of points per area, or per
    solid angle for what is infinitely far, or per lamp that is a point."""

    eyes: Eyes
    emitter: mi.EmitterPtr
    normal: mi.Vector3f
    uv: mi.Point2f
    flat: mi.Float
    density: mi.Float

    @staticmethod
    def draw(emitters: list, centre: np.ndarray, count: int, stream: mi.Sampler) -> "Lamps":
        """``count`` points, the same number on each of ``emitters`` or nearly so. ``stream``: of
        ``count`` numbers. Traced."""
        number = dr.arange(mi.UInt32, count)
        which = number % len(emitters)
        found = Lamps(
            Eyes(dr.zeros(mi.Vector3f, count), dr.zeros(mi.Float, count)),
            *(dr.zeros(kind, count) for kind in (mi.EmitterPtr, mi.Vector3f, mi.Point2f)),
            *(dr.zeros(mi.Float, count) for _ in range(2)),
        )
        it = dr.zeros(mi.Interaction3f, count)
        it.p = mi.Point3f(centre.tolist())
        for index, emitter in enumerate(emitters):
            mine, point = which == index, stream.next_2d()
            share = count // len(emitters) + (index < count % len(emitters))
            if mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface):
                shape = emitter.get_shape()
                ps = shape.sample_position(0.0, point)
                place, normal, uv, density, finite, flat = ps.p, ps.n, ps.uv, ps.pdf, 1.0, 1.0
                if shape.class_name() == "Sphere":
                    # Mitsuba 3.9 leaves the normals as they are before ``to_world``.
                    normal = dr.normalize(mi.traverse(shape)["to_world"] @ ps.n)
            else:
                ds, _ = emitter.sample_direction(it, point)
                far = mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite)
                place, finite, flat = ds.d if far else ds.p, 0.0 if far else 1.0, 0.0
                normal, uv, density = ds.n, ds.uv, dr.select(ds.delta, 1, ds.pdf)
            found.eyes.place = dr.select(mine, mi.Vector3f(place), found.eyes.place)
            found.eyes.finite = dr.select(mine, finite, found.eyes.finite)
            found.emitter = dr.select(mine, mi.EmitterPtr(emitter), found.emitter)
            found.normal = dr.select(mine, mi.Vector3f(normal), found.normal)
            found.uv = dr.select(mine, uv, found.uv)
            found.flat = dr.select(mine, flat, found.flat)
            found.density = dr.select(mine, density * share, found.density)
        dr.eval(found)
        return found

    def light(
        self, index: mi.UInt32, point: mi.Point3f, active: mi.Bool
    ) -> tuple[mi.Vector3f, mi.Color3f]:
        """At ``point``, the direction to the lamp's point, and the light from there over its
        density. Traced."""
        to = -self.eyes.away(index, point)
        finite = dr.gather(mi.Float, self.eyes.finite, index)
        emitter = dr.gather(mi.EmitterPtr, self.emitter, index)
        ds = dr.zeros(mi.DirectionSample3f, dr.width(index))
        ds.d = dr.normalize(to)
        ds.dist = dr.select(finite > 0, dr.norm(to), mi.math.RayEpsilon**-1)
        ds.p = point + ds.d * ds.dist
        ds.n = dr.gather(mi.Vector3f, self.normal, index)
        ds.uv = dr.gather(mi.Point2f, self.uv, index)
        ds.emitter = emitter
        it = dr.zeros(mi.Interaction3f, dr.width(index))
        it.p = point
        value = emitter.eval_direction(it, ds, active)
        # Of a surface: from per area to per solid angle.
        cosine = dr.abs(dr.dot(ds.d, ds.n)) / dr.square(ds.dist)
        value *= dr.select(dr.gather(mi.Float, self.flat, index) > 0, cosine, 1)
        return ds.d, value / dr.gather(mi.Float, self.density, index)


class Shadows(Border):
    """Adds to the gradient of what moves what the edges of one mesh's shadows bring: those that it
    throws on anything, itself included, where it moves; those on moving meshes, where it does not.

    A point y of a lamp lights a surface up to a curve: where the rays from y past the mesh's
    silhouette, seen from y, end. There the images step by S, the light from y that the surface
    would scatter to the camera. So, as in ``Silhouettes`` but with the lamps' points for eyes,

        ∂I_j/∂θ = … - ∫ p(y)⁻¹ ∫ S(q, y) n·∂q/∂θ dl(q) p(y) dy    over such curves within pixel j,

    n the normal in the image out of the shadow. A step draws ``lamps`` points y, fewer where edges
    are very many; ``samples`` stratified points on edges, with probability proportional to an
    edge's length across the ray from y; follows the ray from y past the edge to the surface, and
    projects where it ends into one view of V, drawn uniformly:

        -V/M Σ_i ⟨∂ℒ/∂I⟩_{j(q_i)} S(q_i, y_i) |dq/dt| n·∂q_i/∂θ / P_i .

    q moves with the edge, and with the plane of the surface that it falls on.

    Bias: none for light that comes from an emitter directly to what a camera sees directly, under
    the conditions of ``Silhouettes``, for shadows of meshes, and of rectangles, disks and spheres
    that stand still; those of other shapes, those in other light, and those that mirrors and glass
    show, are left out. An emitter that moves itself is not followed.
    """

    def __init__(
        self, problem: Problem, loss, topologies: dict[int, Topology], samples: int, paths: int,
        lamps: int, freeze: bool = True,
    ):  # fmt: skip
        super().__init__(problem, topologies, samples, paths + 1)
        emitters, box = problem.scene.emitters(), problem.scene.bbox()
        if len(emitters) > MOST_LAMPS:
            raise InputError(
                f"estimator=silhouettes: the edges of shadows are found of at most {MOST_LAMPS} "
                f"lamps, and the scene has {len(emitters)}: take estimator.shadows=0, which leaves "
                "them out"
            )
        lamps = max(len(emitters), min(lamps, _MOST // self.edges))
        for emitter in emitters:
            kind = emitter.class_name().lower()
            if kind in ("projector", "directionalarea"):
                raise InputError(
                    f"estimator=silhouettes: the edges of shadows in the light of a {kind} are not "
                    "found: take estimator.shadows=0, which leaves them out"
                )
        centre = np.array(box.center()).ravel()
        integrator, views = problem.integrator, len(problem.film_sizes)

        def kernel(scene, sensors, films, positions, outline, cameras, targets, mask, seeds, share):
            with dr.suspend_grad():
                now = dr.detach(positions)
                lights = Lamps.draw(emitters, centre, lamps, rays.stream(seeds[0], lamps))
                eyes = lights.eyes
                drawn = draw(_lengths(now, outline, eyes, lamps), outline, samples, seeds[1])
                start, end = at(now, drawn.a), at(now, drawn.b)
                point = dr.lerp(start, end, drawn.t)
                away = eyes.away(drawn.eye, point)
                plane, inner = side(now, outline, eyes, drawn)
                found = sample(now, outline, drawn, point, away, plane, inner)
                back = backward_ray(found)
                finite = dr.gather(mi.Float, eyes.finite, drawn.eye)
                far = dr.norm(point - away - back.o) * (1 - mi.math.ShadowEpsilon)
                back.maxt = dr.select(finite > 0, far, dr.inf)
                lit = drawn.probability > 0
                lit &= hidden_by_nothing(scene, back, lit)
                ray = found.spawn_ray()
                hit = scene.ray_intersect_preliminary(ray, active=lit)
                si = hit.compute_surface_interaction(ray, mi.RayFlags.All, lit)
                lit &= si.is_valid()
                dr.eval(ray, hit, lit)

                random = rays.stream(seeds[2], samples)
                # From the edge to the surface, along the rays from the lamp's point.
                distance = dr.norm(si.p - point) / dr.norm(away)
                crossing, _, valid = shown(
                    *(scene, cameras, films, si),
                    *(
                        _cast(way, away, si.n, 1 + finite * distance)
                        for way in (end - start, inner)
                    ),
                    *(lit, random),
                )
                direction, light = lights.light(drawn.eye, si.p, valid)
                value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(direction), valid)
                step = -value * light
                adjoint = residual(
                    *(integrator, loss, scene, sensors, films, targets, mask, share, crossing),
                    *(random, paths),
                )
                weight = dr.sum(adjoint * step) * crossing.speed
                weight *= views / (drawn.probability * samples)
                valid &= dr.isfinite(weight)
                weight = dr.select(valid, weight, 0)
                dr.eval(weight)
                with dr.resume_grad():
                    moved = dr.lerp(at(positions, drawn.a), at(positions, drawn.b), drawn.t)
                    along = eyes.away(drawn.eye, moved)
                    surface = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, valid)
                    reach = dr.dot(surface.p - moved, surface.n) / dr.dot(along, surface.n)
                    place = cameras.project(crossing.view, moved + along * reach)
                    dr.backward_from(dr.select(valid, weight * dr.dot(place, crossing.away), 0))

        self._made(kernel, freeze)


def _cast(way: mi.Vector3f, away: mi.Vector3f, normal: mi.Vector3f, grown: mi.Float):
    """How the end of a ray moves on a plane as its origin moves along ``way``: ``grown`` times that
    far, and along the ray ``away`` until it is on the plane again. Traced."""
    moved = way * grown
    return moved - away * (dr.dot(normal, moved) / dr.dot(normal, away))


def _lengths(positions: mi.Float, outline: Outline, eyes: Eyes, count: int) -> mi.Float:
    """Of each edge from each of ``count`` eyes, its length across the ray from there if it is a
    silhouette, else 0, ``(count E,)``. Traced."""
    edge, eye = every(outline, count)
    found = seen_from(positions, outline, eyes, edge, eye)
    start, end = (at(positions, each) for each in pair(outline.ends, edge))
    length = dr.norm(dr.cross(end - start, dr.normalize(eyes.away(eye, (start + end) / 2))))
    return dr.select(found & dr.isfinite(length), length, 0)
