"""Shadows: a ball outside the view is found from its shadow.

The paper's task (PRDPT, shadows): "An object outside of the view frustum is casting a shadow onto a
plane. Our goal is to optimize the hidden object's position", two coordinates, from (-0.5, 2.5) to
(-1.5, 1.0); a point light, a constant sky, a textured plane.

Ours: a ball of radius 0.25 between a point light and a ground with a photographed texture; its
position across the view and its height are unknown. The shadows of start and truth do not overlap.

What differs: texture, places and camera are ours. Our lamp stands beside the plane in which the
ball moves: were it in it, both unknowns would move the shadow along one line, and of height and
distance together only the shadow's size would tell.

Mitsuba's projective integrators do not differentiate the edge of a point light's shadow (no traced
ray meets the light), only what the ball hides of the sky and throws back: a handicap of that
baseline here, which an area light would not have.

Depth 2: direct light alone. Light that the ball throws back onto the ground is not simulated; the
targets lack it too.
"""

from __future__ import annotations

from typing import Any

from . import library
from .cameras import orbit
from .stage import camera, ground, matt

BALL, RADIUS = [-1.6, 1.3, -0.6], 0.25
LAMP, INTENSITY = [-3.5, 4.5, -1.8], 50.0


def build(width: int, texture: int) -> dict[str, Any]:
    """The scene with the ball at its true place; unknown: the pose `ball.place`, x and y."""
    albedo = library.picture("models/rock1/rock01.jpg", texture, texture)
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.15}},
        "lamp": {
            "type": "point",
            "position": LAMP,
            "intensity": {"type": "rgb", "value": INTENSITY},
        },
        "ground": ground(
            4.0, {"type": "principled", "base_color": library.texture(albedo), "roughness": 0.9}
        ),
        "ball": {"type": "sphere", "center": BALL, "radius": RADIUS, "bsdf": matt(0.5)},
        "sensor_000": camera(orbit((0, 0, 0), 4.0, 0.0, 60.0), (0.0, 0.0, 0.0), 35.0, width),
    }
