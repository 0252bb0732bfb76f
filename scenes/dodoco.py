"""Dodoco: three matt objects before a rough mirror; the mirror's roughness is unknown.

The paper's scenes (Fig. 3 and DODOCO in Fig. 8): "three diffuse objects are placed in front of a
mirror. The experiment simulates a single iteration of an inverse-rendering optimization where the
roughness of the mirror is optimized"; DODOCO "uses a similar setting as Figure 3", with 4 M
pixels an image.

Ours: a cat, a globe and a hen, matt and textured, on a dark floor before a mirror that hangs on
a plastered wall, under the CC0 map `sunset`, which has no dominant sun. They face the mirror, so
that the camera sees their backs and the mirror their faces: parts near the mirror stay sharp in
it, far ones blur, and so the derivative by roughness varies from pixel to pixel. The mirror is a
metallic principled BSDF of true roughness 0.15; its gradient dies below about 0.032, so the legal
range starts above that. All other surfaces are principled BSDFs too, of roughness 1 and without a
specular lobe: nearly diffuse, but with the retroreflection of that model.

What differs: the paper's models, light and camera are not published, so ours are others. One view,
as a single image determines a single number; more views stand on an arc before the mirror.

What was arranged, so that the scene poses figure 3's problem: much residual where little depends
on the unknown. It shows what Eq. (12) can gain over |∂ℒ|, not what it gains in general. What
counts is the mirror's share a of Σ_j √A_j, the mass that the best pmf gives it (see
`isas_cli.measure.variance`), and its share m of Σ_j |∂ℒ/∂I_j|: |∂ℒ|'s variance is about
a²/m + (1-a)²/(1-m) times the best one. In an earlier arrangement the mirror stood on a light floor
and covered 59 % of the image; |∂ℒ|'s variance was 0.69 of uniform's, that of `ours` 0.67 and the
best pmf's 0.62: nothing to choose between them. Now the mirror covers an eighth of the image, and a
bright wall, whose single-path noise counts as residual, covers half of it; the floor is dark and
the map turned so that the light falls on the wall. Objects, roughness, its start value and the
depth are as they were. All these variances were measured before the diffuse materials became
principled ones. Tried on the way, as |∂ℒ|'s variance over the best pmf's for independent draws,
from second moments of 256 paths in each of 128² pixels, good to about a tenth (then 1.1):

- before there was a wall, the camera further away or a smaller mirror: 1.4; with the start value
  0.3 in addition: 1.4 to 1.8;
- a lamp in a dark room, and maps with a sun: rare bright paths made up most of the variance, with
  any pmf, and so few paths could not tell the ratio;
- a wall around a smaller mirror: 2.7 with the mirror on 17 % of the image, 3.4 on 12 %, 2.8 with a
  whiter wall, 2.3 and 2.0 with the suns of `sunrise` and `city`, 2.7 and 3.0 with the start values
  0.4 and 0.7;
- the map turned: 2.9 instead of 2.7; the floor darkened: 2.8 instead of 2.7.

All of the last together, with the mirror on 13 %: 4.1.

Depth 4: camera, mirror, object, mirror, light. The faces that the mirror shows are lit mostly by
the mirror and the wall, so depth 3 would leave them dark. Against depth 8 the image lacks 0.3 % of
its light (3 % at depth 3); targets have the same depth.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import library, meshes
from .cameras import orbit, perspective

ROUGHNESS = 0.15
MIRROR_Z = -0.75
MIRROR_WIDTH, MIRROR_BOTTOM, MIRROR_TOP = 1.6, 0.25, 1.2
FRAME_BORDER, FRAME_DEPTH = 0.05, 0.04
FRAME_GAP = 0.005  # the frame's front stands back, so that the mirror covers its middle
WALL_GAP = 0.005  # between the frame's back and the wall
LOOK_AT = (0.0, 0.74, -0.4)
DISTANCE, ELEVATION, FIELD_OF_VIEW = 5.8, 12.0, 28.0
ARC = 25.0


def build(views: int, resolution: int, texture: int) -> dict[str, Any]:
    """The scene with the true roughness; unknown: `mirror.bsdf.roughness.value`, one number.

    `texture` is the width in texels of the textures of the three objects.
    """
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 4},
        "sky": library.environment("hdri/sunset.exr", turn=150.0),
        **_mirror(),
        **_room(),
        **_objects(texture),
        **_sensors(views, resolution),
    }


def _mirror() -> dict[str, Any]:
    """The mirror, facing +z, and the wooden frame that backs it."""
    import mitsuba as mi

    middle = (MIRROR_BOTTOM + MIRROR_TOP) / 2
    half_width, half_height = MIRROR_WIDTH / 2, (MIRROR_TOP - MIRROR_BOTTOM) / 2
    at = mi.ScalarTransform4f().translate([0, middle, MIRROR_Z])
    behind = mi.ScalarTransform4f().translate([0, middle, MIRROR_Z - FRAME_GAP - FRAME_DEPTH])
    frame_size = [half_width + FRAME_BORDER, half_height + FRAME_BORDER, FRAME_DEPTH]
    return {
        "mirror": {
            "type": "rectangle",
            "to_world": at.scale([half_width, half_height, 1]),
            "bsdf": {
                "type": "principled",
                "base_color": {"type": "rgb", "value": [0.93, 0.93, 0.93]},
                "metallic": 1.0,
                "roughness": ROUGHNESS,
            },
        },
        "frame": {
            "type": "cube",
            "to_world": behind.scale(frame_size),
            "bsdf": _matt({"type": "rgb", "value": [0.20, 0.09, 0.04]}),
        },
    }


def _room() -> dict[str, Any]:
    """The floor, and the wall that the mirror hangs on."""
    import mitsuba as mi

    lying = mi.ScalarTransform4f().rotate([1, 0, 0], -90)
    behind_frame = MIRROR_Z - FRAME_GAP - 2 * FRAME_DEPTH - WALL_GAP
    upright = mi.ScalarTransform4f().translate([0, 2, behind_frame])
    return {
        "floor": {
            "type": "disk",
            "to_world": lying.scale([4, 4, 1]),
            "bsdf": _matt({"type": "rgb", "value": [0.15, 0.145, 0.14]}),
        },
        "wall": {
            "type": "rectangle",
            "to_world": upright.scale([6, 4, 1]),
            "bsdf": _matt({"type": "rgb", "value": [0.70, 0.68, 0.65]}),
        },
    }


def _objects(texture: int) -> dict[str, Any]:
    """Cat, globe and hen in a row, facing the mirror."""
    import mitsuba as mi

    cat = meshes.place(
        meshes.read_obj(library.asset("models/cat/cat.obj")), 0.9, turn=155, at=(-0.68, -0.15)
    )
    hen = meshes.place(
        meshes.read_obj(library.asset("models/chicken/chicken.obj")), 0.8, turn=205, at=(0.68, -0.1)
    )
    radius = 0.3
    # The sphere's poles lie on its own z axis.
    globe = mi.ScalarTransform4f().translate([0.02, radius, 0.0]).rotate([0, 0, 1], 20)
    globe = globe.rotate([1, 0, 0], -90).rotate([0, 0, 1], 100).scale(radius)
    return {
        "cat": meshes.shape("cat", cat, _painted("models/cat/cat-texture.jpg", texture, texture)),
        "hen": meshes.shape("hen", hen, _painted("models/chicken/chicken.jpg", texture, texture)),
        "globe": {
            "type": "sphere",
            "to_world": globe,
            "bsdf": _painted("textures/earth.jpg", texture, max(1, texture // 2)),
        },
    }


def _painted(relative: str, width: int, height: int) -> dict[str, Any]:
    return _matt(library.texture(library.picture(relative, width, height)))


def _matt(colour: dict[str, Any]) -> dict[str, Any]:
    """Matt on both sides: the hen's mesh is open, and its rear faces would be black."""
    material = {"type": "principled", "base_color": colour, "roughness": 1.0, "specular": 0.0}
    return {"type": "twosided", "bsdf": material}


def _sensors(views: int, resolution: int) -> dict[str, Any]:
    azimuths = np.linspace(-ARC, ARC, views) if views > 1 else [0.0]
    return {
        f"sensor_{view:03d}": perspective(
            orbit(LOOK_AT, DISTANCE, azimuth, ELEVATION), LOOK_AT, FIELD_OF_VIEW, resolution
        )
        for view, azimuth in enumerate(azimuths)
    }
