"""Whether masks and alpha are about the object: its points against what counts in each picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...scenes.meshes import Surface

if TYPE_CHECKING:
    from .importing import Photograph

# Points of the surface that are looked for; a share of those in the picture below which masks are
# doubted, and one that inverted masks would have at least.
_POINTS, _DOUBTED, _INVERTED = 2000, 0.3, 0.8
# What an alpha or mask is at least, or at most, that is the same everywhere.
_FULL, _EMPTY = 0.99, 0.01


def empty(part: np.ndarray) -> bool:
    """Whether a picture shows nothing of the object. ``part``: how much of each pixel it fills."""
    return not (part > _EMPTY).any()


def doubts(photographs: "list[Photograph]", surface: Surface | None) -> list[str]:
    """What should be said."""
    found = []
    full = [p for p in photographs if p.part is not None and (p.part >= _FULL).all()]
    if full:
        found.append(
            f"photos.background=black: by alpha or masks the object fills all of {len(full)} of "
            f"{len(photographs)} pictures, first {full[0].camera.image}: if it does not, what is "
            "behind it counts as the object"
        )
    masked = [
        p for p in photographs if p.part is not None or p.lost.get("masked by its file") is not None
    ]
    if surface is None or not masked:
        return found
    rng = np.random.default_rng(0)
    points = surface.vertices[rng.integers(0, len(surface.vertices), _POINTS)].astype(np.float64)
    shares = [share for each in masked if (share := _met(each, points)) is not None]
    if not shares or np.median(shares) >= _DOUBTED:
        return found
    inverted = [1 - share for share in shares]
    told = f"of the object's points only {np.median(shares):.0%} lie where they are white"
    if np.median(inverted) >= _INVERTED:
        found.append(f"masks look inverted: {told}, and white is what counts; or it lies elsewhere")
    else:
        found.append(f"masks hide most of the object: {told}")
    return found


def _met(photograph: "Photograph", points: np.ndarray) -> float | None:
    """The share of the object's points in the picture that lie where it counts; None of none."""
    camera = photograph.camera
    place, depth = camera.project(points)
    inside = (depth > 0) & (place >= 0).all(axis=1)
    inside &= (place < [camera.width, camera.height]).all(axis=1)
    if not inside.any():
        return None
    column, row = place[inside].astype(int).T
    counts = photograph.mask if photograph.part is None else photograph.part
    return float((counts[row, column] > 0.5).mean())
