"""Caustic_failure: a floor lit through glass by a small lamp, which camera paths hardly find.

The paper's scene (Fig. 7): "Our method assumes unidirectional path tracing. Therefore, for problems
that require using adjoint or bidirectional methods (e.g., scenes with strong caustic effects) [...]
our method would be inapplicable"; there the sampling probability "can be unreliable [...] unless
using impractically high sample counts".

Ours: a ball of clear glass between a small bright lamp and a floor with a photographed texture,
under a dim sky. The lamp lights the floor around the ball's shadow straight on, which path replay
finds every time; inside the shadow lies the caustic, which only a path finds that leaves the floor
into the ball and happens to hit the lamp.

Measured at 128² pixels: 0.6 % of the pixels lie in the caustic and hold 12 % of the image's light
and 88 % of its variance; of the paths that start there one in 160 brings its light. A look with one
path a pixel so sees a bright spot or none, and targets of 128 paths a pixel are noisy there. `isas`
warns that the density of `ours` is not to be trusted here.

What differs: the paper's scene is not described, so ours is another. The ball is a `dielectric`:
a principled lobe has no smooth limit.

Depth 5: camera, floor, glass, glass, lamp, and one surface more. Against depth 12 the image lacks
0.7 % of its light (2.8 % at depth 4); targets have the same depth.
"""

from __future__ import annotations

from typing import Any

from . import library
from .cameras import orbit, perspective

LOOK_AT = (0.15, 0.2, 0.1)
BALL_RADIUS = 0.42
LAMP_AT, LAMP_RADIUS, RADIANCE = (-0.9, 2.2, -0.5), 0.05, 2000.0
SKY = 0.05


def build(resolution: int, texture: int) -> dict[str, Any]:
    """The scene with the true texture; unknown: `floor.bsdf.base_color.data`, (texture²) x 3."""
    import mitsuba as mi

    to = mi.ScalarTransform4f
    albedo = library.picture("models/rock1/rock01.jpg", texture, texture)
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 5},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": SKY}},
        "floor": {
            "type": "rectangle",
            "to_world": to().rotate([1, 0, 0], -90).scale([2.6, 2.6, 1]),
            "bsdf": {
                "type": "principled",
                "base_color": library.texture(albedo),
                "roughness": 0.8,
            },
        },
        "ball": {
            "type": "sphere",
            "to_world": to().translate([0, BALL_RADIUS + 1e-3, 0]).scale(BALL_RADIUS),
            "bsdf": {"type": "dielectric", "int_ior": 1.5},
        },
        "lamp": {
            "type": "sphere",
            "to_world": to().translate(LAMP_AT).scale(LAMP_RADIUS),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": RADIANCE}},
        },
        "sensor_000": perspective(orbit(LOOK_AT, 4.0, 20.0, 42.0), LOOK_AT, 26.0, resolution),
    }
