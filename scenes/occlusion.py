"""Occlusion: a red ball behind a blue one is moved along the view until it stands in front.

The paper's task (PRDPT, occlusion): "a sphere translates along the viewing axis to match the
reference. The challenge is that the sphere initially is occluded by another sphere", in a box with
a bottom of glass, in which a reflection is seen.

Ours: the same in a white room with a polished floor: reflection and shadow of the hidden ball are
seen a little. The unknown is its z.

What differs: room, places and camera are ours. The paper's floor is glass of IOR 1.504; ours is a
principled surface that reflects like it, as nothing lies below.

Depth 4: camera, floor, ball or wall, wall, light.
"""

from __future__ import annotations

from typing import Any

from .stage import camera, ground, matt

TRUTH = 1.3  # z of the red ball
AT_HEIGHT = 0.75


def build(width: int) -> dict[str, Any]:
    """The scene with the red ball in front; unknown: the pose `red.depth`, its z."""
    import mitsuba as mi

    to = mi.ScalarTransform4f
    polished = {
        "type": "principled",
        "base_color": {"type": "rgb", "value": 0.35},
        "roughness": 0.08,
        "specular": 0.5,
    }
    back = to().translate([0, 1.5, -3.5]).scale([3, 1.5, 1])
    left = to().translate([-3, 1.5, 0]).rotate([0, 1, 0], 90).scale([3.5, 1.5, 1])
    right = to().translate([3, 1.5, 0]).rotate([0, 1, 0], -90).scale([3.5, 1.5, 1])
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 4},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.25}},
        "lamp": {
            "type": "rectangle",
            "to_world": to().translate([0, 4, 0.5]).rotate([1, 0, 0], 90),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 9.0}},
        },
        "floor": ground(3.5, polished),
        "back": {"type": "rectangle", "to_world": back, "bsdf": matt(0.7)},
        "left": {"type": "rectangle", "to_world": left, "bsdf": matt(0.7)},
        "right": {"type": "rectangle", "to_world": right, "bsdf": matt(0.7)},
        "red": _ball(TRUTH, 0.4, [0.62, 0.07, 0.06]),
        "blue": _ball(0.0, 0.55, [0.07, 0.13, 0.60]),
        "sensor_000": camera([0.0, 0.95, 4.6], (0.0, 0.70, 0.0), 42.0, width),
    }


def _ball(z: float, radius: float, colour: list[float]) -> dict[str, Any]:
    return {"type": "sphere", "center": [0, AT_HEIGHT, z], "radius": radius, "bsdf": matt(colour)}
