"""Kirby: a round figure with limbs; where its vertices are is unknown, and they start as a sphere.

The image-space sampling paper's scene of this name (§5.2, Fig. 9): "16 images", 262 K pixels each,
under an environment map, from a sphere of 30 K vertices. Its model is not published, so the figure
here is made by formula: five ellipsoids (body, feet, arms) blended smoothly, of which each vertex
of a sphere takes the outermost point in its direction. Matt and of one colour, so that nothing but
shading and outline tell the shape. Views lie on a spiral over several elevations: a ring of cameras
at one would leave top and bottom undetermined.

The sky is made by formula as well: three broad coloured lobes on grey, so that light differs by
direction. The photographed skies of the other scenes have suns, which would stand behind the figure
in some view and hold nearly all of L2's residual: only the silhouettes before them would move.

Direct light alone (depth 2): the figure is nearly convex, and its grooves are bright.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import meshes
from .cameras import spiral
from .icosphere import icosphere

# Middle and half axes.
PARTS = (
    ((0.0, 0.0, 0.0), (0.8, 0.8, 0.8)),
    ((0.35, -0.72, 0.25), (0.32, 0.22, 0.45)),
    ((-0.35, -0.72, 0.25), (0.32, 0.22, 0.45)),
    ((0.82, 0.12, 0.0), (0.28, 0.22, 0.22)),
    ((-0.82, 0.12, 0.0), (0.28, 0.22, 0.22)),
)
BLEND = 12.0  # of the smooth minimum, per scene unit
COLOUR = [0.8, 0.55, 0.5]
# Where the sky is brightest, in red, green and blue.
LOBES = np.array([[0.6, 0.8, 0.0], [0.0, 0.6, 0.8], [-0.8, 0.3, 0.52]])


def build(views: int, resolution: int, level: int) -> dict[str, Any]:
    """The scene with the true shape; unknown: `figure.vertices`, 10 4^`level` + 2 of them."""
    directions, faces = icosphere(level)
    vertices = directions * _outermost(directions)[:, None]
    normals = meshes.corner_normals(vertices, faces)
    figure = meshes.Surface(
        vertices.astype(np.float32),
        faces.astype(np.uint32),
        np.zeros((0, 2), np.float32),
        _shared(normals, faces, len(vertices)),
    )
    matt = {"type": "diffuse", "reflectance": {"type": "rgb", "value": COLOUR}}
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sky": _sky(16),
        "figure": meshes.shape("figure", figure, matt),
        **spiral(views, resolution, (0.0, -0.05, 0.0), 4.0, 35.0, (-35.0, 65.0), azimuth=15.0),
    }


def _sky(height: int) -> dict[str, Any]:
    """An environment map of `height` rows."""
    import mitsuba as mi

    theta = (np.arange(height) + 0.5) / height * np.pi
    phi = (np.arange(2 * height) + 0.5) / height * np.pi
    theta, phi = np.meshgrid(theta, phi, indexing="ij")
    sin = np.sin(theta)
    directions = np.stack([sin * np.cos(phi), np.cos(theta), sin * np.sin(phi)], axis=-1)
    light = np.stack([0.3 + 1.5 * np.exp(4 * (directions @ lobe - 1)) for lobe in LOBES], axis=-1)
    return {"type": "envmap", "bitmap": mi.Bitmap(light.astype(np.float32))}


def _shared(corners: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    """Normals of vertices, ``(count, 3)``, from those of corners, ``(F, 3, 3)``."""
    normals = np.zeros((count, 3), np.float32)
    normals[faces] = corners
    return normals


def _distance(points: np.ndarray) -> np.ndarray:
    """Below 0 inside of the figure: a smooth minimum over the parts, ``(N,)`` of ``(N, 3)``."""
    each = [
        (np.linalg.norm((points - middle) / axes, axis=-1) - 1) * min(axes)
        for middle, axes in PARTS
    ]
    return -np.log(np.exp(-BLEND * np.stack(each)).sum(axis=0)) / BLEND


def _outermost(directions: np.ndarray) -> np.ndarray:
    """How far from the middle the figure ends in each direction, ``(N,)``."""
    lengths = np.linspace(2.0, 0.1, 400)
    inside = np.stack([_distance(directions * length) <= 0 for length in lengths])
    first = inside.argmax(axis=0)
    far, near = lengths[np.maximum(first - 1, 0)], lengths[first]
    for _ in range(30):
        middle = (far + near) / 2
        within = _distance(directions * middle[:, None]) <= 0
        near, far = np.where(within, middle, near), np.where(within, far, middle)
    return (near + far) / 2
