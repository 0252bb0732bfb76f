"""Object, joint: a painted bowl whose paint, gloss and surroundings are all unknown.

After *Physics Based Differentiable Rendering for Inverse Problems and Beyond* (Kakkar et al.;
PBDR), which estimates materials and light at once, of "intricate items with varied surface
roughness and lifelike patterns", and prints neither scenes nor figures. Ours: the bowl of the
scene `bowl` in the paper's own reflectance (its Eq. 5: diffuse and specular albedo, roughness),
hanging under a coarse coloured sky that is unknown as well.

Light and albedo can stand for each other in what the bowl reflects: twice the light on half of the
albedo looks alike. The sky is in the pictures, beside the bowl, and so fixes the scale. Its shape
is given.

Depth 3: camera, two surfaces, light, as in `bowl`.
"""

from __future__ import annotations

from typing import Any

from . import bowl, figures, library, meshes
from .cameras import spiral
from .lathe import turn

SPECULAR, ROUGHNESS = 0.25, 0.2
SKY = 8  # rows of the map


def build(views: int, resolution: int, texture: int) -> dict[str, Any]:
    """Unknown: `bowl.bsdf.diffuse.data`, (texture²) x 3; `bowl.bsdf.specular.value`, a number, as
    `bowl.bsdf.roughness.value`; and `sky.data`, 8 x 16 x 3."""
    material = {
        "type": "phong",
        "diffuse": library.texture(bowl.paint(texture)),
        "specular": SPECULAR,
        "roughness": ROUGHNESS,
    }
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 3},
        "sky": figures.sky(SKY),
        "bowl": meshes.shape("bowl", turn(bowl.profile(), 160), material),
        **spiral(views, resolution, (0.0, 0.3, 0.0), 3.2, 30.0, (-30.0, 55.0)),
    }
