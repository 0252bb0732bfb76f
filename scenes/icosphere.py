"""A sphere of triangles of nearly equal size."""

from __future__ import annotations

import numpy as np


def icosphere(level: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices on the unit sphere, ``(10 4^level + 2, 3) float64``, and faces, ``(20 4^level, 3)``,
    counter-clockwise seen from outside: an icosahedron whose triangles are split into four."""
    golden = (1 + 5**0.5) / 2
    vertices = np.array(
        [(s, t * golden, 0) for t in (1, -1) for s in (-1, 1)]
        + [(0, s, t * golden) for t in (1, -1) for s in (-1, 1)]
        + [(t * golden, 0, s) for t in (1, -1) for s in (-1, 1)]
    )
    faces = _hull(vertices)
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    for _ in range(level):
        half = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        ends, which = np.unique(np.sort(half, axis=1), axis=0, return_inverse=True)
        middles = vertices[ends].mean(axis=1)
        middles /= np.linalg.norm(middles, axis=1, keepdims=True)
        ab, bc, ca = which.reshape(3, -1) + len(vertices)
        a, b, c = faces.T
        parts = (a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)
        faces = np.concatenate([np.stack(part, axis=1) for part in parts])
        vertices = np.concatenate([vertices, middles])
    return vertices, faces


def _hull(vertices: np.ndarray) -> np.ndarray:
    from scipy.spatial import ConvexHull

    faces = ConvexHull(vertices).simplices
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    faces[inward] = faces[inward][:, ::-1]
    return faces
