"""Silhouettes of moving meshes in the images: what they add to the loss gradient."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.errors import InputError
from ..scene.problem import Problem
from ..scene.topology import Topology
from ..scene.views import Views
from ..unknowns.parameters import own
from . import rays
from .projective import without_film


@dataclass
class Cameras:
    """From the world to pixels: three rows of each view's matrix, ``rows[r][k] (views,)``, and the
    middles of the pinholes."""

    rows: list
    centre: list

    @staticmethod
    def of(problem: Problem) -> "Cameras":
        """Raises InputError for cameras that are no pinholes."""
        matrices, centres = [], []
        for number, sensor in enumerate(problem.scene.sensors()):
            if not str(sensor).startswith("PerspectiveCamera"):
                raise InputError(
                    f"sensor {number} is no perspective camera: silhouettes are found for these "
                    "alone"
                )
            film = sensor.film()
            width, height = film.crop_size()
            if any(film.crop_offset()) or any(film.size() != film.crop_size()):
                raise InputError(f"sensor {number} shows a crop: silhouettes need the whole film")
            projection = np.array(sensor.projection_transform().matrix).reshape(4, 4)
            place = np.array(sensor.world_transform().matrix).reshape(4, 4).astype(np.float64)
            scale = np.diag([width, height, 1.0, 1.0])
            matrices.append(scale @ projection @ np.linalg.inv(place))
            centres.append(place[:3, 3])
        matrices, centres = (np.array(x, np.float32) for x in (matrices, centres))
        rows = [[own(mi.Float, matrices[:, row, k]) for k in range(4)] for row in (0, 1, 3)]
        return Cameras(rows, [own(mi.Float, centres[:, k]) for k in range(3)])

    def origin(self, view: mi.UInt32) -> mi.Point3f:
        return mi.Point3f(*[dr.gather(mi.Float, each, view) for each in self.centre])

    def homogeneous(self, view: mi.UInt32, point, one: float = 1.0) -> list[mi.Float]:
        """Column and row times depth, and depth; ``one=0``: of a direction. Traced."""
        return [
            sum((dr.gather(mi.Float, row[k], view) * point[k] for k in range(3)), mi.Float(0))
            + dr.gather(mi.Float, row[3], view) * one
            for row in self.rows
        ]

    def project(self, view: mi.UInt32, point: mi.Point3f) -> mi.Point2f:
        """Column and row, in pixels. Traced."""
        x, y, depth = self.homogeneous(view, point)
        return mi.Point2f(x / depth, y / depth)


@dataclass
class Outline:
    """The edges of one mesh: vertices ``ends``, the two faces' third vertices ``across`` and the
    faces, each a pair of ``(E,) uint32``; ``corners (3 F,)``: the vertices of all faces."""

    ends: list
    across: list
    faces: list
    corners: mi.UInt32

    @staticmethod
    def of(topology: Topology) -> "Outline":
        edges, first = topology.edges, topology.first
        pairs = [
            [own(mi.UInt32, a[:, i].astype(np.uint32)) for i in range(2)]
            for a in (first[edges.ends], first[edges.across], edges.faces)
        ]
        return Outline(*pairs, own(mi.UInt32, first[topology.faces].ravel().astype(np.uint32)))

    @property
    def count(self) -> int:
        return dr.width(self.faces[0])


def _at(positions: mi.Float, vertex: mi.UInt32) -> mi.Point3f:
    return mi.Point3f(*[dr.gather(mi.Float, positions, vertex * 3 + k) for k in range(3)])


def _pair(table: list, edge: mi.UInt32) -> list[mi.UInt32]:
    return [dr.gather(mi.UInt32, each, edge) for each in table]


class Silhouettes:
    """Adds to the gradient of one mesh's vertices what its silhouettes in the images bring.

    The derivative of a pixel I_j, the mean of radiance L over its square, has a part on the curves
    at which L steps by ΔL = L_front - L_behind (Li et al. 2018, Eq. 7):

        ∂I_j/∂θ = … + ∫ ΔL(q) n·∂q/∂θ dl(q)    over the silhouettes within pixel j, in pixels,

    n the normal in the image away from the object. So ∂ℒ/∂θ has one integral over the silhouettes
    of all views, estimated by ``samples`` stratified points q_i: an edge of a view that separates a
    face turned to the camera from one turned away, with probability P proportional to its length
    in pixels, and a point t on it, uniformly:

        1/M Σ_i ⟨∂ℒ/∂I⟩_{j(q_i)} ΔL(q_i) |dq/dt| n·∂q_i/∂θ / P_i .

    ΔL from two paths with the same random numbers on both sides, by Mitsuba's
    ``sample_radiance_difference`` on the face that is turned to the camera; ∂ℒ/∂I from ``paths``
    others through the same pixel. Hidden edges bring nothing: a ray to the camera says so.

    Bias: none for losses of linear derivative and closed meshes of smooth normals; edges that
    reach behind a camera are left out, and so are silhouettes that mirrors, glass and shadows
    show.
    """

    def __init__(
        self, problem: Problem, loss, id: str, topology: Topology, samples: int, paths: int,
        freeze: bool = True,
    ):  # fmt: skip
        self.problem, self.samples, self._paths = problem, samples, paths + 2
        self.cameras, self.outline = Cameras.of(problem), Outline.of(topology)
        (shape,) = [each for each in problem.scene.shapes() if each.id() == id]
        self._shape = shape
        integrator, differences = problem.integrator, without_film(problem.integrator)
        edges, views = self.outline.count, len(problem.film_sizes)

        def kernel(scene, sensors, films, positions, outline, cameras, targets, mask, seeds, share):
            with dr.suspend_grad():
                now = dr.detach(positions)
                cdf = dr.cumsum(mi.Float64(_lengths(now, outline, cameras, films, views)))
                dr.eval(cdf)
                rng = mi.PCG32(size=samples, initstate=mi.UInt64(seeds[0]))
                strata = mi.Float64(dr.arange(mi.UInt32, samples)) + rng.next_float64()
                total = dr.gather(mi.Float64, cdf, edges * views - 1)
                goal = dr.minimum(strata * (1.0 / samples), 1 - 2.0**-53) * total
                found = mi.UInt32(
                    dr.binary_search(
                        0,
                        edges * views - 1,
                        lambda i: dr.gather(mi.Float64, cdf, mi.UInt32(i)) <= goal,
                    )
                )
                below = dr.gather(mi.Float64, cdf, found - 1, found > 0)
                mass = dr.gather(mi.Float64, cdf, found) - below
                probability = mi.Float(mass / total)
                view = found // edges
                edge, t = found - view * edges, rng.next_float32()
                dr.eval(view, edge, t, probability)

                a, b = _pair(outline.ends, edge)
                start, end = _at(now, a), _at(now, b)
                point, eye = dr.lerp(start, end, t), cameras.origin(view)
                x, y, depth = cameras.homogeneous(view, point)
                dx, dy, slope = cameras.homogeneous(view, end - start, 0.0)
                place = mi.Point2f(x / depth, y / depth)
                along = mi.Vector2f(dx * depth - x * slope, dy * depth - y * slope)
                along /= dr.square(depth)
                speed = dr.norm(along)
                away = mi.Vector2f(along.y, -along.x) / speed
                # The object lies on the side of its faces: of the farther third vertex, as the
                # other may be seen edge on.
                plane = dr.cross(start - eye, end - eye)
                first, second = (_at(now, each) for each in _pair(outline.across, edge))
                nearer = dr.abs(dr.dot(plane, first - eye)) < dr.abs(dr.dot(plane, second - eye))
                inner = dr.select(nearer, second, first)
                away = dr.select(
                    dr.dot(away, cameras.project(view, inner) - place) > 0, -away, away
                )
                width = mi.Float(dr.gather(mi.UInt32, films.width, view))
                height = mi.Float(dr.gather(mi.UInt32, films.height, view))
                valid = (probability > 0) & (speed > 0) & (depth > 0)
                valid &= (place.x >= 0) & (place.y >= 0) & (place.x < width) & (place.y < height)
                column = mi.UInt32(dr.clip(place.x, 0, width - 1))
                row = mi.UInt32(dr.clip(place.y, 0, height - 1))
                pixel = films.index(view, column, row)
                # An edge without a direction has none, and no derivative.
                away = dr.select(valid, away, 0)
                dr.eval(pixel, valid, away, speed, column, row)

                step = self._difference(
                    scene, differences, rays.stream(seeds[1], samples), now, outline, edge, t,
                    point, eye, plane, inner, valid,
                )  # fmt: skip
                stream, radiance = rays.stream(seeds[2], samples), mi.Color3f(0)
                for _ in range(paths):
                    ray, weight = rays.spawn(sensors, films, view, column, row, stream)
                    radiance += integrator.primal(scene, stream, ray)[0] * weight
                adjoint = (
                    loss.derivative(radiance / paths, dr.gather(mi.Color3f, targets, pixel)) * share
                )
                if mask is not None:
                    adjoint *= dr.gather(mi.Float, mask, pixel)
                weight = dr.sum(adjoint * step) * speed / (probability * samples)
                weight = dr.select(valid, weight, 0)
                dr.eval(weight)
                with dr.resume_grad():
                    moved = dr.lerp(_at(positions, a), _at(positions, b), t)
                    dr.backward_from(weight * dr.dot(cameras.project(view, moved), away))

        self._kernel = dr.freeze(kernel) if freeze else kernel

    def _difference(
        self, scene, differences, stream, now, outline, edge, t, point, eye, plane, inner, valid
    ) -> mi.Color3f:
        """ΔL at ``point`` of ``edge``; 0 where it is hidden. Traced."""
        corners, turned = [], []
        for face in _pair(outline.faces, edge):
            ids = [dr.gather(mi.UInt32, outline.corners, face * 3 + k) for k in range(3)]
            p, q, r = (_at(now, each) for each in ids)
            corners.append((face, ids))
            turned.append(dr.dot(dr.cross(q - p, r - p), eye - point))
        first = turned[0] > turned[1]
        ids = [dr.select(first, i, j) for i, j in zip(corners[0][1], corners[1][1])]
        a, b = _pair(outline.ends, edge)
        uv = [dr.select(i == a, 1 - t, dr.select(i == b, t, 0)) for i in ids]
        sample = dr.zeros(mi.SilhouetteSample3f, self.samples)
        sample.p, sample.d = point, dr.normalize(point - eye)
        sample.n = dr.normalize(plane)
        sample.n = dr.select(dr.dot(sample.n, inner - point) > 0, -sample.n, sample.n)
        sample.prim_index = dr.select(first, corners[0][0], corners[1][0])
        sample.uv, sample.shape = mi.Point2f(uv[1], uv[2]), mi.ShapePtr(self._shape)
        seen = valid & _visible(scene, sample, eye, valid)
        step, _ = differences.sample_radiance_difference(
            scene, sample, mi.UInt32(0), stream, mi.Color0f(), seen
        )
        return dr.select(seen, step, 0)

    @property
    def paths_per_step(self) -> int:
        """Light paths of one estimate."""
        return self._paths * self.samples

    def accumulate(self, positions: mi.Float, seeds: list) -> None:
        """Add one estimate to the gradient of ``positions``, the scene's attached ones."""
        p = self.problem
        self._kernel(
            p.scene, p.sensors, p.views, positions, self.outline, self.cameras, p.targets, p.mask,
            seeds, p.share,
        )  # fmt: skip


def _visible(scene, sample: mi.SilhouetteSample3f, eye: mi.Point3f, active: mi.Bool) -> mi.Bool:
    """Whether nothing lies between the eye and the edge. Traced."""
    back = mi.SilhouetteSample3f(sample)
    back.d = -back.d
    ray = back.spawn_ray()
    ray.maxt = dr.norm(eye - ray.o) * (1 - mi.math.ShadowEpsilon)
    return ~scene.ray_test(ray, active)


def _lengths(
    positions: mi.Float, outline: Outline, cameras: Cameras, films: Views, views: int
) -> mi.Float:
    """Of each edge in each view, its length in pixels if it is a silhouette and may lie in the
    image, else 0, ``(views E,)``. Traced."""
    edges = outline.count
    index = dr.arange(mi.UInt32, edges * views)
    view = index // edges
    edge = index - view * edges
    start, end = (_at(positions, each) for each in _pair(outline.ends, edge))
    one, other = _pair(outline.across, edge)
    eye = cameras.origin(view)
    plane = dr.cross(start - eye, end - eye)
    sides = [dr.dot(plane, _at(positions, each) - eye) for each in (one, other)]
    found = (sides[0] * sides[1] > 0) | (one == other)
    x, y = mi.Vector2f(0), mi.Vector2f(0)
    for k, point in enumerate((start, end)):
        across, down, depth = cameras.homogeneous(view, point)
        found &= depth > 0
        x[k], y[k] = across / depth, down / depth
    width = mi.Float(dr.gather(mi.UInt32, films.width, view))
    height = mi.Float(dr.gather(mi.UInt32, films.height, view))
    found &= (dr.max(x) > 0) & (dr.max(y) > 0) & (dr.min(x) < width) & (dr.min(y) < height)
    length = dr.sqrt(dr.square(x[1] - x[0]) + dr.square(y[1] - y[0]))
    return dr.select(found & dr.isfinite(length), length, 0)
