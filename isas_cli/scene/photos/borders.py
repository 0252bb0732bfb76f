"""Black along the borders of pictures, as programs leave it that take a lens out of them."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import label, minimum_filter

from ...scenes.meshes import Surface
from .outlines import scattered

if TYPE_CHECKING:
    from .importing import Photograph

# Views that are asked at most, and that must be alike at least; light that is none: what a JPEG
# leaves of black.
_ASKED, _FEWEST, _BLACK = 12, 3, 1e-3
# Of views, how many must be black at a place; of what is black in any, what must be so in these; of
# a picture, what a rim is at most. A background is larger, and of another shape in each view.
_IN, _ALIKE, _RIM = 0.9, 0.8, 0.3
# Pixels that the object must reach into it, and of its points, how many.
_INTO, _REACHED = 2, 0.01


def doubts(photographs: "list[Photograph]", surface: Surface | None) -> list[str]:
    """What should be said of pictures without alpha and masks: that the object goes on where they
    are black, alike in all views, which counts as its colour."""
    out = "masked by its file", "transparent"
    bare = [p for p in photographs if p.part is None and not any(map(p.lost.get, out))]
    if surface is None or len(bare) < _FEWEST:
        return []
    ((shape, _),) = Counter(p.image.shape for p in bare).most_common(1)
    alike = [p for p in bare if p.image.shape == shape]
    alike = alike[:: -(-len(alike) // _ASKED)]
    dark = [_black(p) for p in alike]
    rim = np.mean(dark, axis=0) >= _IN
    if (
        len(alike) < _FEWEST
        or not _ALIKE * np.any(dark, axis=0).sum() < rim.sum() < _RIM * rim.size
    ):
        return []
    points, deep = scattered(surface), minimum_filter(rim, 2 * _INTO + 1)
    reached = [p for p in alike if _within(p, points, deep) >= _REACHED]
    if len(reached) < len(alike) / 2:
        return []
    return [
        f"pictures are black along their borders, alike in all views, and the object goes on there "
        f"in {len(reached)} of {len(alike)}, first {reached[0].camera.name}: undistortion leaves "
        "that, and it counts as what the object looks like: give masks that are black there"
    ]


def _black(photograph: "Photograph") -> np.ndarray:
    """Where a picture is black from its border on, and counts."""
    dark = (photograph.image <= _BLACK).all(axis=2)
    border = np.concatenate([dark[0], dark[-1], dark[:, 0], dark[:, -1]])
    if not border.any():
        return np.zeros_like(dark)
    parts, _ = label(dark)
    outer = np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]])
    return np.isin(parts, outer[outer > 0]) & (photograph.mask > 0)


def _within(photograph: "Photograph", points: np.ndarray, rim: np.ndarray) -> float:
    """Of the object's points in a picture, the share that lies in its ``rim``."""
    place, _, inside = photograph.camera.seen(points)
    column, row = place[inside].astype(int).T
    return float(rim[row, column].mean()) if len(row) else 0.0
