"""Kirby: a round figure with limbs; where its vertices are is unknown, and they start as a sphere.

The image-space sampling paper's scene of this name (§5.2, Fig. 9): "16 images", 262 K pixels each,
under an environment map, from a sphere of 30 K vertices. Its model is not published, so the figure
here is made by formula: five ellipsoids (body, feet, arms). Matt and of one colour, so that nothing
but shading and outline tell the shape. Views lie on a spiral over several elevations: a ring of
cameras at one would leave top and bottom undetermined.

The sky is made by formula as well. The photographed skies of the other scenes have suns, which
would stand behind the figure in some view and hold nearly all of L2's residual: only the
silhouettes before them would move.

Direct light alone (depth 2): the figure is nearly convex, and its grooves are bright.
"""

from __future__ import annotations

from typing import Any

from . import figures
from .cameras import spiral

PARTS = (
    ((0.0, 0.0, 0.0), (0.8, 0.8, 0.8)),
    ((0.35, -0.72, 0.25), (0.32, 0.22, 0.45)),
    ((-0.35, -0.72, 0.25), (0.32, 0.22, 0.45)),
    ((0.82, 0.12, 0.0), (0.28, 0.22, 0.22)),
    ((-0.82, 0.12, 0.0), (0.28, 0.22, 0.22)),
)
COLOUR = [0.8, 0.55, 0.5]


def build(views: int, resolution: int, level: int) -> dict[str, Any]:
    """The scene with the true shape; unknown: `figure.vertices`, 10 4^`level` + 2 of them."""
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sky": figures.sky(16),
        "figure": figures.figure("figure", PARTS, level, COLOUR),
        **spiral(views, resolution, (0.0, -0.05, 0.0), 4.0, 35.0, (-35.0, 65.0), azimuth=15.0),
    }
