"""Shadows as the authors of PRDPT publish it: a ball outside the view is found from its shadow.

Meshes, texture and numbers are those of their public code (assets/models/prdpt_shadows): the
places of camera and lamp, the materials, the unknown and where it starts. `shadows` poses the same
problem with other things.

Depth 6, as theirs: light that the ball throws back onto the ground counts.
"""

from __future__ import annotations

from typing import Any

from . import library

_FOLDER = "models/prdpt_shadows"
PLACE = [-1.5, 1.0]  # of the ball, along y and z
DEPTH = 6


def build(width: int) -> dict[str, Any]:
    """The scene with the ball at its true place; unknown: the pose `ball.place`, y and z."""
    import mitsuba as mi

    to = mi.ScalarTransform4f()
    film = {"type": "hdrfilm", "width": width, "height": width * 3 // 4, "pixel_format": "rgb"}
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": DEPTH},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.6, 0.6, 0.99]}},
        "lamp": {
            "type": "point",
            "position": [25.97522, 13.7758, 0.0],
            "intensity": {"type": "rgb", "value": 1715.0},
        },
        "ground": {
            "type": "ply",
            "filename": str(library.asset(f"{_FOLDER}/Plane.ply")),
            "face_normals": True,
            "bsdf": {
                "type": "plastic",
                "diffuse_reflectance": {
                    "type": "bitmap",
                    "filename": str(library.asset(f"{_FOLDER}/grid_50.png")),
                },
                "specular_reflectance": {"type": "rgb", "value": 0.0},
            },
        },
        "ball": {
            "type": "ply",
            "filename": str(library.asset(f"{_FOLDER}/Sphere_001.ply")),
            "face_normals": True,
            "to_world": to.translate([0.0, *PLACE]),
            "bsdf": {
                "type": "twosided",
                "material": {
                    "type": "principled",
                    "base_color": {"type": "rgb", "value": [0.8, 0.261964, 0.041545]},
                    "roughness": 0.5,
                    "specular": 0.5,
                },
            },
        },
        "sensor_000": {
            "type": "perspective",
            "fov": 39.597755,
            "fov_axis": "x",
            "to_world": to.translate([17.658024, 0, 0]).rotate([0, 1, 0], -90),
            "film": {**film, "rfilter": {"type": "box"}},
        },
    }
