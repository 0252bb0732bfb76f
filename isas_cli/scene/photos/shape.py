"""The object that photographs show: a mesh from a file, or something simple in its place."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...config.photographs import PhotosConfig
from ...runtime import memory
from ...runtime.errors import InputError
from ...scenes import lathe, meshes
from ...scenes.meshes import Surface
from ..mesh_checks import LARGEST_OVERLAP, check_indices, check_values, degenerate, overlap
from ..mesh_files import upwards
from ..shape_error import enclosed
from ..topology import Topology
from . import glb, obj, polygons
from .base import Capture

OBJECT = "object"
_NONE = np.zeros((0, 2), np.float32)
_KINDS = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
# Of these, besides OBJ, what trimesh does not read alone.
_READERS = {
    **{".glb": glb.load, ".gltf": glb.load},
    **{".ply": polygons.load, ".off": polygons.load},
}
# Between the normals of two triangles that meet: beyond, there is an edge.
_CREASE = 40.0  # degrees


def described(settings: PhotosConfig, capture: Capture) -> bool:
    """Whether anything says what the object is."""
    own = settings.mesh, settings.plane, settings.sphere, capture.plane
    return any(each is not None for each in own)


def parts(settings: PhotosConfig, capture: Capture) -> dict[str, Surface]:
    """The object in the cameras' world, by the names of the shapes that it is: ``object``, or of a
    mesh of several materials ``object_<material>`` each. Something has to say what it is
    (``described``). Raises InputError for a mesh that cannot be rendered."""
    if settings.mesh is not None:
        return _read(settings.mesh, settings.materials == "one", capture)
    if settings.sphere is not None:
        return {OBJECT: _sphere(*settings.sphere)}
    return {OBJECT: _rectangle(*(settings.plane or capture.plane))}


def of_hull(found: dict[str, np.ndarray]) -> dict[str, Surface]:
    """The object that ``hull.made`` gives."""
    return {OBJECT: _smoothed(found["vertices"], found["faces"], found["texcoords"])}


def joined(surfaces: list[Surface]) -> Surface:
    """One of all, of triangles that share no vertex."""
    if len(surfaces) == 1:
        return surfaces[0]
    textured = all(len(each.texcoords) for each in surfaces)
    vertices, normals = (
        np.concatenate([getattr(each, name) for each in surfaces])
        for name in ("vertices", "normals")
    )
    texcoords = np.concatenate([each.texcoords for each in surfaces if textured] or [_NONE])
    return Surface(
        vertices, np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3), texcoords, normals
    )


def _read(path: str, one: bool, capture: Capture) -> dict[str, Surface]:
    """By material, or ``one`` of all. Raises InputError. Texture coordinates as the file has them,
    v upwards as other programs count it: the first row of a texture is its highest. What is not
    taken of the file is noted in ``capture``."""
    file = Path(path)
    if not file.is_file():
        raise InputError(f"photos.mesh={path}: no such file")
    if file.suffix.lower() not in _KINDS:
        raise InputError(f"photos.mesh={path}: a mesh is one of {', '.join(_KINDS)}")
    try:
        with _quiet():
            pieces = _pieces(file, capture.notes)
    except Exception as error:  # its readers raise whatever a broken file makes them raise
        told = (" ".join(str(error).split()) or type(error).__name__)[:300]
        raise InputError(f"photos.mesh={path}: cannot be read: {told}") from error
    if not any(len(piece.faces) for piece in pieces):
        raise InputError(f"photos.mesh={path}: has no triangles")
    before = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    vertices = np.concatenate([piece.vertices for piece in pieces])
    faces = np.concatenate([piece.faces + first for piece, first in zip(pieces, before)])
    check_indices(faces, len(vertices), f"photos.mesh={path}")
    flat = degenerate(vertices, faces)
    faces = _outward(vertices, np.delete(faces, flat, axis=0).astype(np.uint32))
    names = np.repeat([piece.material for piece in pieces], [len(piece.faces) for piece in pieces])
    names = np.delete(names, flat)
    bare = {piece.material for piece in pieces if piece.texcoords is None}
    texcoords = np.concatenate(
        [np.zeros((len(p.vertices), 2)) if p.texcoords is None else p.texcoords for p in pieces]
    ).astype(np.float32)
    check_values(vertices, texcoords, faces, file.name)
    whole = _smoothed(vertices, faces, texcoords)
    found = {name: _part(whole, names == name, name in bare) for name in dict.fromkeys(names)}
    if any(piece.coloured for piece in pieces):
        capture.notes.append(
            f"{path} has colours at its vertices or faces, which are not taken: the object's are "
            "found from the photographs"
        )
    if len(found) == 1 and one:
        raise InputError(
            f"photos.materials=one: {path} has one material alone: leave photos.materials out"
        )
    if len(found) == 1:
        return {OBJECT: next(iter(found.values()))}
    if one:
        _check_shared(path, found)
        return {OBJECT: joined(list(found.values()))}
    return dict(zip(_called(list(found)), found.values()))


def _outward(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The faces of a mesh that has an inside so that its normals point outwards: both sides are
    shown alike, but a normal map's bumps are glTF's dents on a back."""
    if not len(faces) or enclosed(vertices[faces]) >= 0:
        return faces
    topology = Topology.of(vertices, faces)
    if topology.outward(vertices[topology.first]) >= 0:
        return faces
    return np.ascontiguousarray(faces[:, ::-1])


@contextmanager
def _quiet() -> Iterator[None]:
    """Within, trimesh says nothing: of a picture that a mesh names and that is missing, which is
    not asked for, it logs a whole traceback."""
    log = logging.getLogger("trimesh")
    before = log.level
    log.setLevel(logging.CRITICAL)  # its children follow
    try:
        yield
    finally:
        log.setLevel(before)


@dataclass
class _Piece:
    """Triangles of one ``material``; ``texcoords (V, 2)`` as Mitsuba has them, or None;
    ``coloured``: whether vertices or faces have colours."""

    material: str
    vertices: np.ndarray
    faces: np.ndarray
    texcoords: np.ndarray | None
    coloured: bool


def _pieces(file: Path, notes: list[str]) -> list[_Piece]:
    """Of a mesh file, where its nodes stand; ``notes``: what is said of it. Raises whatever its
    reader raises, and ValueError for texture coordinates that only some faces have, which that
    leaves away."""
    import trimesh

    if file.suffix.lower() == ".obj":
        scene, order = obj.load(file)
    else:
        read = _READERS.get(file.suffix.lower())
        scene = read(file) if read else trimesh.load_scene(file, process=False)
        order = list(scene.geometry)
    if moved := scene.metadata.get(glb.MOVED):
        notes.append(
            f"{file}: pictures of {', '.join(moved)} are moved on it (KHR_texture_transform, or a "
            "second set of texture coordinates), which is not heeded: photos.texture=FILE lies by "
            "the first set as it stands"
        )
    if scene.metadata.get(glb.POSED):
        notes.append(f"{file}: bones and shape keys are not heeded: apply them, then export")
    found, materials = [], {}
    # In the file's order, which its graph of nodes has not.
    rank = {name: number for number, name in enumerate(order)}
    nodes = scene.graph.nodes_geometry
    nodes = sorted(nodes, key=lambda node: rank.get(scene.graph[node][1], len(rank)))
    for node in nodes:
        place, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh):
            continue  # points, or a line
        coloured = _coloured(mesh)
        mesh = mesh.copy()
        uv = glb.given(mesh)
        mesh.apply_transform(place)  # which turns triangles of mirrored nodes round
        vertices = np.asarray(mesh.vertices, np.float32)
        uv = getattr(mesh.visual, "uv", None) if uv is None else uv
        material = getattr(mesh.visual, "material", None)
        label = getattr(material, "name", None) or ""
        # Files have several without a name, or of one.
        key = label, None if material is None else hash(material)
        same = [other for other in materials if other[0] == label]
        called = materials.setdefault(key, f"{label}_{len(same)}" if same else label)
        texcoords = None
        if uv is not None and len(uv) == len(vertices):
            texcoords = upwards(np.asarray(uv, np.float32))
        found.append(_Piece(called, vertices, np.asarray(mesh.faces), texcoords, coloured))
    return found


def _coloured(mesh) -> bool:
    """Whether a mesh has colours of its own: beside a material trimesh keeps them elsewhere."""
    beside = getattr(mesh.visual, "vertex_attributes", {})
    kept = mesh.vertex_attributes, mesh.face_attributes, beside
    return mesh.visual.kind in ("vertex", "face") or any("color" in each for each in kept)


def _part(whole: Surface, chosen: np.ndarray, bare: bool) -> Surface:
    """Of a surface whose triangles share no vertex, those ``chosen (F,)``."""
    corners = np.repeat(chosen, 3)
    texcoords = whole.texcoords[corners] if len(whole.texcoords) and not bare else _NONE
    count = int(chosen.sum())
    faces = np.arange(3 * count, dtype=np.uint32).reshape(-1, 3)
    return Surface(whole.vertices[corners], faces, texcoords, whole.normals[corners])


def _called(materials: list[str]) -> list[str]:
    """Names of shapes, which keys of parameters begin with."""
    found = []
    for number, name in enumerate(materials):
        plain = re.sub(r"[^A-Za-z0-9-]+", "_", name).strip("_") or str(number)
        plain = f"{OBJECT}_{plain}"
        found.append(plain if plain not in found else f"{plain}_{number}")
    return found


def _check_shared(path: str, found: dict[str, Surface]) -> None:
    """Raises InputError where one texture cannot hold what materials show."""
    if not any(len(part.texcoords) for part in found.values()):
        return
    out = "take photos.materials=each, or bake one atlas and export the mesh with that"
    for name, part in found.items():
        if not len(part.texcoords):
            raise InputError(
                f"photos.materials=one: material {name} of {path} has no texture coordinates: {out}"
            )
    charts = [part.texcoords[part.faces] for part in found.values()]
    own = max(overlap(each) for each in charts)
    if (share := overlap(np.concatenate(charts))) > own + LARGEST_OVERLAP:
        raise InputError(
            f"photos.materials=one: {len(found)} materials of {path} share {share:.0%} of the "
            f"texels, each of which would be of several places: {out}"
        )


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
    # Every corner with every corner at the same place: of a large mesh too many pairs for at once.
    end = np.cumsum(count[at])
    first, normals = begin[at] - (end - count[at]), np.zeros((at.size, 3))
    for part in memory.parts(int(count @ count)):
        pair = np.arange(part.start, min(part.stop, count @ count))
        one = np.searchsorted(end, pair, side="right")
        other = order[pair + first[one]] // 3
        near = np.einsum("pk,pk->p", own[one // 3], own[other]) > np.cos(np.radians(_CREASE))
        low, high = one[0], one[-1] + 1
        for k in range(3):
            weights = np.where(near, area[other, k], 0)
            normals[low:high, k] += np.bincount(one - low, weights, high - low)
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
