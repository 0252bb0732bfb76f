"""Object, joint, shape included: a painted glossy figure of which nothing is known but the cameras.

After *Physics Based Differentiable Rendering for Inverse Problems and Beyond* (Kakkar et al.;
PBDR), whose unknowns are vertices, diffuse and specular albedo, roughness and light. Its scenes are
not published. Ours: three ellipsoids that grow out of each other, in the paper's own reflectance
(its Eq. 5), under a coarse coloured sky. The shape starts as a sphere, the paint as grey, the sky
as white; texture coordinates belong to directions, and so to any shape that the sphere becomes.

The sky is in the pictures, which fixes how bright it is, but for what no view shows of it. Where
the surface slides in itself the paint slides along, and no picture tells: the paint's error by
texel does not fall to 0. The sky moves first, then the shape, then the rest as well (`during`): at
`size=tiny`, from four small views, all at once the mesh grows into the background and is painted
like it; from sixteen views it ends as well without stages (benchmarks/pbdr.md).

Direct light alone (depth 2), as in `kirby`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import bowl, figures, library, meshes
from .cameras import spiral
from .icosphere import icosphere

PARTS = (
    ((0.0, 0.0, 0.0), (0.7, 0.6, 0.7)),
    ((0.0, 0.6, 0.0), (0.28, 0.35, 0.28)),
    ((0.7, 0.1, 0.0), (0.3, 0.2, 0.2)),
)
SPECULAR, ROUGHNESS = 0.25, 0.3
SKY = 8  # rows of the map


def build(views: int, resolution: int, texture: int, level: int) -> dict[str, Any]:
    """Unknown: `figure.vertices`, 10 4^`level` + 2 of them; `figure.bsdf.diffuse.data`,
    (texture²) x 3; `figure.bsdf.specular.value` and `figure.bsdf.roughness.value`, numbers; and
    `sky.data`, 8 x 16 x 3."""
    directions, faces = icosphere(level)
    vertices = figures.pulled(PARTS, directions)
    surface = meshes.from_corners(
        vertices[faces], _around(directions[faces]), meshes.corner_normals(vertices, faces)
    )
    material = {
        "type": "phong",
        "diffuse": library.texture(bowl.paint(texture)) | {"wrap_mode": "repeat"},
        "specular": SPECULAR,
        "roughness": ROUGHNESS,
    }
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sky": figures.sky(SKY),
        "figure": meshes.shape("figure", surface, material),
        **spiral(views, resolution, (0.1, 0.1, 0.0), 4.0, 32.0, (-35.0, 60.0)),
    }


def _around(directions: np.ndarray) -> np.ndarray:
    """Texture coordinates, ``(F, 3, 2)``, by longitude and latitude of the corners' directions
    ``(F, 3, 3)``; a triangle across the date line goes on beyond 1, where the texture repeats."""
    x, y, z = np.moveaxis(directions, -1, 0)
    u, v = np.arctan2(x, z) / (2 * np.pi) + 0.5, np.arccos(np.clip(y, -1, 1)) / np.pi
    # A pole has no longitude: that of the triangle's other corners.
    pole = np.hypot(x, z) < 1e-6
    others = np.where(pole, np.nan, u)
    across = np.nanmax(others, axis=1, keepdims=True) - others > 0.5
    others = others + across
    u = np.where(pole, np.nanmean(others, axis=1, keepdims=True), others)
    return np.stack([u, v], axis=-1)
