"""Whether the object's outline lies on edges of the pictures, as it does where the mesh is right.

Pictures change across it: from the object to what is behind it, whatever either looks like. That is
so of mirrors, too, which no two views show alike. An outline that lies no better than when it is
moved or grown a little is not the object's.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from ...scenes.meshes import Surface
from .camera import Camera
from .importing import Photograph

# Pixels, to about which a picture is made small; and within which edges are smoothed, looked for.
_LARGE, _SMOOTH, _NEAR = 160, 0.8, 1
# Places along an outline, and how many of them must lie in the picture.
_PLACES, _FEWEST = 400, 40
# How far outlines are moved, in all directions, and by what they grow, in their own sizes.
_MOVED, _WAYS, _GROWN = (0.08, 0.16), 12, (0.8, 0.9, 1.1, 1.25)
_TRIED = 10  # of these at least
# Of a picture's brightness, what is dark; of its changes, those that are edges.
_DARK, _EDGE = 0.05, 80


def ranks(photographs: list[Photograph], surface: Surface) -> np.ndarray:
    """Of each view the share of moved outlines that lie worse than its own, ``(V,)``; NaN where too
    little of these is in the picture."""
    outline = Outline(surface)
    return np.array([_rank(each, outline) for each in photographs])


def _rank(photograph: Photograph, outline: Outline) -> float:
    changes, by = _changes(photograph.image)
    lines = outline.seen(photograph.camera) / by
    way = lines[:, 1] - lines[:, 0]
    long = np.linalg.norm(way, axis=1)
    total = np.cumsum(long)
    if not total.size or not 0 < total[-1] < np.inf:
        return np.nan
    at = (np.arange(_PLACES) + 0.5) / _PLACES * total[-1]
    line = np.searchsorted(total, at)
    share = 1 - (total[line] - at) / long[line]
    place = lines[line, 0] + share[:, None] * way[line]
    across = way[line][:, ::-1] * [-1, 1] / long[line, None]
    own = _lies(changes, place, across)
    size, middle = np.ptp(place, axis=0).mean(), place.mean(axis=0)
    size = min(size, max(changes.shape[1:3]))
    angles = 2 * np.pi * np.arange(_WAYS) / _WAYS
    others = [
        place + far * size * np.array([np.cos(angle), np.sin(angle)])
        for angle in angles
        for far in _MOVED
    ]
    others += [middle + factor * (place - middle) for factor in _GROWN]
    found = np.array([_lies(changes, other, across) for other in others])
    found = found[np.isfinite(found)]
    return float((found < own).mean()) if np.isfinite(own) and len(found) >= _TRIED else np.nan


def _changes(image: np.ndarray) -> tuple[np.ndarray, int]:
    """How the logarithms of a picture made smaller change down and across, ``(2, H, W, 3)``, over
    what an edge is; and by what it was made smaller."""
    by = max(1, round(max(image.shape[:2]) / _LARGE))
    high, wide = (number // by for number in image.shape[:2])
    blocks = image[: high * by, : wide * by].reshape(high, by, wide, by, 3).mean(axis=(1, 3))
    # Vivid colours of wider gamuts are below 0 in ours.
    logs = np.log(np.maximum(blocks, 0) + _DARK * blocks.mean() + 1e-9)
    found = np.stack(
        [gaussian_filter(logs, (_SMOOTH,) * 2 + (0,), (*o, 0)) for o in ((1, 0), (0, 1))]
    )
    edge = np.percentile(np.sqrt((found**2).sum(axis=(0, 3))), _EDGE)
    return found / (edge + 1e-9), by


def _lies(changes: np.ndarray, place: np.ndarray, across: np.ndarray) -> float:
    """The mean, over an outline, of how much pictures change across it: 0, nothing, to 1."""
    inside = ((place >= 0.5) & (place <= np.array(changes.shape[2:0:-1]) - 0.5)).all(axis=1)
    if inside.sum() < _FEWEST:
        return np.nan
    place, across = place[inside], across[inside]
    most = np.zeros(len(place))
    for step in range(-_NEAR, _NEAR + 1):
        at = (place + step * across)[:, ::-1].T - 0.5
        down, right = (
            np.stack([map_coordinates(of[..., k], at, order=1, mode="nearest") for k in range(3)])
            for of in changes
        )
        most = np.maximum(most, np.linalg.norm(right * across[:, 0] + down * across[:, 1], axis=0))
    return float((most / (most + 1)).mean())


class Outline:
    """The edges of a mesh and the triangles at each, of which some are its outline."""

    def __init__(self, surface: Surface):
        # Vertices of a seam differ by their rounding.
        size = np.ptp(surface.vertices, axis=0).max()
        rounded = np.round(surface.vertices / size, 6)
        _, first, number = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
        self.places = surface.vertices[first].astype(np.float64)
        faces = number.ravel()[surface.faces]
        pairs = [faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]
        ends = np.sort(np.concatenate(pairs), axis=1)
        self.ends, of = np.unique(ends, axis=0, return_inverse=True)
        self._of, self._faces = of.ravel(), faces
        self._count = np.bincount(self._of)

    def seen(self, camera: Camera) -> np.ndarray:
        """Edges between a triangle that faces the camera and one that does not, and open ends:
        ``(E, 2, 2)`` pixels. What lies before them is not asked."""
        a, b, c = (self.places[self._faces[:, corner]] for corner in range(3))
        towards = np.sign(np.einsum("fk,fk->f", np.cross(b - a, c - a), camera.centre - a))
        total = np.bincount(self._of, weights=np.tile(towards, 3))
        border = (self._count == 1) | (np.abs(total) < self._count)
        pixels, depth = camera.project(self.places)
        ends = self.ends[border]
        return pixels[ends[(depth[ends] > 0).all(axis=1)]]
