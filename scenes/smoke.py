"""Smoke: a coloured plume under a sky; density and albedo are unknown at every point of a grid.

The image-space sampling paper's scene of this name (§5): 16 views, 4 M pixels, "per-voxel density
and colour". Its plume is not published; ours is simulated (`plume.py`), and the colour is a formula
of the height. Nothing but the smoke is in the picture, so that every path is in the medium until it
leaves for the sky, which is made by formula as well and has no sun.

Paths of up to 32 edges: where the smoke is densest light scatters several times.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import figures, plume
from .cameras import spiral

DENSEST = 12.0  # per scene unit; the box is two wide
BELOW, ABOVE = np.array([0.95, 0.7, 0.4]), np.array([0.5, 0.7, 0.95])


def build(views: int, resolution: int, grid: int) -> dict[str, Any]:
    """Unknown: `box.interior_medium.sigma_t.data`, grid³ x 1, and
    `box.interior_medium.albedo.data`, grid³ x 3."""
    density = np.maximum(DENSEST * plume.density(grid), 1e-3)
    height = np.linspace(0, 1, grid)[:, None]
    albedo = np.broadcast_to((BELOW + (ABOVE - BELOW) * height)[None, :, None], (grid,) * 3 + (3,))
    return {
        "type": "scene",
        "integrator": {"type": "prbvolpath", "max_depth": 32, "rr_depth": 8},
        "sky": figures.sky(16),
        "box": {"type": "cube", "bsdf": {"type": "null"}, "interior": medium(density, albedo)},
        **spiral(views, resolution, (0.0, 0.0, 0.0), 5.0, 40.0, (-20.0, 40.0)),
    }


def medium(density: np.ndarray, albedo: np.ndarray) -> dict[str, Any]:
    """Between -1 and 1 along all axes: ``density (n, n, n)``, ``albedo (n, n, n, 3)``."""
    import mitsuba as mi

    place = mi.ScalarTransform4f().translate([-1, -1, -1]).scale(2)

    def grid(values: np.ndarray) -> dict[str, Any]:
        held = mi.VolumeGrid(np.ascontiguousarray(values, np.float32))
        return {"type": "gridvolume", "grid": held, "to_world": place, "raw": True}

    return {
        "type": "heterogeneous",
        "sigma_t": grid(density[..., None]),
        "albedo": grid(albedo),
    }
