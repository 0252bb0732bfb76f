"""Cup: a mug is turned about its axis until its handle shows on the right side.

The paper's task (PRDPT, cup): "A mug is rotated around its vertical axis and as its handle gets
occluded, the optimization has reached a plateau." Start 180°, target 0° (its follow-up: 20 starts
from 180.4° to 199.2°).

Ours: the mug `coffee-mug`, whose handle points to the right at 0°, to the back at 90°, where the
body hides it, and to the left at 180°. The start is 170° (trials: 161° to 179°): the shorter way
leads through the hidden part. An angle is compared modulo 360°, as both ways end in the same image.

What differs: model, light and camera are ours. The ground and one matt material.

Depth 3: camera, mug, ground, light. What a longer path would add (light between mug and ground more
than once) tells nothing about the handle.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from . import library, meshes
from .cameras import orbit
from .stage import camera, ground, matt, shared

# Of the model: the body's axis stands at this z, off the middle of the box around it all.
AXIS, HEIGHT = -0.124, 0.7617


def build(width: int) -> dict[str, Any]:
    """The scene at the true angle; unknown: the pose `cup.angle`, degrees."""
    import mitsuba as mi

    to = mi.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 3},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.35}},
        "lamp": {
            "type": "rectangle",
            "to_world": to().look_at(origin=[-2.5, 4, 2.5], target=[0, 0, 0], up=[0, 1, 0]),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 9.0}},
        },
        "ground": ground(3.0, matt([0.42, 0.40, 0.38])),
        "mug": meshes.shape("mug", _mug(), {"type": "twosided", "bsdf": matt([0.62, 0.16, 0.11])}),
        "sensor_000": camera(orbit((0, 0.42, 0), 4.2, 0.0, 24.0), (0.0, 0.42, 0.0), 32.0, width),
    }


def _mug() -> meshes.Surface:
    """One unit high, the axis of its body at x = z = 0, its handle towards +x."""
    path = library.asset("models/coffee-mug/coffee-mug.obj")
    surface = shared(meshes.read_obj(path, textured=False, flat=True))
    turn = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # +z to +x
    moved = surface.vertices - [0, surface.vertices[:, 1].min(), AXIS]
    return replace(
        surface,
        vertices=(moved / HEIGHT @ turn.T).astype(np.float32),
        normals=(surface.normals @ turn.T).astype(np.float32),
    )
