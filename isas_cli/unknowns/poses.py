"""Poses: movements of a scene's objects as parameters that Mitsuba itself does not have.

A pose θ is a few numbers: the angle of a rotation (degrees), the lengths of a translation along
given directions (scene units), or the size, as the binary logarithm of a factor. It writes what
Mitsuba keeps of its objects (vertices and normals of a mesh, ``to_world`` of other shapes and
sensors, ``position`` of a point light), differentiably: so derivatives by these flow on to θ. At θ
= ``at`` everything stands as it was loaded, to the bit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.errors import InputError, nearest
from .kind import Kind, Loaded
from .parameters import like, owner

_UNITS = {"rotation": "degrees", "translation": "scene units", "scale": "doublings"}
_MOVABLE = ("vertex_positions", "to_world", "position")
# By Mitsuba's class: what a mirrored to_world turns inside out at each write, and what has no size.
_TURNED, _SIZELESS = ("Sphere", "Cylinder"), ("PerspectiveCamera", "ThinLensCamera")


@dataclass
class _Object:
    """What moves, and where it is without any movement; ``part``: of each vertex, or None."""

    id: str
    points: mi.Point3f | None = None
    normals: mi.Normal3f | None = None
    to_world: object = None
    position: mi.Point3f | None = None

    @staticmethod
    def of(params: Mapping, id: str) -> "_Object":
        """``params``: values by key; a copy is made."""

        def value(name: str):
            key = f"{id}.{name}"
            return params[key] if key in params else None

        positions, normals = value("vertex_positions"), value("vertex_normals")
        if positions is not None:
            points = dr.unravel(mi.Point3f, mi.Float(positions))
            smooth = normals is not None and dr.width(normals) > 0
            return _Object(
                id, points, dr.unravel(mi.Normal3f, mi.Float(normals)) if smooth else None
            )
        if value("to_world") is not None:
            return _Object(id, to_world=type(value("to_world"))(value("to_world")))
        return _Object(id, position=mi.Point3f(value("position")))

    def named(self) -> dict:
        """Mitsuba's parameters by their whole key."""
        return {f"{self.id}.{name}": value for name, value in self.values().items()}

    def places(self) -> np.ndarray:
        """Points of the object, ``(n, 3)``: vertices, or its place and what is a unit from there
        along its own axes."""
        if self.points is not None:
            return np.array(self.points).T
        if self.position is not None:
            return np.array(self.position).reshape(1, 3)
        matrix = np.array(self.to_world.matrix).reshape(4, 4)
        middle, axes = matrix[:3, 3], matrix[:3, :3].T
        return np.concatenate([middle[None], middle + axes, middle - axes])

    def values(self) -> dict:
        """Mitsuba's parameters by their last word."""
        if self.points is None:
            return (
                {"to_world": self.to_world}
                if self.position is None
                else {"position": self.position}
            )
        values = {"vertex_positions": dr.ravel(self.points)}
        # Given as well: Mitsuba would make its own from the triangles.
        return (
            values if self.normals is None else values | {"vertex_normals": dr.ravel(self.normals)}
        )


class Pose(Kind):
    """One pose: ``parts`` × ``each`` entries, ``each`` 1 or the number of directions."""

    name = "pose"
    moves_geometry = True
    listed = "one per direction, or one per part and direction"

    @classmethod
    def keys(cls, loaded: Loaded) -> list[str]:
        return list(loaded.poses)

    @classmethod
    def check(cls, loaded: Loaded, chosen: list[str]) -> None:
        for name in loaded.poses:
            if name not in chosen:
                raise InputError(
                    f"scene.poses['{name}'] is not among scene.unknowns: give it a start there, or "
                    "leave it out"
                )

    def __init__(self, key: str, loaded: Loaded):
        where, spec, params = f"scene.poses['{key}']", loaded.poses[key], loaded.params
        if key in params:
            raise InputError(f"{where}: the scene has a parameter of this name")
        self.key, self.spec, self.parts, self.settings = key, spec, spec.parts, repr(spec)
        self.ids = _matching(where, spec.objects, params)
        for id in self.ids:
            if reason := _refusal(spec.kind, id, params):
                raise InputError(f"{where}: '{id}': {reason}")
        if self.parts > 1:
            for id in self.ids:
                _check_parts(where, id, self.parts, params)
        self._left = [id for id in self.ids if _filled(params, id)]
        ways = np.array(spec.directions, float)
        self.ways = ways / np.linalg.norm(ways, axis=1, keepdims=True)  # (each, 3)
        turns = spec.kind == "rotation"
        self.affine = self.parts == 1
        self.each = len(spec.directions) if spec.kind == "translation" else 1
        self.repeats = self.each
        at = np.zeros(self.each) if spec.at is None else np.asarray(spec.at, float)
        if at.shape not in ((self.each,), (self.size,)):
            raise InputError(f"{where}.at={list(spec.at)}: {self.each} numbers, one per direction")
        at = np.broadcast_to(at.reshape(-1, self.each), (self.size // self.each, self.each))
        self.present = np.ascontiguousarray(at, np.float32).reshape(-1)
        self._rest = {id: _Object.of(params, id) for id in self.ids}
        dr.eval([item.values() for item in self._rest.values()])
        self._names = {id: list(item.named()) for id, item in self._rest.items()}
        self.writes = [name for names in self._names.values() for name in names]
        self.range = -np.inf, np.inf
        self.unit = _UNITS[spec.kind]
        self.period = spec.period if turns else None
        self.scale = self._scale()
        # After all that gives an object its shape, and in the order in which poses are given.
        self.order = 1, list(loaded.poses).index(key)

    def warnings(self) -> list[str]:
        return [
            f"scene.poses['{self.key}'] moves '{id}', and the grid of the medium in it stays where "
            "it is: Mitsuba places it by itself"
            for id in self._left
        ]

    @property
    def size(self) -> int:
        """How many entries."""
        return self.parts * self.each

    def _scale(self) -> float:
        """How large the numbers are that this pose's are added to, in its own unit: coordinates,
        and for a rotation or a size the angle, or the doublings, by which its longest arm moves as
        far."""
        points = np.concatenate([item.places() for item in self._rest.values()])
        coordinates = float(np.abs(points).max()) or 1.0
        if self.spec.kind == "translation":
            return coordinates
        arms = points - np.asarray(self.spec.origin, float)
        if self.spec.kind == "rotation":
            axis = np.asarray(self.spec.axis, float) / np.linalg.norm(self.spec.axis)
            arms = np.cross(arms, axis)
        # What turns about its own middle has no arm: nothing moves that could be resolved.
        longest = max(float(np.linalg.norm(arms, axis=1).max()), 1e-3 * coordinates)
        turned = coordinates / longest
        return math.degrees(turned) if self.spec.kind == "rotation" else turned / math.log(2)

    def value(self, array: np.ndarray) -> mi.Float:
        return like(mi.Float, array)

    def write(self, leaf: mi.Float, written: dict) -> None:
        for id, rest in self._rest.items():
            if not written.keys().isdisjoint(self._names[id]):  # moved or shaped already
                rest = _Object.of(rest.named() | written, id)
            written |= self.move(rest, leaf).named()

    def place(self, where: str) -> tuple[Kind, np.ndarray]:
        if self.spec.kind != "translation":
            raise InputError(f"{where}: only for a translation")
        if len(self.ids) > 1:
            raise InputError(f"{where}: only for a pose of one object that nothing else moves")
        rest = self._rest[self.ids[0]]
        if rest.points is not None:
            return self, np.array(rest.points).T.reshape(self.parts, -1, 3).mean(axis=1)
        at = rest.to_world.translation() if rest.position is None else rest.position
        return self, np.array(at).reshape(1, 3)

    def move(self, item: _Object, θ: mi.Float) -> _Object:
        """``item`` after this movement. Traced, differentiable by ``θ (size,)``."""
        moved = θ - mi.Float(self.present)
        if item.points is None:
            transform = self._transform([self._entry(moved, i) for i in range(self.each)])
            if item.position is not None:
                return _Object(item.id, position=transform @ item.position)
            kind = type(item.to_world)
            return _Object(item.id, to_world=kind((transform @ item.to_world).matrix))
        part = None
        if self.parts > 1:
            # In order, equally many vertices each.
            each = dr.width(item.points) // self.parts
            part = dr.repeat(dr.arange(mi.UInt32, self.parts), each)
        amounts = [self._entry(moved, i, part) for i in range(self.each)]
        if self.spec.kind == "translation":
            return _Object(item.id, item.points + self._offset(amounts), item.normals)
        origin = mi.Point3f(*map(float, self.spec.origin))
        if self.spec.kind == "scale":
            grown = (item.points - origin) * (dr.exp2(amounts[0]) - 1)
            return _Object(item.id, mi.Point3f(item.points + grown), item.normals)
        points = item.points + _turn(item.points - origin, self._axis, amounts[0])
        normals = item.normals
        if normals is not None:
            normals = mi.Normal3f(normals + _turn(mi.Vector3f(normals), self._axis, amounts[0]))
        return _Object(item.id, mi.Point3f(points), normals)

    def _entry(self, θ: mi.Float, direction: int, part: mi.UInt32 | None = None) -> mi.Float:
        index = mi.UInt32(direction) if part is None else part * self.each + direction
        return dr.gather(mi.Float, θ, index)

    @property
    def _axis(self) -> mi.Vector3f:
        axis = np.asarray(self.spec.axis, float)
        return mi.Vector3f(*(axis / np.linalg.norm(axis)).tolist())

    def _offset(self, amounts: list[mi.Float]) -> mi.Vector3f:
        terms = (mi.Vector3f(*way) * a for way, a in zip(self.ways.tolist(), amounts))
        return sum(terms, mi.Vector3f(0))

    def _transform(self, amounts: list[mi.Float]) -> mi.Transform4f:
        if self.spec.kind == "translation":
            return mi.Transform4f().translate(self._offset(amounts))
        origin = mi.Vector3f(*map(float, self.spec.origin))
        there = mi.Transform4f().translate(origin)
        if self.spec.kind == "scale":
            there = there.scale(mi.Vector3f(dr.exp2(amounts[0])))
        else:
            there = there.rotate(self._axis, amounts[0])
        return there.translate(-origin)


def _turn(vector: mi.Vector3f, axis: mi.Vector3f, degrees: mi.Float) -> mi.Vector3f:
    """What Rodrigues' rotation adds to ``vector``: exactly nothing at 0 degrees."""
    sin, cos = dr.sincos(dr.deg2rad(degrees))
    across = axis * dr.dot(axis, vector) - vector
    return dr.cross(axis, vector) * sin + across * (1 - cos)


def _matching(where: str, patterns: list[str], params: mi.SceneParameters) -> list[str]:
    """Ids of objects that can be moved, by name or pattern (``cube_*``)."""
    movable, found = movable_in(params), []
    for pattern in patterns:
        # Ids may have what patterns are made of: 'cube[0]' is one.
        ids = [id for id in movable if id == pattern or fnmatchcase(id, pattern)]
        if not ids:
            raise InputError(
                f"{where}.objects: '{pattern}' is nothing that can be moved; "
                f"{nearest(pattern, movable)}"
            )
        found += [id for id in ids if id not in found]
    return found


def movable_in(params: mi.SceneParameters) -> list[str]:
    """Ids of all objects that a pose can move."""
    words = [key.rpartition(".") for key in params.keys()]
    return list(dict.fromkeys(id for id, _, word in words if word in _MOVABLE))


def _refusal(kind: str, id: str, params: mi.SceneParameters) -> str:
    """Why Mitsuba does not show the object ``id`` as a pose of this ``kind`` moves it, and what to
    do; or nothing."""
    key = f"{id}.to_world"
    if key not in params:
        return ""
    holder = owner(params, key)
    what = holder.class_name()
    if what == "SDFGrid" and kind == "rotation":
        return (
            "Mitsuba shows a turned sdfgrid with holes: put it into a shapegroup and turn an "
            "instance of it"
        )
    if what in _SIZELESS and kind == "scale":
        return "Mitsuba scales no camera with a perspective: leave it out"
    far = isinstance(holder, mi.Emitter) and mi.has_flag(holder.flags(), mi.EmitterFlags.Infinite)
    if far and kind != "rotation":
        return "it is infinitely far away, so that only a rotation of it shows: leave it out"
    turn = np.array(params[key].matrix, np.float64).reshape(4, 4)[:3, :3]
    if what in _TURNED and np.linalg.det(turn) < 0:
        return (
            f"of a mirrored {what.lower()} Mitsuba flips the normals at each movement: write it "
            "unmirrored, with flip_normals"
        )
    return ""


def _check_parts(where: str, id: str, parts: int, params: mi.SceneParameters) -> None:
    key = f"{id}.vertex_positions"
    if key not in params:
        raise InputError(f"{where}.parts={parts}: '{id}' is no mesh, and has no parts")
    vertices = dr.width(params[key]) // 3
    if vertices % parts:
        raise InputError(
            f"{where}.parts={parts}: '{id}' has {vertices} vertices, no multiple of it"
        )


def _filled(params: Mapping, id: str) -> bool:
    """Whether a medium whose numbers lie on a grid fills the shape ``id``."""
    for name in ("vertex_positions", "to_world"):
        if f"{id}.{name}" in params:
            shape = owner(params, f"{id}.{name}")
            inside = shape.interior_medium() if isinstance(shape, mi.Shape) else None
            if inside is not None:
                values = mi.traverse(inside)
                return any(getattr(values[key], "ndim", 0) == 4 for key in values.keys())
    return False
