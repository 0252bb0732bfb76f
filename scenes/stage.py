"""What the scenes of moving objects share: films of 4:3, matt materials, meshes of few vertices."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from .cameras import perspective
from .meshes import Surface


def camera(
    origin: list[float], target: tuple[float, float, float], field_of_view: float, width: int
) -> dict[str, Any]:
    """A pinhole camera with a film of `width` × 3/4 `width` pixels; `field_of_view` across it."""
    sensor = perspective(origin, target, field_of_view, width)
    return {**sensor, "film": {**sensor["film"], "height": max(1, width * 3 // 4)}}


def matt(colour: list[float] | float) -> dict[str, Any]:
    """A principled material without gloss."""
    return {
        "type": "principled",
        "base_color": {"type": "rgb", "value": colour},
        "roughness": 1.0,
        "specular": 0.0,
    }


def ground(half_width: float, bsdf: dict[str, Any]) -> dict[str, Any]:
    """A horizontal square at y = 0, facing up."""
    import mitsuba as mi

    to = mi.ScalarTransform4f()
    return {
        "type": "rectangle",
        "to_world": to.rotate([1, 0, 0], -90).scale([half_width, half_width, 1]),
        "bsdf": bsdf,
    }


def shared(surface: Surface) -> Surface:
    """The same surface with vertices that are equal in all respects kept once.

    Derivatives of silhouettes go by edges between two triangles: with a vertex for every corner
    each edge would be a silhouette.
    """
    rows = np.concatenate([surface.vertices, surface.normals], axis=1)
    if len(surface.texcoords):
        rows = np.concatenate([rows, surface.texcoords], axis=1)
    _, first, place = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return replace(
        surface,
        vertices=surface.vertices[first],
        normals=surface.normals[first],
        texcoords=surface.texcoords[first] if len(surface.texcoords) else surface.texcoords,
        faces=place.ravel()[surface.faces].astype(np.uint32),
    )


def boxes(middles: np.ndarray, half: tuple[float, float, float]) -> Surface:
    """Boxes around `middles` (N, 3) of half-sides `half`, 24 vertices and 12 triangles each, box
    after box; faces are flat."""
    corners, normals, faces = [], [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            normal = sign * np.eye(3)[axis]
            first = len(corners)
            corners += [normal + s * u + t * v for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            normals += [normal] * 4
            turn = [0, 1, 2, 3] if sign > 0 else [3, 2, 1, 0]
            a, b, c, d = (first + i for i in turn)
            faces += [[a, b, c], [a, c, d]]
    count = len(middles)
    vertices = np.asarray(middles)[:, None] + np.asarray(corners) * np.asarray(half)
    return Surface(
        vertices=vertices.reshape(-1, 3).astype(np.float32),
        faces=(np.asarray(faces) + 24 * np.arange(count)[:, None, None])
        .reshape(-1, 3)
        .astype(np.uint32),
        texcoords=np.zeros((0, 2), np.float32),
        normals=np.tile(np.asarray(normals, np.float32), (count, 1)),
    )


def turned(surface: Surface, degrees: float, origin: list[float]) -> Surface:
    """The surface turned about the vertical axis through `origin`."""
    angle = np.deg2rad(degrees)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return replace(
        surface,
        vertices=((surface.vertices - origin) @ turn.T + origin).astype(np.float32),
        normals=(surface.normals @ turn.T).astype(np.float32),
    )
