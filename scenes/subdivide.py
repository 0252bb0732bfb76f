"""Loop subdivision: coarse closed meshes become smooth.

The free models are coarse. Under a glossy material their interpolated normals disagree with the
facets so much that edges seen at a grazing angle render black; refining the surface mends that,
and rounds the outline.

Reference: Charles Loop, "Smooth Subdivision Surfaces Based on Triangles", 1987.
"""

from __future__ import annotations

import numpy as np

from ..runtime.errors import InputError
from .meshes import Surface, corner_normals, from_corners


def subdivide(surface: Surface, levels: int, name: str) -> Surface:
    """Split each triangle into four and smooth, `levels` times; then set smooth normals.

    Positions are smoothed across the borders of texture charts; texture coordinates are halved
    linearly within each triangle. No vertex of the result is shared: V = 3 F. Raises InputError
    when the mesh is not closed, since borders would need rules of their own.
    """
    positions, inverse = np.unique(surface.vertices.astype(np.float64), axis=0, return_inverse=True)
    faces = inverse.ravel()[surface.faces]
    texcoords = surface.texcoords[surface.faces]
    for _ in range(levels):
        positions, faces = _refine(positions, faces, name)
        texcoords = _split(texcoords, (texcoords + np.roll(texcoords, -1, axis=1)) / 2)
    return from_corners(positions[faces], texcoords, corner_normals(positions, faces))


def _split(corners: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """(4 F, 3, ...) values at the corners of the four parts of each triangle.

    `corners` (F, 3, ...) and `middles` (F, 3, ...), where middle i lies on the edge from corner
    i to corner i + 1.
    """
    a, b, c = (corners[:, i] for i in range(3))
    ab, bc, ca = (middles[:, i] for i in range(3))
    parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def _refine(positions: np.ndarray, faces: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """One level: positions (V, 3) float64 and faces (F, 3) to the same of the finer mesh."""
    starts, ends = faces, np.roll(faces, -1, axis=1)
    opposite = np.roll(faces, -2, axis=1)
    both = np.sort(np.stack([starts.ravel(), ends.ravel()], axis=1), axis=1)
    edges, edge_of_side, sides = np.unique(both, axis=0, return_inverse=True, return_counts=True)
    edge_of_side = edge_of_side.ravel()
    if (sides != 2).any():
        raise InputError(f"mesh {name} is not closed: only closed meshes can be subdivided")

    across = np.zeros((len(edges), 3))
    np.add.at(across, edge_of_side, positions[opposite.ravel()])
    on_edges = 3 / 8 * positions[edges].sum(axis=1) + across / 8

    valence = np.bincount(edges.ravel(), minlength=len(positions))[:, None]
    neighbours = np.zeros_like(positions)
    np.add.at(neighbours, edges[:, 0], positions[edges[:, 1]])
    np.add.at(neighbours, edges[:, 1], positions[edges[:, 0]])
    weight = (5 / 8 - (3 / 8 + np.cos(2 * np.pi / valence) / 4) ** 2) / valence
    moved = (1 - valence * weight) * positions + weight * neighbours

    middles = len(positions) + edge_of_side.reshape(faces.shape)
    return np.concatenate([moved, on_edges]), _split(faces, middles)
