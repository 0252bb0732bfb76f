"""The scene that the numerical tests share, with coloured values and more kinds of lights."""

import mitsuba as mi
import numpy as np
from scenes_for_tests import dictionary

SKY = (4, 8, 3)
STARTS = {
    "floor.bsdf.base_color.data": 0.5,
    "wall.bsdf.base_color.value": [0.5, 0.6, 0.7],
    "wall.bsdf.roughness.value": 0.5,
    "wall.bsdf.metallic.value": 0.5,
    "lamp.emitter.radiance.value": [8.0, 9.0, 10.0],
}
# Unknowns that need a sky of their own: the scene under a map, and under a constant sky.
UNDER = {
    "map": {"bulb.intensity.value": [2.0, 1.5, 1.0], "sky.data": 0.4, "sky.scale": 0.8},
    "constant": {
        "sky.radiance.value": [0.4, 0.5, 0.6],
        "sun.irradiance.value": [1.0, 0.9, 0.8],
        "spot.intensity.value": 3.0,
    },
}


def rgb(*values: float) -> dict:
    return {"type": "rgb", "value": list(values)}


def sky_texels() -> np.ndarray:
    return np.random.default_rng(5).uniform(0.2, 0.8, SKY).astype(np.float32)


def lit(sky: str, depth: int = 4, texels: np.ndarray | None = None) -> dict:
    """Under a ``map``, with a point light, or a ``constant`` sky, with a spot and a sun."""
    scene = dictionary(depth=depth)
    scene["wall"]["bsdf"] |= {"metallic": 0.7, "base_color": rgb(0.7, 0.5, 0.3)}
    scene["lamp"]["emitter"]["radiance"] = rgb(12, 10, 8)
    if sky == "map":
        texels = sky_texels() if texels is None else texels
        scene["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(texels), "scale": 1.0}
        scene["bulb"] = {
            "type": "point",
            "position": [-1, 1.5, 1],
            "intensity": rgb(1, 1.5, 2),
        }
    else:
        scene["sky"] = {"type": "constant", "radiance": rgb(0.3, 0.3, 0.3)}
        down = mi.ScalarTransform4f().look_at([-1, 3, 1], [0, 0, 0], [0, 0, 1])
        scene["spot"] = {
            "type": "spot",
            "to_world": down,
            "intensity": rgb(4, 4, 4),
            "cutoff_angle": 40,
        }
        scene["sun"] = {"type": "directional", "direction": [0.3, -1, -0.4]}
        scene["sun"]["irradiance"] = rgb(0.5, 0.5, 0.5)
    return scene
