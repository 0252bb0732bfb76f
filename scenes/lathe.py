"""Surfaces of revolution with a texture atlas of one chart."""

from __future__ import annotations

import numpy as np

from .meshes import Surface, corner_normals, from_corners


def turn(profile: np.ndarray, segments: int = 128) -> Surface:
    """The surface that `profile` (P, 2), points of (radius, height), sweeps about the y axis.

    The outside lies to the right of the profile's direction: an outer wall runs from bottom to
    top. Texture coordinates: u the angle from the +z axis, v the share of the profile's length;
    the seam is at u = 0.
    """
    lengths = np.linalg.norm(np.diff(profile, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)]) / lengths.sum()
    around = np.linspace(0.0, 1.0, segments + 1)
    # The last column is the first, to the last bit: sin 2π is not 0, and would tear the surface.
    angle = 2 * np.pi * np.where(around < 1, around, 0)
    height = np.broadcast_to(profile[:, None, 1], (len(profile), segments + 1))
    radius = profile[:, None, 0]
    points = np.stack([radius * np.sin(angle), height, radius * np.cos(angle)], axis=-1)
    texcoords = np.stack(np.broadcast_arrays(around[None, :], along[:, None]), axis=-1)

    a, b = np.indices((len(profile) - 1, segments)).reshape(2, -1)
    corners = [(a, b), (a, b + 1), (a + 1, b + 1), (a + 1, b)]

    def triangles(grid: np.ndarray) -> np.ndarray:
        """(2 n, 3, k): each quad of the grid as two triangles."""
        p = [grid[corner] for corner in corners]
        return np.concatenate([np.stack(p[:3], axis=1), np.stack([p[0], p[2], p[3]], axis=1)])

    points, texcoords = triangles(points), triangles(texcoords)
    # On the axis a quad has only three corners, and one of its triangles no area.
    edges = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    kept = np.linalg.norm(edges, axis=1) > 1e-10
    points, texcoords = points[kept], texcoords[kept]
    # Rounded, so that the two sides of the seam share their normals.
    shared, place = np.unique(points.reshape(-1, 3).round(6), axis=0, return_inverse=True)
    normals = corner_normals(shared, place.reshape(-1, 3))
    return from_corners(points, texcoords, normals)
