"""What stands still, and can throw a shadow on what moves or show itself in it, as triangles."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene.problem import Problem
from ..scene.topology import Topology
from ..unknowns.parameters import own
from . import rays
from .shadows import Lamps

# Corners that stand for a disk's border: they miss 8e-5 of its radius.
_CORNERS = 256
# Of the triangles around a sphere, as doublings of an icosahedron's: they miss 1e-3 of its radius.
_DOUBLINGS = 4
# Points of lamps that shapes are looked at from.
_POINTS = 256
# What moves, with so many times its own size around it, where it may come or grow to.
_ROOM = 3.0


def others(problem: Problem) -> tuple[mi.Float, Topology] | None:
    """Of the meshes that stand still, and of the rectangles, disks and spheres that can throw a
    shadow of a lamp, no sky, on what moves, where it is now or comes to near there: all as one, the
    vertices' positions and how their triangles hang together; None where there are none.

    Triangles are around a sphere or disk, not in it: it hides none of their edges from a lamp.
    """
    params, shapes = mi.traverse(problem.scene), problem.scene.shapes()
    meshes = [triangles(params, key) for key in meshes_of(problem, params)]
    plain = [(shape.class_name(), shape) for shape in shapes if shape.class_name() in _PLAIN]
    if plain:
        lamps, moving = _lamps(problem), _moving(problem, params)
        for kind, shape in plain:
            points, faces = _PLAIN[kind]()
            points = _placed(params, shape, points)
            if lamps and _in_the_way(points, kind != "Sphere", *lamps, moving):
                meshes.append((points, faces))
    if not meshes:
        return None
    positions = np.concatenate([each for each, _ in meshes]).astype(np.float32)
    return own(mi.Float, positions.ravel()), Topology.together([Topology.of(*m) for m in meshes])


def surfaces(problem: Problem, params: mi.SceneParameters) -> dict[str, np.ndarray]:
    """By name, the triangles ``(F, 3, 3)`` of all meshes and rectangles that the scene lists."""
    found = {}
    for shape in problem.scene.shapes():
        key = f"{shape.id()}.vertex_positions"
        if key in params and dr.width(params[key]):
            points, faces = triangles(params, key)
            found[shape.id()] = points[faces]
        elif shape.class_name() == "Rectangle":
            points, faces = _rectangle()
            found[shape.id()] = _placed(params, shape, points)[faces]
    return found


def meshes_of(problem: Problem, params: mi.SceneParameters) -> list[str]:
    """The keys of the positions of the meshes that stand still."""
    ids = {shape.id() for shape in problem.scene.shapes() if shape.is_mesh()}
    every = (f"{id}.vertex_positions" for id in sorted(ids - problem.unknowns.moved))
    return [key for key in every if key in params]


def triangles(params: mi.SceneParameters, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Positions ``(n, 3)``, which are ``params[key]``, and faces ``(F, 3)`` of a mesh."""
    faces = np.array(params[f"{key.rpartition('.')[0]}.faces"]).reshape(-1, 3)
    return np.array(params[key]).reshape(-1, 3), faces.astype(np.int64)


def _placed(params: mi.SceneParameters, shape: mi.Shape, points: np.ndarray) -> np.ndarray:
    """Points of a shape before its ``to_world`` in the world."""
    matrix = np.array(params[f"{shape.id()}.to_world"].matrix, np.float64).reshape(4, 4)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def _flat(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points ``(n, 3)`` and triangles ``(n - 2, 3)`` of a convex polygon, ``corners (n, 2)``."""
    second = np.arange(1, len(corners) - 1)
    faces = np.stack([np.zeros_like(second), second, second + 1], axis=1)
    return np.pad(corners, ((0, 0), (0, 1))), faces


def _rectangle() -> tuple[np.ndarray, np.ndarray]:
    return _flat(np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]))


def _disk() -> tuple[np.ndarray, np.ndarray]:
    turn = np.arange(_CORNERS) * (2 * np.pi / _CORNERS)
    return _flat(np.stack([np.cos(turn), np.sin(turn)], axis=1) / np.cos(np.pi / _CORNERS))


def _sphere() -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    ball = trimesh.creation.icosphere(_DOUBLINGS)
    planes = np.einsum("fk,fk->f", ball.face_normals, ball.triangles[:, 0])
    return ball.vertices / planes.min(), np.asarray(ball.faces)


# By Mitsuba's class, points and triangles before ``to_world``.
_PLAIN = {"Rectangle": _rectangle, "Disk": _disk, "Sphere": _sphere}


def _lamps(problem: Problem) -> tuple[np.ndarray, np.ndarray] | None:
    """Points on lamps, ``(n, 3)``, and ``(n,)``: 1, or 0 for one infinitely far, in the direction
    of the point; None where there is but a sky."""
    sky = problem.scene.environment()
    lamps = [each for each in problem.scene.emitters() if sky is None or each != sky]
    if not lamps:
        return None
    centre, count = np.array(problem.scene.bbox().center()).ravel(), max(_POINTS, len(lamps))
    eyes = Lamps.draw(lamps, centre, count, rays.stream(mi.UInt32(0), count)).eyes
    return np.array(eyes.place, np.float64).T, np.array(eyes.finite, np.float64)


def _moving(problem: Problem, params: mi.SceneParameters) -> np.ndarray:
    """Vertices of all that moves, ``(n, 3)``."""
    keys = (f"{id}.vertex_positions" for id in sorted(problem.unknowns.moved))
    return np.concatenate([np.array(params[key]).reshape(-1, 3) for key in keys if key in params])


def _in_the_way(points, flat: bool, places, finite, moving) -> bool:
    """Whether a shape through ``points`` may be between a lamp and what is moving: not where a
    plane that it is ``flat`` in has all of them on one side, nor where the ball around it is beside
    all capsules from a lamp's point to a ball well around what is moving."""
    if flat:
        normal = np.cross(points[1] - points[0], points[-1] - points[0])
        normal /= np.linalg.norm(normal)
        sides = np.concatenate([moving @ normal, places @ normal])
        sides -= np.concatenate([np.ones(len(moving)), finite]) * (points[0] @ normal)
        least = 1e-4 * np.abs(sides).max()
        if not ((sides > least).any() and (sides < -least).any()):
            return False
    (middle, radius), (centre, reach) = _ball(points), _ball(moving)
    way = places - finite[:, None] * centre
    along = way @ (middle - centre) / np.maximum(np.einsum("ij,ij->i", way, way), 1e-300)
    along = np.clip(along, 0, np.where(finite > 0, 1, np.inf))
    beside = np.linalg.norm(middle - centre - along[:, None] * way, axis=1)
    return bool((beside <= radius + _ROOM * reach).any())


def _ball(points: np.ndarray) -> tuple[np.ndarray, float]:
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return middle, float(np.linalg.norm(points - middle, axis=1).max())
