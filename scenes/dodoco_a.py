"""Dodoco_a: one matt figure in the open; its spatially varying albedo is unknown.

The paper's scene (Fig. 9, DODOCOA): "an object lit by a outdoor environment map. We optimize the
spatially varying albedo of this object using 16 multi-view images", started from 0.5.

Ours: a hen with its own painted texture, matt (principled BSDF of roughness 0.7), on a plinth under
the CC0 map `forest`. 16 cameras on a spiral around it, from 2° to 45° above the horizon; 8 at the
size `default`.

What differs: the paper's model, texture and light are not published, so all are others. The texture
file has 512² texels, which is the paper's size of an image too. 4 % of the texels that the hen uses
belong to two places of it; the truth has them alike.

Depth 2: camera, surface, light. The hen is mostly convex: against depth 8 the images lack 1.9 % of
their light (0.4 % at depth 3); targets have the same depth.
"""

from __future__ import annotations

from typing import Any

from . import library, meshes
from .cameras import spiral
from .plinth import plinth


def build(views: int, resolution: int, texture: int) -> dict[str, Any]:
    """Unknown: `figure.bsdf.brdf_0.base_color.data`, (texture²) x 3."""
    figure = meshes.place(meshes.read_obj(library.asset("models/chicken/chicken.obj")))
    albedo = library.picture("models/chicken/chicken.jpg", texture, texture)
    material = {
        "type": "principled",
        "base_color": library.texture(albedo),
        "roughness": 0.7,
    }
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sky": library.environment("hdri/forest.exr"),
        # The mesh is open, and its rear faces would be black.
        "figure": meshes.shape("figure", figure, {"type": "twosided", "bsdf": material}),
        "plinth": plinth(0.5),
        **spiral(views, resolution, (0.0, 0.5, 0.0), 3.2, 21.0, (2.0, 45.0)),
    }
