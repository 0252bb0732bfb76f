"""Lego: a coloured toy figure as a cloud that glows; density and emission are unknown.

The image-space sampling paper's scene of this name (§5.2): 32 views of 262 K pixels, per-voxel
density and emitted colour, no scattering. Its model is not published; ours is made of coloured
boxes and a cylinder, each point of the grid holding how much of its surroundings they fill.
A medium that emits and absorbs (`emission`) before a grey sky.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .cameras import spiral
from .smoke import medium

DENSEST = 40.0  # per scene unit; the box is two wide
# Lowest and highest corner, and colour: legs, hips, body, arms, hands, head.
BOXES = (
    ((-0.42, -0.95, -0.22), (-0.03, -0.35, 0.22), (0.05, 0.15, 0.6)),
    ((0.03, -0.95, -0.22), (0.42, -0.35, 0.22), (0.05, 0.15, 0.6)),
    ((-0.42, -0.35, -0.22), (0.42, -0.2, 0.22), (0.3, 0.3, 0.3)),
    ((-0.4, -0.2, -0.25), (0.4, 0.4, 0.25), (0.7, 0.08, 0.05)),
    ((-0.65, -0.1, -0.15), (-0.42, 0.38, 0.15), (0.7, 0.3, 0.05)),
    ((0.42, -0.1, -0.15), (0.65, 0.38, 0.15), (0.7, 0.3, 0.05)),
    ((-0.62, -0.25, -0.1), (-0.45, -0.1, 0.15), (0.8, 0.6, 0.1)),
    ((0.45, -0.25, -0.1), (0.62, -0.1, 0.15), (0.8, 0.6, 0.1)),
    ((-0.08, 0.86, -0.08), (0.08, 0.96, 0.08), (0.8, 0.6, 0.1)),
)
HEAD = (0.44, 0.86, 0.28), (0.8, 0.6, 0.1)  # lowest, highest, radius; colour
EYES = ((-0.12, 0.7), (0.12, 0.7)), 0.05
_FINER = 4  # points along each side of a cell


def build(views: int, resolution: int, grid: int) -> dict[str, Any]:
    """Unknown: `box.interior_medium.sigma_t.data`, grid³ x 1, and what the medium emits,
    `box.interior_medium.albedo.data`, grid³ x 3."""
    density, colour = voxels(grid)
    return {
        "type": "scene",
        "integrator": {"type": "emission"},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.3}},
        "box": {
            "type": "cube",
            "bsdf": {"type": "null"},
            "interior": medium(np.maximum(DENSEST * density, 1e-3), colour),
        },
        **spiral(views, resolution, (0.0, 0.0, 0.0), 5.0, 40.0, (-30.0, 60.0)),
    }


def voxels(side: int) -> tuple[np.ndarray, np.ndarray]:
    """How much of each cell the figure fills, ``(side, side, side)``, and the colour of that,
    ``(…, 3)``; grey where there is nothing."""
    fine = side * _FINER
    axis = (np.arange(fine) + 0.5) / fine * 2 - 1
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij", sparse=True)
    filled = np.zeros((fine,) * 3, np.float32)
    painted = np.zeros((fine,) * 3 + (3,), np.float32)
    low, high, radius = HEAD[0]
    round_ = (x**2 + z**2 < radius**2) & (y > low) & (y < high)
    filled[round_], painted[round_] = 1, HEAD[1]
    for middle_x, middle_y in EYES[0]:
        near = ((x - middle_x) ** 2 + (y - middle_y) ** 2 < EYES[1] ** 2) & (z > 0) & round_
        painted[near] = 0.02
    for low, high, colour in BOXES:
        x0, y0, z0 = low
        x1, y1, z1 = high
        inside = (x > x0) & (x < x1) & (y > y0) & (y < y1) & (z > z0) & (z < z1)
        filled[inside], painted[inside] = 1, colour

    def coarse(values: np.ndarray) -> np.ndarray:
        parts = values.reshape(side, _FINER, side, _FINER, side, _FINER, -1)
        return parts.mean(axis=(1, 3, 5))

    share = coarse(filled)
    colour = coarse(painted) / np.maximum(share, 1e-6)
    return share[..., 0], np.where(share > 0, colour, 0.3)
