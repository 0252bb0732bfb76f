"""Dodoco_b: a matt figure in the open; where its vertices are is unknown, and start as a sphere.

The image-space sampling paper's scene of this name (§5.2, Fig. 9): 16 images of 262 K pixels under
an environment map, from a sphere of 30 K vertices. Its model is not published, so the figure here
is made by formula: ten ellipsoids (body, head, cap, ears, arms, feet, tail). It has what `kirby`
lacks: thin parts, and grooves between them that light reaches over several surfaces. Sky and
cameras are as there.

First it stood on a plate, with cameras above that. Then every sampler ended without feet: the
sphere's underside, in the shade, is darker than both the plate that it would cover and the feet
that ought to be there, so that growing makes the images worse. That is a property of L2 and of the
start, not of a sampler, and the plate went.

Depth 3: the figure lights itself in its grooves.
"""

from __future__ import annotations

from typing import Any

from . import figures
from .cameras import spiral

PARTS = (
    ((0.0, -0.3, 0.0), (0.5, 0.5, 0.45)),
    ((0.0, 0.32, 0.05), (0.58, 0.45, 0.5)),
    ((0.0, 0.72, -0.05), (0.3, 0.3, 0.3)),
    ((0.42, 0.78, 0.0), (0.14, 0.36, 0.1)),
    ((-0.42, 0.78, 0.0), (0.14, 0.36, 0.1)),
    ((0.55, -0.3, 0.15), (0.24, 0.13, 0.15)),
    ((-0.55, -0.3, 0.15), (0.24, 0.13, 0.15)),
    ((0.25, -0.8, 0.2), (0.2, 0.16, 0.3)),
    ((-0.25, -0.8, 0.2), (0.2, 0.16, 0.3)),
    ((0.0, -0.45, -0.55), (0.16, 0.2, 0.25)),
)
COLOUR = [0.75, 0.65, 0.45]


def build(views: int, resolution: int, level: int) -> dict[str, Any]:
    """The scene with the true shape; unknown: `figure.vertices`, 10 4^`level` + 2 of them."""
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 3},
        "sky": figures.sky(16),
        "figure": figures.figure("figure", PARTS, level, COLOUR),
        **spiral(views, resolution, (0.0, -0.05, 0.0), 4.0, 36.0, (-35.0, 65.0), azimuth=15.0),
    }
