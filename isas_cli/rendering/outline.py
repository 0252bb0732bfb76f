"""The edges of a mesh that are its silhouette from some points, and drawing among them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.errors import InputError
from ..scene.problem import Problem
from ..scene.topology import Topology
from ..scene.views import Views
from ..unknowns.parameters import own
from . import rays


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


def at(positions: mi.Float, vertex: mi.UInt32) -> mi.Point3f:
    """Of a mesh's ``positions``, those of some vertices. Traced."""
    return mi.Point3f(*[dr.gather(mi.Float, positions, vertex * 3 + k) for k in range(3)])


def pair(table: list, edge: mi.UInt32) -> list[mi.UInt32]:
    """Both columns of one of ``Outline``'s tables. Traced."""
    return [dr.gather(mi.UInt32, each, edge) for each in table]


@dataclass
class Eyes:
    """Points that silhouettes are seen from: ``place (3, n)``, and ``finite (n,)``: 1; or 0 for
    one infinitely far away, in the direction ``place``."""

    place: mi.Vector3f
    finite: mi.Float

    def away(self, index: mi.UInt32, point: mi.Point3f) -> mi.Vector3f:
        """From the eye to ``point``; of any length where the eye is infinitely far. Traced."""
        place = dr.gather(mi.Vector3f, self.place, index)
        return mi.Vector3f(point) * dr.gather(mi.Float, self.finite, index) - place


def silhouettes(
    positions: mi.Float, outline: Outline, eyes: Eyes, edge: mi.UInt32, eye: mi.UInt32
) -> mi.Bool:
    """Whether the faces of ``edge`` lie on the same side of the plane through the edge and the eye,
    so that one is turned to the eye and the other away. Traced."""
    start, end = (at(positions, each) for each in pair(outline.ends, edge))
    one, other = pair(outline.across, edge)
    plane = dr.cross(eyes.away(eye, start), end - start)
    sides = [dr.dot(plane, at(positions, each) - start) for each in (one, other)]
    return (sides[0] * sides[1] > 0) | (one == other)


@dataclass
class Drawn:
    """Points on edges, ``(N,)`` each: ``a + t (b - a)`` on the edge ``edge`` from vertex ``a`` to
    ``b``, a silhouette from ``eye``; the ``probability`` of that edge and eye."""

    eye: mi.UInt32
    edge: mi.UInt32
    t: mi.Float
    a: mi.UInt32
    b: mi.UInt32
    probability: mi.Float


def draw(weights: mi.Float, outline: Outline, samples: int, seed: mi.UInt32) -> Drawn:
    """Stratified draws by ``weights (eyes E,)`` of edges, one eye's after the other's; none has a
    probability above 0 where all weights are 0. Traced, and evaluated on the way."""
    entries = dr.width(weights)
    cdf = dr.cumsum(mi.Float64(weights))
    dr.eval(cdf)
    rng = mi.PCG32(size=samples, initstate=mi.UInt64(seed))
    strata = mi.Float64(dr.arange(mi.UInt32, samples)) + rng.next_float64()
    total = dr.gather(mi.Float64, cdf, entries - 1)
    goal = dr.minimum(strata * (1.0 / samples), 1 - 2.0**-53) * total
    found = mi.UInt32(
        dr.binary_search(0, entries - 1, lambda i: dr.gather(mi.Float64, cdf, mi.UInt32(i)) <= goal)
    )
    below = dr.gather(mi.Float64, cdf, found - 1, found > 0)
    mass = dr.gather(mi.Float64, cdf, found) - below
    eye = found // outline.count
    edge = found - eye * outline.count
    a, b = pair(outline.ends, edge)
    drawn = Drawn(eye, edge, rng.next_float32(), a, b, mi.Float(mass / total))
    dr.eval(drawn)
    return drawn


def side(
    positions: mi.Float, outline: Outline, eyes: Eyes, drawn: Drawn
) -> tuple[mi.Vector3f, mi.Vector3f]:
    """The normal of the plane through edge and eye, and the way from the edge's start to the third
    vertex on the side of which the object lies: the farther one, as the other may be seen edge on.
    Traced."""
    start, end = at(positions, drawn.a), at(positions, drawn.b)
    plane = dr.cross(eyes.away(drawn.eye, start), end - start)
    one, other = (at(positions, each) - start for each in pair(outline.across, drawn.edge))
    nearer = dr.abs(dr.dot(plane, one)) < dr.abs(dr.dot(plane, other))
    return plane, dr.select(nearer, other, one)


def sample(
    positions: mi.Float,
    outline: Outline,
    drawn: Drawn,
    point: mi.Point3f,
    away: mi.Vector3f,
    plane: mi.Vector3f,
    inner: mi.Vector3f,
    shape: mi.ShapePtr | None = None,
) -> mi.SilhouetteSample3f:
    """Mitsuba's record of a ``point`` on an edge, seen along ``away``, on the face that is turned
    to the eye. ``shape``: where more than rays is made from it. Traced."""
    corners, turned = [], []
    for face in pair(outline.faces, drawn.edge):
        ids = [dr.gather(mi.UInt32, outline.corners, face * 3 + k) for k in range(3)]
        p, q, r = (at(positions, each) for each in ids)
        corners.append((face, ids))
        turned.append(-dr.dot(dr.cross(q - p, r - p), away))
    first = turned[0] > turned[1]
    ids = [dr.select(first, i, j) for i, j in zip(corners[0][1], corners[1][1])]
    uv = [dr.select(i == drawn.a, 1 - drawn.t, dr.select(i == drawn.b, drawn.t, 0)) for i in ids]
    found = dr.zeros(mi.SilhouetteSample3f, dr.width(drawn.edge))
    found.p, found.d = point, dr.normalize(away)
    found.n = dr.normalize(plane)
    found.n = dr.select(dr.dot(found.n, inner) > 0, -found.n, found.n)
    found.prim_index = dr.select(first, corners[0][0], corners[1][0])
    found.uv = mi.Point2f(uv[1], uv[2])
    if shape is not None:
        found.shape = shape
    return found


def backward_ray(found: mi.SilhouetteSample3f) -> mi.Ray3f:
    """From the edge towards the eye. Traced."""
    back = mi.SilhouetteSample3f(found)
    back.d = -back.d
    return back.spawn_ray()


@dataclass
class Cameras:
    """From the world to pixels: three rows of each view's matrix, ``rows[r][k] (views,)``, and the
    middles of the pinholes, ``eyes``; ``near``, ``far``: ``(views,)``, depths between which each
    view shows anything."""

    rows: list
    eyes: Eyes
    near: mi.Float
    far: mi.Float

    @staticmethod
    def of(problem: Problem) -> "Cameras":
        """Of the problem's own views: a scene may have others, held out. Raises InputError for
        cameras that are no pinholes."""
        matrices, centres, depths, sensors = [], [], [], problem.scene.sensors()
        for number in problem.kept or range(len(problem.film_sizes)):
            sensor = sensors[number]
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
            # Mitsuba adds it to where rays are asked for, its projection lacks it.
            params = mi.traverse(sensor)
            for row, axis in enumerate("xy"):
                scale[row, 3] = -scale[row, row] * params[f"principal_point_offset_{axis}"][0]
            matrices.append(scale @ projection @ np.linalg.inv(place))
            centres.append(place[:3, 3])
            depths.append((sensor.near_clip(), sensor.far_clip()))
        matrices, centres, depths = (np.array(x, np.float32) for x in (matrices, centres, depths))
        rows = [[own(mi.Float, matrices[:, row, k]) for k in range(4)] for row in (0, 1, 3)]
        place = mi.Vector3f(*[own(mi.Float, centres[:, k]) for k in range(3)])
        eyes = Eyes(place, own(mi.Float, np.ones(len(centres), np.float32)))
        return Cameras(rows, eyes, *(own(mi.Float, each) for each in depths.T.copy()))

    def moved(self, motion: mi.Float) -> "Cameras":
        """Turned about their middles and shifted, as rays are (``Views.motion``). Evaluates."""
        turn, shift = rays.turn_and_shift(motion, dr.arange(mi.UInt32, dr.width(motion) // 6))
        middle = mi.Point3f(self.eyes.place)
        rows = []
        for *way, last in self.rows:
            along = rays.turned(mi.Vector3f(*way), turn)
            # The middle stays where it was in the image.
            last = last + dr.dot(mi.Vector3f(*way), middle) - dr.dot(along, middle + shift)
            rows.append([*along, last])
        eyes = Eyes(self.eyes.place + shift, self.eyes.finite)
        found = replace(self, rows=rows, eyes=eyes)
        dr.eval(found)
        return found

    def through(self, lens: mi.Float, axes: mi.Float) -> "Cameras":
        """Through lenses of other focal lengths and principal points (``Views.lens``), without
        their radial distortion. Evaluates."""
        view = dr.arange(mi.UInt32, dr.width(lens) // 4)
        longer, *shifts = (dr.gather(mi.Float, lens, view * 4 + n) for n in range(3))
        *ways, ahead = (
            mi.Vector3f(*[dr.gather(mi.Float, axes, view * 9 + first + n) for n in range(3)])
            for first in (0, 3, 6)
        )
        rows, depth = [], self.rows[2]
        for row, way, shift in zip(self.rows, ways, shifts):
            middle = dr.dot(mi.Vector3f(*row[:3]), ahead)
            focal = dr.dot(mi.Vector3f(*row[:3]), way)
            other = focal * shift - middle * longer
            rows.append([a * (1 + longer) + b * other for a, b in zip(row, depth)])
        found = replace(self, rows=[*rows, depth])
        dr.eval(found)
        return found

    def homogeneous(self, view: mi.UInt32, point, one: float = 1.0) -> list[mi.Float]:
        """Column and row times depth, and depth; ``one=0``: of a direction. Traced."""
        return [
            sum((dr.gather(mi.Float, row[k], view) * point[k] for k in range(3)), mi.Float(0))
            + dr.gather(mi.Float, row[3], view) * one
            for row in self.rows
        ]

    def reach(self, view: mi.UInt32) -> list[mi.Float]:
        """Depths between which the view shows anything. Traced."""
        return [dr.gather(mi.Float, each, view) for each in (self.near, self.far)]

    def begin(self, view: mi.UInt32, point: mi.Point3f) -> mi.Point3f:
        """Where the view's ray to ``point`` begins: what is nearer hides nothing. Traced."""
        eye = mi.Point3f(dr.gather(mi.Vector3f, self.eyes.place, view))
        near, _ = self.reach(view)
        return dr.lerp(eye, mi.Point3f(point), near / self.homogeneous(view, point)[2])

    def project(self, view: mi.UInt32, point: mi.Point3f) -> mi.Point2f:
        """Column and row, in pixels. Traced."""
        x, y, depth = self.homogeneous(view, point)
        return mi.Point2f(x / depth, y / depth)

    def along(self, view: mi.UInt32, point: mi.Point3f, way: mi.Vector3f) -> mi.Vector2f:
        """How the projection of ``point`` moves, in pixels, as the point moves along ``way``.
        Traced."""
        x, y, depth = self.homogeneous(view, point)
        dx, dy, slope = self.homogeneous(view, way, 0.0)
        return mi.Vector2f(dx * depth - x * slope, dy * depth - y * slope) / dr.square(depth)


@dataclass
class Crossing:
    """Where a curve crosses the images, ``(N,)`` each: ``view``, ``place`` in pixels, the pixel's
    ``column``, ``row`` and number ``pixel``; ``away``: the curve's unit normal away from the
    object; ``speed``: pixels that ``place`` moves as t goes from 0 to 1; ``valid``."""

    view: mi.UInt32
    column: mi.UInt32
    row: mi.UInt32
    pixel: mi.UInt32
    away: mi.Vector2f
    speed: mi.Float
    valid: mi.Bool

    @staticmethod
    def of(
        cameras: Cameras,
        films: Views,
        view: mi.UInt32,
        point: mi.Point3f,
        along: mi.Vector3f,
        inward: mi.Vector3f,
        valid: mi.Bool,
    ) -> "Crossing":
        """Of a curve that passes ``point`` in the direction ``along``, with the object on the side
        of ``inward``. Traced, and evaluated."""
        x, y, depth = cameras.homogeneous(view, point)
        tangent = cameras.along(view, point, along)
        speed = dr.norm(tangent)
        away = mi.Vector2f(tangent.y, -tangent.x) / speed
        away = dr.select(dr.dot(away, cameras.along(view, point, inward)) > 0, -away, away)
        place = mi.Point2f(x / depth, y / depth)
        width = mi.Float(dr.gather(mi.UInt32, films.width, view))
        height = mi.Float(dr.gather(mi.UInt32, films.height, view))
        near, far = cameras.reach(view)
        valid &= (speed > 0) & (depth > near) & (depth < far)
        valid &= (place.x >= 0) & (place.y >= 0) & (place.x < width) & (place.y < height)
        column = mi.UInt32(dr.clip(place.x, 0, width - 1))
        row = mi.UInt32(dr.clip(place.y, 0, height - 1))
        pixel = films.index(view, column, row)
        # An edge without a direction has none, and no derivative.
        found = Crossing(view, column, row, pixel, dr.select(valid, away, 0), speed, valid)
        dr.eval(found)
        return found


def every(outline: Outline, eyes: int) -> tuple[mi.UInt32, mi.UInt32]:
    """All edges from all of so many points, one point's after the other's: edge and point,
    ``(eyes E,)``. Traced."""
    index = dr.arange(mi.UInt32, outline.count * eyes)
    eye = index // outline.count
    return index - eye * outline.count, eye


def spans(
    cameras: Cameras, films: Views, view: mi.UInt32, ends: list[mi.Point3f]
) -> tuple[mi.Vector2f, mi.Vector2f, mi.Float]:
    """Columns and rows of both ends of edges, and their lengths in pixels: 0 of those that reach
    behind the camera or lie outside the image or what it cuts off. Traced."""
    x, y, depth = mi.Vector2f(0), mi.Vector2f(0), mi.Vector2f(0)
    for k, end in enumerate(ends):
        across, down, depth[k] = cameras.homogeneous(view, end)
        x[k], y[k] = across / depth[k], down / depth[k]
    near, far = cameras.reach(view)
    found = (dr.min(depth) > 0) & (dr.max(depth) > near) & (dr.min(depth) < far)
    width = mi.Float(dr.gather(mi.UInt32, films.width, view))
    height = mi.Float(dr.gather(mi.UInt32, films.height, view))
    found &= (dr.max(x) > 0) & (dr.max(y) > 0) & (dr.min(x) < width) & (dr.min(y) < height)
    length = dr.sqrt(dr.square(x[1] - x[0]) + dr.square(y[1] - y[0]))
    return x, y, dr.select(found & dr.isfinite(length), length, 0)


def crossed(
    positions: mi.Float, outline: Outline, cameras: Cameras, films: Views, drawn: Drawn
) -> tuple[mi.Point3f, mi.Vector3f, mi.Vector3f, Crossing]:
    """Where ``drawn`` points lie in the world, ``side`` of them, and where they cross the images.
    Traced, and evaluated."""
    start, end = at(positions, drawn.a), at(positions, drawn.b)
    point = dr.lerp(start, end, drawn.t)
    plane, inner = side(positions, outline, cameras.eyes, drawn)
    where = cameras, films, drawn.eye, point, end - start, inner, drawn.probability > 0
    return point, plane, inner, Crossing.of(*where)


def pull(
    positions: mi.Float, cameras: Cameras, drawn: Drawn, way: mi.Vector2f, weight: mi.Float
) -> None:
    """Add ``weight`` times the derivative of what ``drawn`` points move by along ``way`` of the
    image, in pixels, to the gradient of what ``positions`` depend on. Traced."""
    with dr.resume_grad():
        moved = dr.lerp(at(positions, drawn.a), at(positions, drawn.b), drawn.t)
        dr.backward_from(weight * dr.dot(cameras.project(drawn.eye, moved), way))
