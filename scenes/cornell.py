"""A Cornell box of our own: a room, a lamp in its ceiling, and a camera at its far end.

Two units wide and high; the floor is at y = 0, the middle of the back wall at (0, 1, -1). Unlike
the well-known box this one is not open in front: the room goes on behind the camera, so that
glossy objects have something to show on the side that the camera sees. The lamp is above the image,
not in it.
"""

from __future__ import annotations

from typing import Any

from .cameras import perspective
from .stage import matt

WHITE, RED, GREEN = [0.73, 0.71, 0.68], [0.57, 0.05, 0.05], [0.12, 0.42, 0.10]
LAMP_COLOUR = [1.0, 0.85, 0.6]
RADIANCE, LAMP = 14.0, 0.35  # LAMP: half its side
FRONT = 4.0  # z of the wall behind the camera
CAMERA, LOOK_AT, FIELD_OF_VIEW = [0.0, 0.95, 3.8], (0.0, 0.72, 0.0), 30.5


def cornell_box(resolution: int) -> dict[str, Any]:
    """Walls, lamp and one sensor, as entries of a scene dictionary."""
    import mitsuba as mi

    to = mi.ScalarTransform4f
    middle, half = (FRONT - 1) / 2, (FRONT + 1) / 2
    floor = to().translate([0, 0, middle]).rotate([1, 0, 0], -90).scale([1, half, 1])
    ceiling = to().translate([0, 2, middle]).rotate([1, 0, 0], 90).scale([1, half, 1])
    left = to().translate([-1, 1, middle]).rotate([0, 1, 0], 90).scale([half, 1, 1])
    right = to().translate([1, 1, middle]).rotate([0, 1, 0], -90).scale([half, 1, 1])
    return {
        "floor": _wall(floor, WHITE),
        "ceiling": _wall(ceiling, WHITE),
        "back": _wall(to().translate([0, 1, -1]), WHITE),
        "front": _wall(to().translate([0, 1, FRONT]).rotate([0, 1, 0], 180), WHITE),
        "left": _wall(left, RED),
        "right": _wall(right, GREEN),
        "lamp": {
            "type": "rectangle",
            "to_world": to().translate([0, 1.995, 0]).rotate([1, 0, 0], 90).scale([LAMP, LAMP, 1]),
            "bsdf": matt([0.0, 0.0, 0.0]),
            "emitter": {
                "type": "area",
                "radiance": {"type": "rgb", "value": [RADIANCE * c for c in LAMP_COLOUR]},
            },
        },
        "sensor_000": perspective(CAMERA, LOOK_AT, FIELD_OF_VIEW, resolution),
    }


def _wall(to_world, colour: list[float]) -> dict[str, Any]:
    return {"type": "rectangle", "to_world": to_world, "bsdf": matt(colour)}
