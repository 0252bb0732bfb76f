"""Earth: a globe under a glass bell, its back seen in a mirror; one image, the texture unknown.

The paper's scene (Fig. 9, EARTH): "an earth-like object covered by a glass bell. We also observe
the back of this object through a mirror"; one image of 16 M pixels, under environmental lighting,
started from an albedo of 0.5.

Ours: a globe with NASA's picture on a turned foot, matt (principled BSDF of roughness 0.6), under a
glass bell on a plinth. A mirror stands behind it and shows the back, beside the globe in the image;
the light is the CC0 map `sunset`, which has no dominant sun. The mirror is a metallic principled
BSDF of roughness 0.04.

What differs: the paper's models, light and camera are not published, so ours are others. The bell
is a thin pane without refraction (`thindielectric`), as a principled lobe has no smooth limit. The
picture has 2048 x 1024 texels: larger sizes are interpolated.

Path replay connects surfaces with light straight on, which the bell blocks: all light on the globe
comes by paths that leave through the glass by chance. Parts of it that neither camera nor mirror
see stay unknown.

Depth 7: camera, mirror, glass, globe, glass, light, and two surfaces more. Against depth 16 the
image lacks 1.0 % of its light (6 % at depth 5); targets have the same depth.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import library, meshes
from .cameras import orbit, perspective
from .lathe import turn
from .plinth import plinth

RADIUS, GLOBE_Y = 0.40, 0.56
BELL_RADIUS, BELL_HEIGHT = 0.50, 0.58  # of the cylinder; a dome closes it
# (radius, height) of the foot, which the globe rests on.
FOOT = [(0, 0), (0.26, 0), (0.26, 0.03), (0.12, 0.06), (0.07, 0.10), (0.10, 0.18), (0, 0.18)]
MIRROR_Z, MIRROR_X, MIRROR_HALF, MIRROR_TOP = -0.95, 0.05, 0.9, 1.3
LOOK_AT = (0.03, 0.57, -0.54)


def build(resolution: int, texture: int) -> dict[str, Any]:
    """The scene with the true texture; unknown: `globe.bsdf.base_color.data`,
    (texture/2, texture, 3)."""
    import mitsuba as mi

    albedo = library.picture("textures/earth.jpg", texture, max(1, texture // 2))
    # The sphere's poles lie on its own z axis.
    globe = mi.ScalarTransform4f().translate([0, GLOBE_Y, 0]).rotate([0, 0, 1], 20)
    globe = globe.rotate([1, 0, 0], -90).rotate([0, 0, 1], 110).scale(RADIUS)
    wood = {"type": "rgb", "value": [0.20, 0.09, 0.04]}
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 7},
        "sky": library.environment("hdri/sunset.exr", turn=40.0),
        "globe": {
            "type": "sphere",
            "to_world": globe,
            "bsdf": {
                "type": "principled",
                "base_color": library.texture(albedo),
                "roughness": 0.6,
            },
        },
        "foot": meshes.shape(
            "foot",
            turn(np.array(FOOT)),
            {"type": "principled", "base_color": wood, "roughness": 0.5},
        ),
        "bell": meshes.shape("bell", turn(_bell()), {"type": "thindielectric"}),
        **_mirror(),
        "plinth": plinth(1.6),
        "sensor_000": perspective(orbit(LOOK_AT, 4.6, 36.0, 12.0), LOOK_AT, 25.0, resolution),
    }


def _bell() -> np.ndarray:
    """A cylinder from just above the plinth, and a dome."""
    angle = np.linspace(0, np.pi / 2, 25)
    dome = np.stack([np.cos(angle), np.sin(angle)], axis=1) * BELL_RADIUS + [0, BELL_HEIGHT]
    dome[-1, 0] = 0.0
    return np.concatenate([[(BELL_RADIUS, 1e-3)], dome])


def _mirror() -> dict[str, Any]:
    """The mirror, facing +z, and the board that backs it."""
    import mitsuba as mi

    to = mi.ScalarTransform4f
    half_height = MIRROR_TOP / 2
    at = to().translate([MIRROR_X, half_height, MIRROR_Z])
    board = to().translate([MIRROR_X, half_height, MIRROR_Z - 0.035])
    return {
        "mirror": {
            "type": "rectangle",
            "to_world": at.scale([MIRROR_HALF, half_height, 1]),
            "bsdf": {
                "type": "principled",
                "base_color": {"type": "rgb", "value": [0.93, 0.93, 0.93]},
                "metallic": 1.0,
                "roughness": 0.04,
            },
        },
        "board": {
            "type": "cube",
            "to_world": board.scale([MIRROR_HALF + 0.04, half_height + 0.04, 0.03]),
            "bsdf": {
                "type": "principled",
                "base_color": {"type": "rgb", "value": [0.20, 0.09, 0.04]},
                "roughness": 0.5,
            },
        },
    }
