"""Sort: 75 coloured cubes, scattered, are to be put into three groups by colour.

The paper's task (PRDPT, sort): "we need to sort a randomly perturbed assortment of 75 colored
primitives into disjoint sets. We optimize the x- and y-coordinates of each cube, which leads to a
150-dimensional setting, with a plateau in each dimension, as most of the cubes are initially not
overlapping their reference."

Ours: cubes on a pale ground, seen from above; each colour has a square of 5 × 5 places. The unknown
is how far each cube is from its place. Cubes of one colour are alike, so that an image does not
tell which of them stands where: the error of the parameters counts a cube that stands at another's
place as wrong.

What differs: the paper's cubes and their places are not published.

A cube is felt near by only, by what it hides, its shadow and the sky that it keeps from the ground.
The configured reach of 0.3 leaves out what little is felt farther away: of a slope, in the root
mean square, 1.7 % at a run's scattered start and 2.5 % after six tenths of its budget.

Depth 2: direct light. What cubes throw at each other is not simulated, nor in the targets.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import meshes
from .stage import boxes, camera, ground, matt

SIDE, GAP = 0.11, 0.2  # of a cube, and between the middles of two neighbours
COLOURS = ([0.62, 0.07, 0.06], [0.08, 0.45, 0.10], [0.07, 0.13, 0.60])
GROUPS = ((-0.75, -0.5), (0.75, -0.5), (0.0, 0.65))


def places() -> np.ndarray:
    """Where the cubes belong, (75, 2): x and z, group after group."""
    steps = GAP * (np.arange(5) - 2)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    return np.concatenate([grid + group for group in GROUPS])


def build(width: int) -> dict[str, Any]:
    """The scene with all cubes in their places; unknown: the pose `cubes.place`, 75 × (x, z)."""
    import mitsuba as mi

    to = mi.ScalarTransform4f
    xz = places()
    middles = np.stack([xz[:, 0], np.full(len(xz), SIDE / 2 + 1e-3), xz[:, 1]], axis=1)
    surface = boxes(middles, (SIDE / 2,) * 3)
    material = {**matt(0.5), "base_color": {"type": "mesh_attribute", "name": "vertex_colour"}}
    colours = np.repeat(np.asarray(COLOURS, np.float32), 25 * 24, axis=0)
    cubes = meshes.shape("cubes", surface, material, colours)
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.6}},
        "lamp": {
            "type": "rectangle",
            "to_world": to().look_at(origin=[-2.5, 5, 1.5], target=[0, 0, 0], up=[0, 1, 0]),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 6.0}},
        },
        "ground": ground(4.0, matt(0.75)),
        "cubes": cubes,
        "sensor_000": camera([0.0, 5.0, 0.6], (0.0, 0.0, 0.05), 34.0, width),
    }
