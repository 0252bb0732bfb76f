"""Materials, joint: a glass, a metal and a plastic object, whose roughness, colour and index are
unknown.

After *Physics Based Differentiable Rendering for Inverse Problems and Beyond* (Kakkar et al.;
PBDR), whose photographed objects are "composed of ordinary materials including glass, metal, and
plastic". The photographs are not published; these are stand-ins of ours, rendered: a ball of
frosted glass (its index and roughness unknown), a metal vase and a plastic bowl (colour and
roughness) on a plinth under a soft coloured sky: theirs stood "under regulated illumination", and a
sun through frosted glass is noise that hides all else. The plastic's index is known: Mitsuba keeps
no derivative by it.

The glass is frosted because a clear one bends every path by its index, which path replay does not
follow; through a rough one, paths keep their directions and change their weight.

Depth 6: camera, into the glass and out, two surfaces more, light.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from . import bowl, figures, meshes
from .cameras import spiral
from .lathe import turn
from .plinth import plinth

# (height, radius) of the vase's wall; it is a closed solid.
VASE = [(0.0, 0.2), (0.06, 0.25), (0.25, 0.31), (0.5, 0.25), (0.68, 0.14), (0.8, 0.2)]
BALL = 0.33


def build(views: int, resolution: int) -> dict[str, Any]:
    """Unknown, all of them a colour or a number: `glass.bsdf.eta`, `glass.bsdf.alpha.value`, and
    `base_color` and `roughness` of `metal` and `plastic`."""
    metal = {
        "type": "principled",
        "base_color": {"type": "rgb", "value": [0.9, 0.6, 0.35]},
        "metallic": 1.0,
        "roughness": 0.25,
    }
    plastic = {
        "type": "principled",
        "base_color": {"type": "rgb", "value": [0.12, 0.35, 0.2]},
        "roughness": 0.35,
    }
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 6},
        "sky": figures.sky(32),
        "glass": {
            "type": "sphere",
            "center": [-0.55, BALL + 1e-3, 0.2],
            "radius": BALL,
            "bsdf": {"type": "roughdielectric", "int_ior": 1.5, "ext_ior": 1.0, "alpha": 0.15},
        },
        "metal": meshes.shape("metal", _at(turn(_vase()), 0.1, -0.45), metal),
        "plastic": meshes.shape("plastic", _at(turn(0.75 * bowl.profile()), 0.5, 0.4), plastic),
        "plinth": plinth(1.05),
        **spiral(views, resolution, (0.0, 0.25, 0.0), 4.2, 28.0, (12.0, 50.0)),
    }


def _vase() -> np.ndarray:
    height, radius = np.array(VASE).T
    heights = np.linspace(0, height[-1], 60)
    wall = np.stack([PchipInterpolator(height, radius)(heights), heights], axis=1)
    return np.concatenate([[(0.0, 0.0)], wall, [(0.0, height[-1])]])


def _at(surface: meshes.Surface, x: float, z: float) -> meshes.Surface:
    return replace(surface, vertices=surface.vertices + np.float32([x, 1e-3, z]))
