"""Trashcan: a glossy bin in a Cornell box; its roughness, one number, is unknown.

The paper's scene (Fig. 6, TRASHCAN): "a Cornell box containing a glossy trash can with a spatially
invariant BRDF. We optimize the surface roughness of the trash can. Using one input image and a
small sample budget", the derivative estimated by differential BSDF sampling (Belhe et al. 2024).

Ours: the CC0 model `dustbin` as metal (principled BSDF, metallic 0.9) of true roughness 0.25,
started from 0.8, in a box that is closed behind the camera (`cornell`), so that the bin shows a
room and not the dark outside. One image. The bin covers a quarter of it and has a seventh of the
variance of single paths; half of that lies in the uppermost fifth of the image, on wall and upper
rim, where the light of the lamp that the bin throws there is found by chance.

What differs: the paper's models, light and roughness are not published, so ours are others. The
error of the image, without noise, falls all the way from 1.0 to the true roughness, but slowly at
first: from 0.8 to 0.6 by a fifth. Bin, lamp and camera were arranged for a good picture, and once
more to take the lamp out of it, which made up most of the variance.

Depth 6: camera, up to five surfaces, light. In a closed white room much light comes by many
bounces: against depth 16 the image lacks 4 % of it (13 % at depth 4); targets have the same depth.
"""

from __future__ import annotations

from typing import Any

from . import library, meshes
from .cornell import cornell_box

ROUGHNESS = 0.25


def build(resolution: int) -> dict[str, Any]:
    """The scene with the true roughness; unknown: `bin.bsdf.brdf_0.roughness.value`, one number."""
    surface = meshes.read_obj(library.asset("models/dustbin/dustbin.obj"), textured=False)
    bin_ = meshes.place(surface, height=1.3, turn=20, at=(0.0, -0.1))
    material = {
        "type": "principled",
        "base_color": {"type": "rgb", "value": [0.62, 0.60, 0.57]},
        "metallic": 0.9,
        "roughness": ROUGHNESS,
    }
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 6},
        "bin": meshes.shape("bin", bin_, {"type": "twosided", "bsdf": material}),
        **cornell_box(resolution),
    }
