"""Global_illumination: lamp, wall colour and a box's angle, all from light that others throw.

The paper's task (PRDPT, global illumination): "simultaneously move the top-light to match the
scene's illumination, change the left wall's color to create the color bleeding onto the box, and
also to rotate the large box to an orientation where the wall's reflected light is actually visible.
The optimization only sees an inset of the scene and hence only ever sees the scattered light, but
never the wall's color or light itself."

Ours: the Cornell box of this project with a tall white box in it; the inset shows two sides of the
box. At the truth one looks to the left wall, away from the lamp, and shows its colour. Unknown are
the lamp's place in the ceiling (x, z), the wall's colour and the box's angle, six numbers. The box
is square: its angle is compared modulo 90°.

What differs: room, lamp and camera are ours. The wall's true colour lies in the middle of its
range: the mean of a blur that reaches beyond an end is another than the colour.

Depth 4: camera, box or floor, wall, second surface, light: the wall's colour arrives by two bounces
at least.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import meshes
from .cornell import cornell_box
from .stage import boxes, camera, matt, turned

WALL = [0.75, 0.3, 0.25]
MIDDLE = [-0.25, 0.55, -0.15]
TURNED = 50.0  # degrees, at the truth, against a side that faces the camera


def build(width: int) -> dict[str, Any]:
    """The scene at the truth; unknown: the poses `lamp.place` and `box.angle` and
    `left.bsdf.base_color.value`."""
    box = turned(boxes(np.array([MIDDLE]), (0.27, 0.55, 0.27)), -TURNED, MIDDLE)
    room = cornell_box(width)
    room["left"]["bsdf"]["base_color"]["value"] = WALL
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 4},
        **room,
        "box": meshes.shape("box", box, matt(0.75)),
        "sensor_000": camera([0.15, 0.9, 3.6], (-0.2, 0.45, -0.1), 13.5, width),
    }
