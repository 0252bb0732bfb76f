"""Jumpydumpy: a glossy textured figure before a low bright sun; its albedo is unknown.

The paper's scene (Fig. 4, JUMPYDUMPY): "a glossy textured object is illuminated by an environment
map with a bright sun. We optimize the albedo of this object. The bright sun and glossy surface
cause drastic changes in brightness across different pixels"; done with L2 and with relative L2.

Ours: the `cat` model smoothed by subdivision, glazed like porcelain (principled BSDF, roughness
0.2), with its own photographed texture, under the CC0 map `sunrise`, whose sun stands 8° above
the horizon and gives 60 % of the light. The figure is lit from one side: highlights are
hundreds of times brighter than the far side, which is what the two losses weigh differently.

What differs: the paper's model, texture, environment and number of views are not published, so
all are others; our figure sits on a plinth. The texture file has 512² texels: larger sizes are
interpolated and hold no more detail.

Depth 2: camera, surface, light. The figure is mostly convex, so light between surfaces is left
out: against depth 8 the images lack 3 % of their light. Targets have the same depth.
"""

from __future__ import annotations

from typing import Any

from . import library, meshes
from .cameras import spiral
from .plinth import plinth
from .subdivide import subdivide

ROUGHNESS = 0.2


def build(views: int, resolution: int, texture: int) -> dict[str, Any]:
    """The scene with the true texture; unknown: `figure.bsdf.base_color.data`, (texture²) x 3."""
    coarse = meshes.read_obj(library.asset("models/cat/cat.obj"))
    figure = meshes.place(subdivide(coarse, levels=2, name="cat.obj"))
    albedo = library.picture("models/cat/cat-texture.jpg", texture, texture)
    material = {
        "type": "principled",
        "base_color": library.texture(albedo),
        "roughness": ROUGHNESS,
    }
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sky": library.environment("hdri/sunrise.exr"),
        "figure": meshes.shape("figure", figure, material),
        "plinth": plinth(0.4),
        **spiral(views, resolution, (0.0, 0.5, 0.0), 3.0, 23.5, (2.0, 45.0)),
    }
