"""Whether numbers of 32 bits, which a renderer has, tell places apart so far from the origin, and
whether rays leave the object near its surface."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...scenes.meshes import Surface
from ..ray_offset import above

if TYPE_CHECKING:
    from .importing import Photograph

# Pixels by which places may lie off.
_OFF = 0.25


def doubts(photographs: "list[Photograph]", surface: Surface | None) -> list[str]:
    """What should be said: maps and scanners count from an origin as far away as the equator, where
    a mesh's vertices fall on a coarse grid and its shape is another."""
    if surface is None:
        return []
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    middle = (low.astype(np.float64) + high) / 2
    far = np.abs(middle).max()
    size = float(np.linalg.norm(high.astype(np.float64) - low))
    told = above(size, float(far), "the mesh and all cameras")
    found = [f"the object {told[1]}"] if told else []
    off = [_step(each, middle) for each in photographs]
    if not off or np.median(off) <= _OFF:
        return found
    return found + [
        f"the object lies {far:.3g} units from the origin, where numbers of 32 bits, which a "
        f"renderer has, are {np.spacing(np.float32(far)):.2g} units apart, {np.median(off):.2g} "
        "pixels of the pictures: its shape and the poses are off by as much; take one offset from "
        "the mesh and from all cameras, so that they lie around the origin"
    ]


def _step(photograph: "Photograph", middle: np.ndarray) -> float:
    """How many of its pixels two neighbouring numbers lie apart, at the object."""
    camera = photograph.camera
    largest = max(np.abs(middle).max(), np.abs(camera.centre).max())
    depth = max(float(np.linalg.norm(camera.centre - middle)), 1e-30)
    return float(np.spacing(np.float32(largest))) * camera.fx / depth
