"""Caustic: a lamp outside the view is found from the light that a glass ball focuses.

The paper's task (PRDPT, caustic): "a light source outside the view frustum illuminating a glass
sphere, which casts a caustic onto the ground. The goal is to optimize the light's position in order
to match a reference caustic."

Ours: a ball of clear glass (IOR 1.504) over a matt ground and a ball of light above, whose x and z
are unknown; the camera sees ground and glass.

What differs: places and sizes are ours, and our lamp is wide: a path from the camera finds a
caustic only if it happens to hit the lamp after the glass.

Depth 5: camera, ground, glass, glass, lamp, and one surface more. The glass is a `dielectric`: a
principled lobe has no smooth limit.
"""

from __future__ import annotations

from typing import Any

from .cameras import orbit
from .stage import camera, ground, matt

LAMP, LAMP_RADIUS, RADIANCE = [-1.5, 12.0, -1.5], 3.0, 14.0


def build(width: int) -> dict[str, Any]:
    """The scene with the lamp at its true place; unknown: the pose `lamp.place`, x and z."""
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 5},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.05}},
        "ground": ground(4.0, matt(0.6)),
        "ball": {
            "type": "sphere",
            "center": [0.0, 1.0, 0.0],
            "radius": 0.6,
            "bsdf": {"type": "dielectric", "int_ior": 1.504},
        },
        "lamp": {
            "type": "sphere",
            "center": LAMP,
            "radius": LAMP_RADIUS,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": RADIANCE}},
        },
        "sensor_000": camera(
            orbit((0.0, 0.35, 0.2), 4.2, 0.0, 48.0), (0.0, 0.35, 0.2), 38.0, width
        ),
    }
