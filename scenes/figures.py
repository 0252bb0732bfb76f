"""Figures by formula, each a sphere pulled outwards, and a sky to see them by.

A figure is a smooth union of ellipsoids, of which each vertex of a sphere takes the outermost point
in its direction: so a sphere can become it without folds, and its size is free.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import meshes
from .icosphere import icosphere

BLEND = 12.0  # of the smooth minimum, per scene unit
# Where the sky is brightest, in red, green and blue.
LOBES = np.array([[0.6, 0.8, 0.0], [0.0, 0.6, 0.8], [-0.8, 0.3, 0.52]])
# Middle and half axes of an ellipsoid.
Part = tuple[tuple[float, float, float], tuple[float, float, float]]


def figure(id: str, parts: tuple[Part, ...], level: int, colour: list[float]) -> dict[str, Any]:
    """The union of `parts`, matt, with 10 4^`level` + 2 vertices."""
    directions, faces = icosphere(level)
    vertices = pulled(parts, directions)
    normals = np.zeros((len(vertices), 3), np.float32)
    normals[faces] = meshes.corner_normals(vertices, faces)
    surface = meshes.Surface(
        vertices.astype(np.float32), faces.astype(np.uint32), np.zeros((0, 2), np.float32), normals
    )
    matt = {"type": "diffuse", "reflectance": {"type": "rgb", "value": colour}}
    return meshes.shape(id, surface, matt)


def pulled(parts: tuple[Part, ...], directions: np.ndarray) -> np.ndarray:
    """The outermost points of the union of `parts` in unit `directions`, both ``(V, 3)``."""
    return directions * _outermost(parts, directions)[:, None]


def sky(height: int) -> dict[str, Any]:
    """An environment map of `height` rows: three broad coloured lobes on grey, so that light
    differs by direction."""
    import mitsuba as mi

    theta = (np.arange(height) + 0.5) / height * np.pi
    phi = (np.arange(2 * height) + 0.5) / height * np.pi
    theta, phi = np.meshgrid(theta, phi, indexing="ij")
    sin = np.sin(theta)
    directions = np.stack([sin * np.cos(phi), np.cos(theta), sin * np.sin(phi)], axis=-1)
    light = np.stack([0.3 + 1.5 * np.exp(4 * (directions @ lobe - 1)) for lobe in LOBES], axis=-1)
    return {"type": "envmap", "bitmap": mi.Bitmap(light.astype(np.float32))}


def _distance(parts: tuple[Part, ...], points: np.ndarray) -> np.ndarray:
    """Below 0 inside of the figure: a smooth minimum over the parts, ``(N,)`` of ``(N, 3)``."""
    each = [
        (np.linalg.norm((points - middle) / axes, axis=-1) - 1) * min(axes)
        for middle, axes in parts
    ]
    return -np.log(np.exp(-BLEND * np.stack(each)).sum(axis=0)) / BLEND


def _outermost(parts: tuple[Part, ...], directions: np.ndarray) -> np.ndarray:
    """How far from the middle the figure ends in each direction, ``(N,)``."""
    lengths = np.linspace(2.0, 0.1, 400)
    inside = np.stack([_distance(parts, directions * length) <= 0 for length in lengths])
    first = inside.argmax(axis=0)
    far, near = lengths[np.maximum(first - 1, 0)], lengths[first]
    for _ in range(30):
        middle = (far + near) / 2
        within = _distance(parts, directions * middle[:, None]) <= 0
        near, far = np.where(within, middle, near), np.where(within, far, middle)
    return (near + far) / 2
