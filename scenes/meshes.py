"""Triangle meshes: read an OBJ file, check it, place it, make a shape of it.

What is checked, and why, says `isas_cli.scene.mesh_checks`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ..runtime.errors import InputError
from ..scene.mesh_checks import check, degenerate

_FOLDER: ContextVar[Path | None] = ContextVar("folder", default=None)


@dataclass(frozen=True)
class Surface:
    """An indexed triangle mesh.

    vertices: (V, 3) float32, positions
    faces: (F, 3) uint32, indices into the vertices, counter-clockwise seen from outside
    texcoords: (V, 2) float32; row i of an n-row texture covers v in [i/n, (i+1)/n].
        (0, 2) for a surface without a texture
    normals: (V, 3) float32, unit length
    """

    vertices: np.ndarray
    faces: np.ndarray
    texcoords: np.ndarray
    normals: np.ndarray


@lru_cache  # Mitsuba's reader keeps some 70 KiB of every file that it has read
def read_obj(
    path: Path, textured: bool = True, material: str | None = None, flat: bool = False
) -> Surface:
    """Read and check an OBJ file as a single mesh, once a process: not to be written to.

    `textured`: the file must have texture coordinates; otherwise they are left away.
    `material`: only the faces that the file gives this material by `usemtl`. Without it material
    statements are ignored: the whole file becomes one surface, which is right for a file with one
    texture atlas.
    `flat`: triangles without area, which show nothing, are left away instead of refused.

    Normals are made smooth here, whatever the file says: some files have none, and Mitsuba's own
    sum over faces runs in parallel, so that its last bits, and with them the hash that cached
    targets are found by, change from run to run. Raises InputError for a missing or broken mesh,
    and for a material that the file does not use.
    """
    import mitsuba as mi

    if not path.is_file():
        raise InputError(f"mesh {path} does not exist")
    name = path.name if material is None else f"{path.name}, material {material},"
    if material is None:
        mesh = _load(path, name)
    else:
        with tempfile.TemporaryDirectory() as folder:
            part = Path(folder) / path.name
            part.write_text(_only(path, material))
            mesh = _load(part, name)
    if textured and not mesh.has_vertex_texcoords():
        raise InputError(f"mesh {name} has no texture coordinates")
    values = mi.traverse(mesh)
    vertices = np.array(values["vertex_positions"]).reshape(-1, 3)
    faces = np.array(values["faces"]).reshape(-1, 3)
    texcoords = np.zeros((0, 2), np.float32)
    if textured:
        texcoords = np.array(values["vertex_texcoords"]).reshape(-1, 2)
    if flat:
        faces = np.delete(faces, degenerate(vertices, faces), axis=0)
    check(vertices, texcoords, faces, name)
    positions, place_of_vertex = np.unique(vertices, axis=0, return_inverse=True)
    normals = corner_normals(positions, place_of_vertex.ravel()[faces])
    return from_corners(vertices[faces], texcoords[faces] if textured else texcoords, normals)


def _load(path: Path, name: str) -> Any:
    import mitsuba as mi

    try:
        return mi.load_dict({"type": "obj", "filename": str(path), "face_normals": True})
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"mesh {name} cannot be read: {reason}") from error


def _only(path: Path, material: str) -> str:
    """The text of an OBJ file without the faces of other materials."""
    kept, current, found = [], None, []
    for line in path.read_text().splitlines():
        word, _, rest = line.strip().partition(" ")
        if word == "usemtl":
            current = rest.strip()
            if current not in found:
                found.append(current)
        elif word != "f" or current == material:
            kept.append(line)
    if material not in found:
        raise InputError(
            f"mesh {path.name} has no material '{material}'; it has: {', '.join(found) or 'none'}"
        )
    return "\n".join(kept)


def from_corners(positions: np.ndarray, texcoords: np.ndarray, normals: np.ndarray) -> Surface:
    """A mesh whose triangles share no vertex, from values (F, 3, n) at their corners.

    `texcoords` may be empty: a surface without a texture.
    """
    return Surface(
        vertices=positions.reshape(-1, 3).astype(np.float32),
        faces=np.arange(3 * len(positions), dtype=np.uint32).reshape(-1, 3),
        texcoords=texcoords.reshape(-1, 2).astype(np.float32),
        normals=normals.reshape(-1, 3).astype(np.float32),
    )


def place(
    surface: Surface,
    height: float = 1.0,
    turn: float = 0.0,
    at: tuple[float, float] = (0.0, 0.0),
) -> Surface:
    """Turn about the y axis (degrees), scale to `height`, and stand on the ground at (x, z).

    Afterwards the bounding box rests on y = 0 and is centred on `at`.
    """
    return placement(surface, height, turn, at)(surface)


def placement(
    whole: Surface,
    height: float = 1.0,
    turn: float = 0.0,
    at: tuple[float, float] = (0.0, 0.0),
) -> Callable[[Surface], Surface]:
    """What `place` does with `whole`, as a function that moves each of its parts alike."""
    angle = np.radians(turn)
    cos, sin = np.cos(angle), np.sin(angle)
    rotation = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    turned = whole.vertices.astype(np.float64) @ rotation.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    foot = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
    scale = height / (high[1] - low[1])

    def moved(part: Surface) -> Surface:
        vertices = (part.vertices.astype(np.float64) @ rotation.T - foot) * scale
        vertices += [at[0], 0, at[1]]
        normals = part.normals.astype(np.float64) @ rotation.T
        return replace(
            part, vertices=vertices.astype(np.float32), normals=normals.astype(np.float32)
        )

    return moved


def corner_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3, 3) float64: at each corner the area-weighted mean normal of the faces around it.

    `positions` (V, 3) must be shared by the triangles that meet there. Where the faces cancel
    (both sides of a thin sheet) each corner takes the normal of its own face.
    """
    vectors = _face_vectors(positions, faces)
    sums = np.zeros((len(positions), 3))
    for corner in range(3):
        np.add.at(sums, faces[:, corner], vectors)
    normals = sums[faces]
    lengths = np.linalg.norm(normals, axis=2, keepdims=True)
    own = vectors[:, None, :]
    size = np.linalg.norm(own, axis=2, keepdims=True)
    return np.where(lengths > 1e-6 * size, normals / np.maximum(lengths, 1e-300), own / size)


@contextmanager
def as_files(folder: Path) -> Iterator[None]:
    """What ``shape`` makes within is a file in ``folder`` and its description, as a scene file can
    name it."""
    before = _FOLDER.set(folder)
    try:
        yield
    finally:
        _FOLDER.reset(before)


def shape(
    name: str, surface: Surface, bsdf: dict[str, Any], colours: np.ndarray | None = None
) -> Any:
    """A Mitsuba mesh with a material, for use as an entry of a scene dictionary; ``colours``,
    ``(V, 3)``: its attribute `vertex_colour`."""
    import mitsuba as mi

    textured = len(surface.texcoords) > 0
    properties = mi.Properties()
    # optimize=False: otherwise Mitsuba may merge materials that are equal at the start.
    properties["bsdf"] = mi.load_dict(bsdf, optimize=False)
    mesh = mi.Mesh(
        name,
        vertex_count=len(surface.vertices),
        face_count=len(surface.faces),
        has_vertex_normals=True,
        has_vertex_texcoords=textured,
        props=properties,
    )
    values = mi.traverse(mesh)
    values["vertex_positions"] = surface.vertices.ravel()
    values["faces"] = surface.faces.ravel()
    values["vertex_normals"] = surface.normals.ravel()
    if textured:
        values["vertex_texcoords"] = surface.texcoords.ravel()
    values.update()
    if colours is not None:
        mesh.add_attribute("vertex_colour", 3, np.ravel(colours).astype(np.float32))
    folder = _FOLDER.get()
    if folder is None:
        return mesh
    path = folder / f"{name}.ply"
    mesh.write_ply(str(path))
    return {"type": "ply", "filename": str(path), "bsdf": bsdf}


def _face_vectors(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3) float64: normals of the faces, as long as twice their area."""
    a, b, c = (positions[faces[:, corner]].astype(np.float64) for corner in range(3))
    return np.cross(b - a, c - a)
