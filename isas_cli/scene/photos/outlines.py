"""Whether masks and alpha are about the object: its points against what counts in each picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...scenes.meshes import Surface

if TYPE_CHECKING:
    from .importing import Photograph

# Points of a surface that are looked for in each picture.
_POINTS = 4000
# A share of those in the picture below which masks are doubted, and one that inverted masks would
# have at least.
_DOUBTED, _INVERTED = 0.3, 0.8
# What an alpha or mask is at least, or at most, that is the same everywhere.
_FULL, _EMPTY = 0.99, 0.01


def scattered(surface: Surface) -> np.ndarray:
    """Points of a surface, evenly by its area, ``(_POINTS, 3)``; always the same."""
    rng = np.random.default_rng(0)
    a, b, c = (surface.vertices[surface.faces[:, k]].astype(np.float64) for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = rng.choice(len(area), _POINTS, p=area / area.sum())
    u, v = rng.random((2, _POINTS, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen]


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
    points = scattered(surface)
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
    return float((counts[row, column] > 0.5 * counts.max()).mean())
