"""The matt stone block that the single objects stand on."""

from __future__ import annotations

from typing import Any


def plinth(half_width: float, at: tuple[float, float] = (0.0, 0.0)) -> dict[str, Any]:
    """A square block with its upper face at y = 0, two units high, centred on (x, z) `at`."""
    import mitsuba as mi

    to_world = mi.ScalarTransform4f().translate([at[0], -1, at[1]])
    return {
        "type": "cube",
        "to_world": to_world.scale([half_width, 1, half_width]),
        "bsdf": {
            "type": "principled",
            "base_color": {"type": "rgb", "value": [0.30, 0.28, 0.25]},
            "roughness": 0.6,
        },
    }
