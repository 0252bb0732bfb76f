"""Room, joint: cubes and spheres, diffuse, glossy and specular, in a box; their materials and the
lamp are unknown.

After *Physics Based Differentiable Rendering for Inverse Problems and Beyond* (Kakkar et al.;
PBDR), whose artificial scenes "consist of basic geometric forms such as cubes and spheres with
well-known material characteristics (glossy, specular, or diffuse)", and prints neither scenes nor
figures. Ours: a Cornell box with two cubes and three spheres: a matt cube and a matt sphere, a
glossy cube and a glossy sphere in the paper's own reflectance (its Eq. 5), and a metal sphere. The
walls are known; the lamp is in no picture, its colour and power are unknown. The cameras stand in a
row at the far end. Shapes and places are given.

The known walls fix the scale that lamp and colours would else share.

Depth 4: camera, three surfaces, light.
"""

from __future__ import annotations

from typing import Any

from .cameras import perspective
from .cornell import LOOK_AT, cornell_box

SIDE = 0.84  # how far to the sides of the room the cameras go; its walls are at 1
FIELD_OF_VIEW = 34.0


def build(views: int, resolution: int) -> dict[str, Any]:
    """Unknown, all of them a colour or a number: the `reflectance` of `matt_cube` and `matt_ball`,
    `diffuse`, `specular` and `roughness` of `glossy_cube` and `glossy_ball`, `base_color` and
    `roughness` of `metal_ball`, and `lamp.emitter.radiance`."""
    import mitsuba as mi

    box = cornell_box(resolution)
    del box["sensor_000"]
    to = mi.ScalarTransform4f
    cubes = {
        "matt_cube": ([-0.5, 0.3, -0.45], 0.3, 20),
        "glossy_cube": ([0.5, 0.45, -0.4], 0.32, -25),
    }
    balls = {
        "matt_ball": ([-0.62, 0.2, 0.35], 0.2),
        "glossy_ball": ([0.0, 0.27, 0.2], 0.27),
        "metal_ball": ([0.6, 0.22, 0.4], 0.22),
    }
    materials = {
        "matt_cube": _matt([0.62, 0.42, 0.12]),
        "matt_ball": _matt([0.2, 0.3, 0.6]),
        "glossy_cube": _glossy([0.25, 0.45, 0.4], 0.3, 0.35),
        "glossy_ball": _glossy([0.5, 0.12, 0.1], 0.4, 0.15),
        "metal_ball": {
            "type": "principled",
            "base_color": {"type": "rgb", "value": [0.85, 0.65, 0.35]},
            "metallic": 1.0,
            "roughness": 0.2,
        },
    }
    shapes = {
        name: {
            "type": "cube",
            "to_world": to().translate(at).rotate([0, 1, 0], turn).scale([half, at[1], half]),
            "bsdf": materials[name],
        }
        for name, (at, half, turn) in cubes.items()
    } | {
        name: {"type": "sphere", "center": at, "radius": radius, "bsdf": materials[name]}
        for name, (at, radius) in balls.items()
    }
    sensors = {
        f"sensor_{view:03d}": perspective(
            [SIDE * (2 * view / max(views - 1, 1) - 1), 0.7 + 0.6 * (view % 2), 3.5],
            LOOK_AT,
            FIELD_OF_VIEW,
            resolution,
        )
        for view in range(views)
    }
    integrator = {"type": "prb", "max_depth": 4}
    return {"type": "scene", "integrator": integrator, **box, **shapes, **sensors}


def _matt(colour: list[float]) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": colour}}


def _glossy(diffuse: list[float], specular: float, roughness: float) -> dict[str, Any]:
    return {
        "type": "phong",
        "diffuse": {"type": "rgb", "value": diffuse},
        "specular": specular,
        "roughness": roughness,
    }
