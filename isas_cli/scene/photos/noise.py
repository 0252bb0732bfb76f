"""How noisy photographs are, as far as they tell it themselves.

Of two of one camera that stands still, by their difference. Of one alone, by its flattest blocks:
second differences both ways (Immerkær 1996) leave neither slopes nor edges along an axis, and what
they leave of white noise is as strong as the noise. Files that forget fine differences on purpose
(JPEG, HEIC) tell too little that way, and are not asked.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import minimum_filter

from ...runtime import heif

if TYPE_CHECKING:
    from .camera import Photograph

LOSSY = (".jpg", ".jpeg", ".jpe", *heif.ENDINGS, ".avif", ".webp", ".jp2")
# The root of the sum of squares of second differences both ways, (1, -2, 1) times (1, -2, 1).
_GAIN = 6.0
# Sides of blocks, how many there must be, and into how many groups by brightness they go at most,
# as noise grows with it; the flattest of a group by share, and what such a block of white noise has
# of its variance (tests/scene/test_photo_noise.py).
_BLOCK, _FEWEST, _GROUPS, _FLAT, _OF_FLAT = 8, 40, 9, 0.1, 0.74
# Of a normal number, over the median of its size.
_NORMAL = 1.4826


def of_one(image: np.ndarray, mask: np.ndarray) -> float | None:
    """Variance of a pixel of ``image (H, W, 3)``, the channels' mean, where ``mask (H, W)`` is
    above 0: the median over parts alike in brightness, of each by its flattest blocks; None where
    there are too few. A photograph that is nowhere flat has less than this."""
    height, width = ((size - 2) // _BLOCK * _BLOCK for size in image.shape[:2])
    if height <= 0 or width <= 0:
        return None
    left = np.diff(np.diff(image, 2, axis=0), 2, axis=1)[:height, :width] / _GAIN
    squares = np.square(left).mean(axis=2, dtype=np.float64)
    # Where all that a difference is of counts.
    inner = np.s_[1 : 1 + height, 1 : 1 + width]
    counts = minimum_filter(mask, 3)[inner] > 0
    shape = height // _BLOCK, _BLOCK, width // _BLOCK, _BLOCK
    whole = counts.reshape(shape).all(axis=(1, 3))
    found = squares.reshape(shape).mean(axis=(1, 3))[whole]
    if found.size < _FEWEST:
        return None
    bright = image[inner].mean(axis=2).reshape(shape).mean(axis=(1, 3))[whole]
    groups = np.array_split(found[np.argsort(bright)], min(_GROUPS, found.size // _FEWEST))
    return float(np.median([np.quantile(each, _FLAT) for each in groups])) / _OF_FLAT


def of_two(first: "Photograph", second: "Photograph") -> float | None:
    """The same of two photographs of one camera, in units of radiance: what moves between them
    counts little. None where no pixel counts in both, or the cameras are not the same."""
    a, b = first.camera, second.camera
    if not np.array_equal(a.to_world, b.to_world):  # before all that is dear
        return None
    same = (a.fx, a.fy, a.cx, a.cy) == (b.fx, b.fy, b.cx, b.cy)
    if first.image.shape != second.image.shape or not same:
        return None
    both = (first.mask > 0) & (second.mask > 0)
    if not both.any():
        return None
    apart = first.image[both] / a.exposure - second.image[both] / b.exposure
    deviations = _NORMAL * np.median(np.abs(apart), axis=0)
    return float(np.mean(deviations**2)) / 2


def of_all(photographs: "Sequence[Photograph]") -> tuple[float | None, str]:
    """Standard deviation of a pixel, root mean square over the photographs, in units of radiance,
    and how it was found; or None, and why it is not known."""
    found = []
    for index, first in enumerate(photographs):
        for second in photographs[index + 1 :]:
            if (variance := of_two(first, second)) is not None:
                found.append(variance)
    if found:
        pairs = "pair" if len(found) == 1 else "pairs"
        return float(np.sqrt(np.mean(found))), f"from {len(found)} {pairs} of one camera"
    known = [
        p.variance / np.mean(np.square(p.camera.exposure))
        for p in photographs
        if p.variance is not None
    ]
    if known:
        some = "" if len(known) == len(photographs) else f" of {len(known)} photographs"
        return float(np.sqrt(np.mean(known))), f"in the flattest parts{some}"
    if any(p.camera.image.suffix.lower() in LOSSY for p in photographs):
        return None, "JPEG and its like leave fine noise out, and no camera took two pictures"
    return None, "no photograph has enough flat parts, and no camera took two pictures"
