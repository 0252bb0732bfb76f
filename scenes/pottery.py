"""Pottery: a glossy jar under a bright sun; its spatially varying base colour is unknown.

The paper's scene (Fig. 8, POTTERY): "a glossy object under environmental lighting with bright
sun light, and the spatially varying albedo is optimized using 16 input images", principled BSDF,
about 4 M pixels an image, textures started at a constant 0.5.

Ours: the `old_jar` model smoothed by subdivision, a principled BSDF of roughness 0.3, decorated
by code (`pottery_paint`), under the CC0 map `city`, whose sun stands at 48° and gives a quarter
of the light. 16 cameras on a spiral around it, from 4° to 55° above the horizon.

What differs: the paper's model, texture and environment are not published, so all three are
others; our jar stands on a plinth, which its shadow and its reflections tie it to. The texture
is made for the size asked for, so that a large one holds more detail and not just more texels.

Depth 3: camera, two surfaces, light. One bounce between surfaces lights the inside of the jar.
Against depth 8 the images lack 1.5 % of their light (6 % at depth 2); targets have the same depth.
"""

from __future__ import annotations

from typing import Any

from . import library, meshes
from .bake import bake
from .cameras import spiral
from .plinth import plinth
from .pottery_paint import AXIS_X, paint
from .subdivide import subdivide

ROUGHNESS = 0.3
# Degrees that bring the handle of the model to the -x side.
HANDLE_TURN = 26.6


def build(views: int, resolution: int, texture: int) -> dict[str, Any]:
    """The scene with the true texture; unknown: `jar.bsdf.base_color.data`, (texture²) x 3."""
    coarse = meshes.read_obj(library.asset("models/old_jar/old_jar.obj"))
    jar = meshes.place(subdivide(coarse, levels=2, name="old_jar.obj"), turn=HANDLE_TURN)
    jar_material = {
        "type": "principled",
        "base_color": library.texture(bake(jar, texture, paint)),
        "roughness": ROUGHNESS,
    }
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 3},
        "sky": library.environment("hdri/city.exr"),
        "jar": meshes.shape("jar", jar, jar_material),
        "plinth": plinth(0.42, at=(AXIS_X, 0.0)),
        **spiral(views, resolution, (0.0, 0.54, 0.0), 3.0, 27.0, (4.0, 55.0)),
    }
