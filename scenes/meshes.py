"""Triangle meshes: read an OBJ file, check it, place it, make a shape of it.

The checks exist because a renderer takes broken meshes in silence: a triangle without area or a
texture coordinate of 1e9 shows only as a NaN pixel, which then poisons the optimiser.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from isas_cli.errors import InputError

# A triangle is degenerate when its area is below this fraction of the squared diagonal of the
# bounding box: the rounding of float32 positions alone gives areas of this order.
SMALLEST_AREA = 1e-12
# Repeats of a texture beyond this count are taken for damage, not for tiling.
LARGEST_TEXCOORD = 1000.0


@dataclass(frozen=True)
class Surface:
    """An indexed triangle mesh.

    vertices: (V, 3) float32, positions
    faces: (F, 3) uint32, indices into the vertices, counter-clockwise seen from outside
    texcoords: (V, 2) float32; row i of an n-row texture covers v in [i/n, (i+1)/n]
    normals: (V, 3) float32, unit length
    """

    vertices: np.ndarray
    faces: np.ndarray
    texcoords: np.ndarray
    normals: np.ndarray


def read_obj(path: Path) -> Surface:
    """Read and check an OBJ file with texture coordinates, as a single mesh.

    Material statements are ignored: the whole file becomes one surface, which is right for a
    file with one texture atlas. Normals are made smooth here, whatever the file says: some files
    have none, and Mitsuba's own sum over faces runs in parallel, so that its last bits, and with
    them the hash that cached targets are found by, change from run to run. Raises InputError for
    a missing or broken mesh.
    """
    import mitsuba as mi

    if not path.is_file():
        raise InputError(f"mesh {path} does not exist")
    try:
        mesh = mi.load_dict({"type": "obj", "filename": str(path), "face_normals": True})
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"mesh {path.name} cannot be read: {reason}") from error
    if not mesh.has_vertex_texcoords():
        raise InputError(f"mesh {path.name} has no texture coordinates")
    values = mi.traverse(mesh)
    vertices = np.array(values["vertex_positions"]).reshape(-1, 3)
    texcoords = np.array(values["vertex_texcoords"]).reshape(-1, 2)
    faces = np.array(values["faces"]).reshape(-1, 3)
    check(vertices, texcoords, faces, path.name)
    positions, place_of_vertex = np.unique(vertices, axis=0, return_inverse=True)
    normals = corner_normals(positions, place_of_vertex.ravel()[faces])
    return from_corners(vertices[faces], texcoords[faces], normals)


def from_corners(positions: np.ndarray, texcoords: np.ndarray, normals: np.ndarray) -> Surface:
    """A mesh whose triangles share no vertex, from values (F, 3, n) at their corners."""
    return Surface(
        vertices=positions.reshape(-1, 3).astype(np.float32),
        faces=np.arange(3 * len(positions), dtype=np.uint32).reshape(-1, 3),
        texcoords=texcoords.reshape(-1, 2).astype(np.float32),
        normals=normals.reshape(-1, 3).astype(np.float32),
    )


def check(vertices: np.ndarray, texcoords: np.ndarray, faces: np.ndarray, name: str) -> None:
    """Raise InputError, naming the first offender, when a mesh would render as NaN."""
    if not faces.size:
        raise InputError(f"mesh {name} has no triangles")
    for what, values in (("position", vertices), ("texture coordinate", texcoords)):
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            raise InputError(f"mesh {name}: the {what} of vertex {bad[0]} is not finite")
    absurd = np.flatnonzero((np.abs(texcoords) > LARGEST_TEXCOORD).any(axis=1))
    if absurd.size:
        raise InputError(
            f"mesh {name}: the texture coordinate of vertex {absurd[0]} is "
            f"{texcoords[absurd[0]].tolist()}, beyond ±{LARGEST_TEXCOORD:g}"
        )
    diagonal = np.ptp(vertices, axis=0).astype(np.float64)
    areas = np.linalg.norm(_face_vectors(vertices, faces), axis=1) / 2
    degenerate = np.flatnonzero(areas <= SMALLEST_AREA * (diagonal @ diagonal))
    if degenerate.size:
        raise InputError(
            f"mesh {name}: triangle {degenerate[0]} has no area "
            f"({degenerate.size} of {len(areas)} are degenerate)"
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
    angle = np.radians(turn)
    cos, sin = np.cos(angle), np.sin(angle)
    rotation = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    vertices = surface.vertices.astype(np.float64) @ rotation.T
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    foot = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
    vertices = (vertices - foot) * (height / (high[1] - low[1])) + [at[0], 0, at[1]]
    normals = surface.normals.astype(np.float64) @ rotation.T
    return replace(
        surface, vertices=vertices.astype(np.float32), normals=normals.astype(np.float32)
    )


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


def shape(name: str, surface: Surface, bsdf: dict[str, Any]) -> Any:
    """A Mitsuba mesh with a material, for use as an entry of a scene dictionary."""
    import mitsuba as mi

    properties = mi.Properties()
    # optimize=False: otherwise Mitsuba may merge materials that are equal at the start.
    properties["bsdf"] = mi.load_dict(bsdf, optimize=False)
    mesh = mi.Mesh(
        name,
        vertex_count=len(surface.vertices),
        face_count=len(surface.faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    values = mi.traverse(mesh)
    values["vertex_positions"] = surface.vertices.ravel()
    values["faces"] = surface.faces.ravel()
    values["vertex_normals"] = surface.normals.ravel()
    values["vertex_texcoords"] = surface.texcoords.ravel()
    values.update()
    return mesh


def _face_vectors(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3) float64: normals of the faces, as long as twice their area."""
    a, b, c = (positions[faces[:, corner]].astype(np.float64) for corner in range(3))
    return np.cross(b - a, c - a)
