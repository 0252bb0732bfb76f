"""Small problems that the numerical tests share."""

from __future__ import annotations

import gc

import drjit as dr
import mitsuba as mi
import numpy as np

from isas_cli.config.schema import PoseConfig, UnknownConfig
from isas_cli.rendering import integrators
from isas_cli.samplers.sampler import Stage1Settings
from isas_cli.scene.problem import Problem
from isas_cli.scene.views import Views
from isas_cli.unknowns.specs import parse
from isas_cli.unknowns.unknowns import Unknowns

TEXTURE, ROUGHNESS = "floor.bsdf.base_color.data", "wall.bsdf.roughness.value"
UNKNOWNS = {TEXTURE: 0.5, ROUGHNESS: 0.5}
STAGE1 = Stage1Settings(resolution=4, spp=4, denoise="none")


def texture(size: int) -> np.ndarray:
    rng = np.random.default_rng(7)
    return rng.uniform(0.2, 0.8, (size, size, 3)).astype(np.float32)


def dictionary(
    size: int = 4, resolution: tuple[int, int] = (12, 8), depth: int = 4, floor: float = 1.0
) -> dict:
    """A textured floor before a glossy wall: both see each other (interreflection), under a small
    bright lamp and a dim sky, from two cameras of different sizes. ``floor``: half its side."""
    look = mi.ScalarTransform4f().look_at
    place = mi.ScalarTransform4f()

    def camera(origin, width, height):
        return {
            "type": "perspective",
            "fov": 45,
            "to_world": look(origin=origin, target=[0, 0.3, 0], up=[0, 1, 0]),
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
            },
        }

    w, h = resolution
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": depth},
        "sky": {"type": "constant", "radiance": 0.3},
        "lamp": {
            "type": "sphere",
            "center": [1.5, 2.5, 1.5],
            "radius": 0.3,
            "emitter": {"type": "area", "radiance": 12.0},
        },
        "floor": {
            "type": "rectangle",
            "to_world": place.rotate([1, 0, 0], -90).scale(floor),
            "bsdf": {
                "type": "principled",
                "roughness": 0.5,
                "base_color": {
                    "type": "bitmap",
                    "data": mi.TensorXf(texture(size)),
                    "raw": True,
                },
            },
        },
        "wall": {
            "type": "rectangle",
            "to_world": place.translate([0, 1, -1]),
            "bsdf": {"type": "principled", "metallic": 0.9, "roughness": 0.4, "base_color": 0.7},
        },
        "sensor_000": camera([0.5, 1.6, 3.5], w, h),
        "sensor_001": camera([-1.8, 1.2, 2.6], h, w),
    }


def under_spots(**spots: dict) -> dict:
    """The same, with a finer floor, under nothing but ``spots`` that shine down from 2 above it:
    by id, ``x`` and what else each has."""
    found = dictionary(size=16, resolution=(48, 32), depth=2)
    del found["sky"], found["lamp"]
    for id, spot in spots.items():
        x = spot.pop("x", 0.0)
        down = mi.ScalarTransform4f().look_at([x, 2, 0], [x, 0, 0], [0, 0, 1])
        found[id] = {"type": "spot", "to_world": down, **spot}
    return found


def without_targets(
    description: dict,
    unknowns: dict[str, float | UnknownConfig],
    poses: dict[str, PoseConfig] | None = None,
) -> Problem:
    """``description``: Mitsuba's, whose values are the truth; ``unknowns``: key → start, or all
    of its settings."""
    gc.collect()  # see assemble.problem
    scene = mi.load_dict(description, optimize=False)
    film = [tuple(int(x) for x in s.film().crop_size()) for s in scene.sensors()]
    specs = {
        key: given if isinstance(given, UnknownConfig) else UnknownConfig(start=given)
        for key, given in unknowns.items()
    }
    params = mi.traverse(scene)
    found = parse(params, specs, True, poses)
    keys = {key for each in found for key in each.kind.writes} & set(params.keys())
    result = Problem(
        "test",
        scene,
        integrators.adapt(scene.integrator(), scene=scene, keys=sorted(keys)),
        scene.sensors_dr(),
        film,
        Views.of(film),
        Unknowns(mi.traverse(scene), found),
        "test",
    )
    for unknown in result.unknowns:
        unknown.seen = np.ones(unknown.start.shape, bool)
    return result


def means(p: Problem, paths: int, seed: int, renderer=None) -> np.ndarray:
    """Of so many paths a pixel at the present values, in one launch, ``(pixels, 3)``."""
    from isas_cli.rendering.renderer import Renderer

    pixel = dr.repeat(dr.arange(mi.UInt32, p.views.total), paths)
    found = (renderer or Renderer(p)).pixels(pixel, 1, lambda _: seed)
    return np.array(found, np.float64).reshape(3, -1, paths).mean(axis=2).T


def render_targets(result: Problem, spp: int) -> None:
    """The truth as the target; the unknowns are at their starts afterwards."""
    from isas_cli.rendering.renderer import Renderer

    result.unknowns.write(result.unknowns.truths())
    pixels = Renderer(result).range(0, result.views.total, spp, lambda i: 1000 + i)
    result.set_targets(mi.Float(pixels.reshape(-1)), None, "test")
    result.unknowns.write(result.unknowns.starts())


def problem(unknowns: dict[str, float], constant_target: float | None = 0.25, **sizes) -> Problem:
    """The scene above as a problem. ``unknowns``: key → start. The target is a constant, or the
    truth rendered coarsely where ``constant_target`` is None."""
    result = without_targets(dictionary(**sizes), unknowns)
    if constant_target is None:
        render_targets(result, 256)
    else:
        count = result.views.total * 3
        # Varies from pixel to pixel, so that residuals do.
        rng = np.random.default_rng(3)
        target = (constant_target * rng.uniform(0.5, 1.5, count)).astype(np.float32)
        result.set_targets(mi.Float(target), None, "test")
    result.unknowns.write(result.unknowns.starts())
    return result
