"""Shapes of Mitsuba's as triangles that other programs read: those that see fronts by the order of
corners, and have no formula for a sphere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mitsuba as mi
import numpy as np

from ..scenes.meshes import Surface
from .mesh_checks import degenerate


@dataclass(frozen=True)
class Front:
    """``surface``: as other programs see it, flat where it has no normals; ``origin (V,)``: which
    of the shape's own vertices each of its is."""

    surface: Surface
    origin: np.ndarray

    def spread(self, **changed: np.ndarray) -> Front:
        """With triangles that share no vertex; ``changed``: values at their corners."""
        chosen = self.surface.faces.ravel()
        values = {
            name: values[chosen] if len(values) else values
            for name, values in vars(self.surface).items()
        }
        values["faces"] = np.arange(len(chosen), dtype=np.uint32).reshape(-1, 3)
        return Front(Surface(**values | changed), self.origin[chosen])


def front(shape: mi.Shape, flipped: bool, pictured: bool, bumpy: bool) -> Front | None:
    """``shape``'s, None where it is no such surface. ``flipped``: its normals, as ``flip_normals``
    has it; ``pictured``: it needs texture coordinates; ``bumpy``: and normals."""
    values = mi.traverse(shape)
    if shape.is_mesh() and "vertex_positions" in values:
        vertices = np.array(values["vertex_positions"]).reshape(-1, 3)
        faces = np.array(values["faces"]).reshape(-1, 3)
        texcoords, normals = np.zeros((0, 2), np.float32), np.zeros((0, 3), np.float32)
        if shape.has_vertex_texcoords():
            texcoords = np.array(values["vertex_texcoords"]).reshape(-1, 2)
        if shape.has_vertex_normals() and not shape.has_face_normals():
            normals = np.array(values["vertex_normals"]).reshape(-1, 3)
        surface = Surface(vertices, faces, texcoords, normals)
    elif shape.class_name() in _CURVED:
        surface = _grid(shape.class_name(), np.array(values["to_world"].matrix).reshape(4, 4))
    else:
        return None
    found = Front(surface, np.arange(len(surface.vertices)))
    if pictured and not len(surface.texcoords):
        # Mitsuba then takes each triangle for half of the picture.
        corners = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
        found = found.spread(texcoords=np.tile(corners, (len(surface.faces), 1)))
    if bumpy and not len(surface.normals):
        found = found.spread()
        own = np.repeat(_across(found.surface), 3, axis=0)
        found = replace(found, surface=replace(found.surface, normals=own))
    surface = found.surface
    if flipped:
        surface = replace(surface, faces=surface.faces[:, ::-1], normals=-surface.normals)
    surface = _fronted(surface) if len(surface.normals) else surface
    return replace(found, surface=surface)


def mirrored(surface: Surface) -> bool | None:
    """Whether its texture coordinates are, v down the picture; None where some of them are."""
    area = _directions(surface)[0]
    sides = {bool(side) for side in area[area != 0] > 0}
    return sides.pop() if len(sides) == 1 else None if sides else False


def tangents(surface: Surface, turned: bool) -> np.ndarray:
    """``(V, 4)``: at each vertex, in its plane, where u grows, the mean of the triangles' around
    it; and of glTF's second axis whether it is ``turned`` round."""
    area, along = _directions(surface)
    along = along * np.sign(area)[:, None]
    summed = np.zeros(surface.vertices.shape)
    for corner in range(3):
        np.add.at(summed, surface.faces[:, corner], along)
    n = surface.normals.astype(np.float64)
    # Where nothing tells, any direction in the plane.
    other = np.cross(n, np.eye(3)[np.abs(n).argmin(axis=1)])
    summed -= n * np.einsum("vk,vk->v", n, summed)[:, None]
    lengths = np.linalg.norm(summed, axis=1, keepdims=True)
    largest = max(lengths.max(), 1e-300)
    summed = np.where(lengths > 1e-6 * largest, summed / np.maximum(lengths, 1e-300), other)
    summed /= np.linalg.norm(summed, axis=1, keepdims=True)
    side = np.full((len(summed), 1), -1.0 if turned else 1.0)
    return np.hstack([summed, side]).astype(np.float32)


def _directions(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Of triangles, twice the area on the picture, and ∂p/∂u times that."""
    if not len(surface.texcoords):
        return np.zeros(len(surface.faces)), np.zeros((len(surface.faces), 3))
    p, uv = (
        each.astype(np.float64)[surface.faces] for each in (surface.vertices, surface.texcoords)
    )
    (u1, v1), (u2, v2) = ((uv[:, corner] - uv[:, 0]).T for corner in (1, 2))
    along = (p[:, 1] - p[:, 0]) * v2[:, None] - (p[:, 2] - p[:, 0]) * v1[:, None]
    return u1 * v2 - u2 * v1, along


def _across(surface: Surface) -> np.ndarray:
    """Normals of the triangles, as long as twice their area."""
    a, b, c = (surface.vertices[surface.faces[:, corner]].astype(np.float64) for corner in range(3))
    return np.cross(b - a, c - a)


def _fronted(surface: Surface) -> Surface:
    """With normals of unit length, and triangles that run about them: Mitsuba tells the side that
    is seen by the normals, other programs by the triangles."""
    own = _across(surface)
    normals = surface.normals.astype(np.float64)
    lengths = np.linalg.norm(normals, axis=1)
    for corner in range(3):
        at = surface.faces[:, corner]
        normals[at] = np.where((lengths[at] > 1e-6)[:, None], normals[at], own)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(lengths > 0, normals / np.maximum(lengths, 1e-300), [0, 0, 1])
    against = np.einsum("fk,fk->f", own, normals[surface.faces].sum(axis=1)) < 0
    faces = np.where(against[:, None], surface.faces[:, ::-1], surface.faces)
    return replace(surface, faces=faces, normals=normals.astype(np.float32))


def _grid(kind: str, to_world: np.ndarray) -> Surface:
    """What Mitsuba has a formula for, as triangles, with its texture coordinates."""
    columns, rows, place = _CURVED[kind]
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    points, normals = (np.stack(np.broadcast_arrays(*each), axis=1) for each in place(*uv.T))
    linear = to_world[:3, :3].astype(np.float64)
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    beside, below = first + 1, first + columns + 1
    corners = (first, beside, below + 1), (first, below + 1, below)
    faces = np.concatenate([np.stack(each, axis=1) for each in corners])
    vertices = (points @ linear.T + to_world[:3, 3]).astype(np.float32)
    faces = np.delete(faces, degenerate(vertices, faces), axis=0).astype(np.uint32)
    normals = (normals @ np.linalg.inv(linear)).astype(np.float32)
    return Surface(vertices, faces, uv.astype(np.float32), normals)


def _on_sphere(u: np.ndarray, v: np.ndarray) -> tuple:
    φ, θ = 2 * np.pi * u, np.pi * v
    found = np.cos(φ) * np.sin(θ), np.sin(φ) * np.sin(θ), np.cos(θ)
    return found, found


def _on_disk(u: np.ndarray, v: np.ndarray) -> tuple:
    φ = 2 * np.pi * v
    return (u * np.cos(φ), u * np.sin(φ), 0 * u), (0 * u, 0 * u, 1 + 0 * u)


def _on_cylinder(u: np.ndarray, v: np.ndarray) -> tuple:
    φ = 2 * np.pi * u
    return (np.cos(φ), np.sin(φ), v), (np.cos(φ), np.sin(φ), 0 * u)


def _on_rectangle(u: np.ndarray, v: np.ndarray) -> tuple:
    return (2 * u - 1, 2 * v - 1, 0 * u), (0 * u, 0 * u, 1 + 0 * u)


_CURVED: dict[str, tuple[int, int, Callable]] = {
    "Sphere": (96, 48, _on_sphere),
    "Disk": (8, 96, _on_disk),
    "Cylinder": (96, 1, _on_cylinder),
    "Rectangle": (1, 1, _on_rectangle),
}
