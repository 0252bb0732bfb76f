"""Shadowplay: a black figure seen from one side; the shadows of two lamps tell the rest of it.

Where the figure's vertices are is unknown, and they start as a sphere. No paper has this scene. It
asks for what the paper's scenes do not need: derivatives of shadows' edges. The figure is nearly
black, so that shading tells nothing, and four cameras look from about the same side, so that
outlines tell its height and width but little of its depth; a lamp from the left throws its profile
on a wall, and one from above throws its plan on the floor.

Direct light alone (depth 2), which is what the edges of shadows are in.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import figures
from .cameras import orbit, perspective

PARTS = (
    ((0.0, 0.0, 0.0), (0.55, 0.6, 0.55)),
    ((0.0, 0.15, 0.6), (0.2, 0.2, 0.45)),
    ((0.0, -0.3, -0.6), (0.3, 0.16, 0.4)),
    ((0.5, 0.35, 0.0), (0.3, 0.15, 0.15)),
    ((0.0, 0.7, -0.15), (0.18, 0.3, 0.25)),
)
FLOOR, WALL = -1.1, 2.2


def build(views: int, resolution: int, level: int) -> dict[str, Any]:
    """The scene with the true shape; unknown: `figure.vertices`, 10 4^`level` + 2 of them."""
    import mitsuba as mi

    place = mi.ScalarTransform4f()
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.8, 0.8]}}
    aim = (0.7, -0.3, 0.0)
    sensors = {
        f"sensor_{view:03d}": perspective(
            orbit(aim, 8.0, azimuth, 18.0 + 14.0 * (view % 2)), aim, 34.0, resolution
        )
        for view, azimuth in enumerate(np.linspace(-48.0, -30.0, views))
    }
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.1}},
        "lamp_left": _lamp([-5.0, 0.6, 0.3], 80.0),
        "lamp_above": _lamp([-0.3, 5.0, 0.2], 70.0),
        "figure": figures.figure("figure", PARTS, level, [0.02, 0.02, 0.02]),
        "floor": {
            "type": "rectangle",
            "to_world": place.translate([0, FLOOR, 0]).rotate([1, 0, 0], -90).scale(5),
            "bsdf": white,
        },
        "wall": {
            "type": "rectangle",
            "to_world": place.translate([WALL, 0, 0]).rotate([0, 1, 0], -90).scale(5),
            "bsdf": white,
        },
        **sensors,
    }


def _lamp(centre: list[float], radiance: float) -> dict[str, Any]:
    return {
        "type": "sphere",
        "center": centre,
        "radius": 0.2,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}},
    }
