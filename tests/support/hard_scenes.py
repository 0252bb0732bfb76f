"""Scenes whose light transport is hard to estimate, each small enough for hundreds of estimates.

Two cameras of different film sizes, textures of 2² texels. What makes each scene hard is said with
it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mitsuba as mi
import numpy as np
from scenes_for_tests import dictionary, means, texture, without_targets

from isas_cli.scene.problem import Problem

_place = mi.ScalarTransform4f
_BRIGHTER = 4.0


@dataclass(frozen=True)
class HardScene:
    """``unknowns``: key → start; ``depth``: edges of a path at most; ``build``: depth → Mitsuba's
    dictionary."""

    unknowns: dict
    depth: int
    build: Callable[[int], dict]


def _cameras() -> dict:
    return {k: v for k, v in dictionary().items() if k.startswith("sensor")}


def _floor(bsdf: str) -> dict:
    """A textured floor, of a ``bsdf`` with a diffuse or a principled lobe."""
    name = {"diffuse": "reflectance", "principled": "base_color"}[bsdf]
    return {
        "type": "rectangle",
        "to_world": _place().rotate([1, 0, 0], -90).scale(1.2),
        "bsdf": {
            "type": bsdf,
            name: {"type": "bitmap", "data": mi.TensorXf(texture(2)), "raw": True},
        },
    }


def _lamp(radius: float, radiance: float) -> dict:
    return {
        "type": "sphere",
        "center": [1.5, 2.5, 1.5],
        "radius": radius,
        "emitter": {"type": "area", "radiance": radiance},
    }


def _interreflection(depth: int) -> dict:
    return dictionary(size=2, depth=depth)


def _sun(depth: int) -> dict:
    sky = np.full((32, 64, 3), 0.3, np.float32)
    sky[10, 14] = (2000.0, 1700.0, 1300.0)  # five degrees across
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": depth},
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(sky), "scale": 1.0},
        "floor": _floor("principled"),
        "ball": {
            "type": "sphere",
            "center": [0, 0.8, 0],
            "radius": 0.8,
            "bsdf": {"type": "principled", "roughness": 0.2, "metallic": 1.0},
        },
        **_cameras(),
    }


def _mirror(depth: int) -> dict:
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": depth},
        "sky": {"type": "constant", "radiance": 0.5},
        "lamp": _lamp(0.6, 5.0),
        "floor": _floor("diffuse"),
        "mirror": {
            "type": "rectangle",
            "to_world": _place().translate([0, 1, -1]),
            "bsdf": {"type": "conductor", "material": "Al"},
        },
        "ball": {
            "type": "sphere",
            "center": [0.3, 0.85, 0.2],
            "radius": 0.85,
            "bsdf": {"type": "roughconductor", "material": "Cu", "alpha": 0.1},
        },
        **_cameras(),
    }


def _glass(depth: int) -> dict:
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": depth},
        "sky": {"type": "constant", "radiance": 0.6},
        "lamp": _lamp(0.9, 4.0),
        "floor": _floor("diffuse"),
        "pane": {
            "type": "rectangle",
            "to_world": _place().translate([-0.6, 0.8, 1.0]).scale(0.8),
            "bsdf": {"type": "thindielectric"},
        },
        "shell": {
            "type": "sphere",
            "center": [0.6, 0.6, 0],
            "radius": 0.5,
            "bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
        },
        "core": {
            "type": "sphere",
            "center": [0.6, 0.6, 0],
            "radius": 0.3,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.4, 0.3]}},
        },
        **_cameras(),
    }


SCENES = {
    # A glossy wall and a textured floor see each other: a path meets both unknowns, each up to
    # twice, and the products of their derivatives count.
    "interreflection": HardScene(
        {"floor.bsdf.base_color.data": 0.5, "wall.bsdf.roughness.value": 0.5},
        4,
        _interreflection,
    ),
    # One texel of the sky outshines all others together. Its scale is unknown as well, so that
    # the derivative of a light is among what is tested.
    "sun": HardScene(
        {
            "floor.bsdf.base_color.data": 0.5,
            "ball.bsdf.roughness.value": 0.7,
            "sky.scale": 0.8,
        },
        4,
        _sun,
    ),
    # The lamp and the unknowns are seen directly, in a mirror without roughness and in a ball
    # with some. Light by way of the mirror is found by BSDF sampling only. Long paths: roulette.
    "mirror": HardScene(
        {"floor.bsdf.reflectance.data": 0.5, "ball.bsdf.alpha.value": 0.7}, 6, _mirror
    ),
    # A pane before a part of the floor, and a ball inside a massive shell of glass: no shadow ray
    # passes, all light there comes by BSDF sampling.
    "glass": HardScene(
        {"floor.bsdf.reflectance.data": 0.5, "core.bsdf.reflectance.value": 0.5},
        8,
        _glass,
    ),
}


def hard_problem(name: str, depth: int | None = None) -> Problem:
    """One of ``SCENES`` as a problem at its start values. ``depth``: instead of the scene's own."""
    chosen = SCENES[name]
    return assemble(chosen.build(depth or chosen.depth), chosen.unknowns)


def assemble(description: dict, unknowns: dict) -> Problem:
    """``description``: Mitsuba's, whose values are the truth; ``unknowns``: key → start.

    The targets are several times as bright as the renderings of the start: residuals of one sign
    everywhere, so that what pixels say about an unknown adds up to a gradient well above its
    noise, against which a small bias can be seen.
    """
    result = without_targets(description, unknowns)
    result.unknowns.write(result.unknowns.starts())
    rendered = _BRIGHTER * means(result, 1024, 1000)
    result.set_targets(mi.Float(rendered.ravel().astype(np.float32)), None, "test")
    return result
