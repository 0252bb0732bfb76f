"""The object that photographs show: a mesh from a file, or something simple in its place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...config.schema import PhotosConfig
from ...runtime.errors import InputError
from ...scenes import lathe, meshes
from ...scenes.meshes import Surface
from ..mesh_checks import check_values, degenerate
from ..mesh_files import upwards
from .base import Capture

_KINDS = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
# Between the normals of two triangles that meet: beyond, there is an edge.
_CREASE = 40.0  # degrees


def described(settings: PhotosConfig, capture: Capture) -> bool:
    """Whether anything says what the object is."""
    own = settings.mesh, settings.plane, settings.sphere, capture.plane
    return any(each is not None for each in own)


def surface(settings: PhotosConfig, capture: Capture) -> Surface:
    """In the cameras' world. Raises InputError where nothing says what it is, and for a mesh that
    cannot be rendered."""
    if settings.mesh is not None:
        return _read(settings.mesh)
    if settings.sphere is not None:
        return _sphere(*settings.sphere)
    plane = settings.plane or capture.plane
    if plane is not None:
        return _rectangle(*plane)
    raise InputError(
        "photos.mesh is not given: give a file (OBJ, PLY, STL, glTF), or "
        "photos.plane=[x0,y0,x1,y1] or photos.sphere=[x,y,z,radius]"
    )


def _read(path: str) -> Surface:
    """Raises InputError. Texture coordinates as the file has them, v upwards as other programs
    count it: the first row of a texture is its highest."""
    import trimesh

    file = Path(path)
    if not file.is_file():
        raise InputError(f"photos.mesh={path}: no such file")
    if file.suffix.lower() not in _KINDS:
        raise InputError(f"photos.mesh={path}: a mesh is one of {', '.join(_KINDS)}")
    try:
        mesh = trimesh.load(file, process=False, force="mesh")
        vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces)
        found = getattr(mesh.visual, "uv", None)
    except Exception as error:  # its readers raise whatever a broken file makes them raise
        told = (" ".join(str(error).split()) or type(error).__name__)[:300]
        raise InputError(f"photos.mesh={path}: cannot be read: {told}") from error
    texcoords = np.zeros((0, 2), np.float32)
    if found is not None and len(found) == len(vertices):
        texcoords = upwards(np.asarray(found, np.float32))
    if len(vertices) == 0 or len(faces) == 0:
        raise InputError(f"photos.mesh={path}: has no triangles")
    faces = np.delete(faces, degenerate(vertices, faces), axis=0).astype(np.uint32)
    check_values(vertices, texcoords, faces, file.name)
    return _smoothed(vertices, faces, texcoords)


def _smoothed(vertices: np.ndarray, faces: np.ndarray, texcoords: np.ndarray) -> Surface:
    """At each corner of a triangle the mean normal, by area, of those around it that lie at less
    than ``_CREASE`` to it: smooth, with sharp edges."""
    corners = vertices[faces].astype(np.float64)
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    own = area / np.linalg.norm(area, axis=1, keepdims=True)
    _, place = np.unique(vertices, axis=0, return_inverse=True)
    at = place.ravel()[faces].ravel()  # of each corner
    order, count = np.argsort(at, kind="stable"), np.bincount(at)
    begin = np.cumsum(count) - count
    # Every corner with every corner at the same place.
    many = count[at]
    one = np.repeat(np.arange(at.size), many)
    other = order[np.arange(one.size) - np.repeat(np.cumsum(many) - many, many) + begin[at][one]]
    near = np.einsum("pk,pk->p", own[one // 3], own[other // 3]) > np.cos(np.radians(_CREASE))
    one, other = one[near], other[near] // 3
    normals = np.stack(
        [np.bincount(one, weights=area[other, k], minlength=at.size) for k in range(3)], axis=1
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    laid_out = texcoords[faces] if len(texcoords) else texcoords
    return meshes.from_corners(corners, laid_out, normals.reshape(-1, 3, 3))


def _rectangle(x0: float, y0: float, x1: float, y1: float) -> Surface:
    """Of the plane z = 0. The texture's first row is at ``y0``, its first column at ``x0``."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    vertices = np.column_stack([square * [x1 - x0, y1 - y0] + [x0, y0], np.zeros(4)])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    return _smoothed(vertices.astype(np.float32), faces, square)


def _sphere(x: float, y: float, z: float, radius: float) -> Surface:
    """Closed: each pole, as the seam, is one place."""
    angle = np.linspace(0, np.pi, 65)
    profile = np.column_stack([np.sin(angle), -np.cos(angle)])
    profile[[0, -1], 0] = 0  # sin π is not
    # Of radius 1 until it is whole: how finely its places are told apart does not scale.
    ball = lathe.turn(profile, 128)
    return replace(ball, vertices=ball.vertices * np.float32(radius) + np.float32([x, y, z]))
