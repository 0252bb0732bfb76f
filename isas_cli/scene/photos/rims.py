"""Whether masks end where the object does: where pictures change most, across a mask's border."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import map_coordinates
from skimage.measure import find_contours

from ...runtime import images
from . import turns

if TYPE_CHECKING:
    from .camera import Camera

# Views that are asked, points of a border, and how many are too few; how far from it is looked, as
# a share of the mask's size and in pixels at least.
_ASKED, _POINTS, _FEWEST = 6, 4000, 200
_FAR, _PIXELS = 0.03, 8
# What is black counts as so bright, as a share of what is brightest.
_BLACK = 0.02
# How many times as much pictures change there as at the border itself; pixels, and a share of the
# mask's size, that are too little to tell; and how many of the views must say so, and how exactly.
_CLEAR, _OFF, _LITTLE = 1.5, 1.5, 0.003
_MOST, _SAME = 0.7, 1.5


def doubts(cameras: list[Camera], over: set[str], across: set[str]) -> list[str]:
    """What should be said of the masks or alpha of ``cameras``, which end the object; ``over``:
    names of those whose pictures are turned; ``across``: see ``turns.across``."""
    ended = [each for each in cameras if not each.hides]
    asked = ended[:: max(1, -(-len(ended) // _ASKED))]
    found = [_of_view(c, c.name in over, c.name in across) for c in asked]
    found = [each for each in found if each is not None]
    if not found:
        return []
    offs, sizes = np.transpose(found)
    off = float(np.median(offs))
    alike = np.mean(np.abs(offs - off) <= _SAME)
    if abs(off) < max(_OFF, _LITTLE * np.median(sizes)) or alike < _MOST or len(offs) < 2:
        return []
    where, how, size = ("within", "grow", "small") if off < 0 else ("beyond", "shrink", "large")
    return [
        f"masks or alpha end about {abs(off):.2g} pixels {where} the edges that pictures show: "
        f"{how} them by as much, or the object is found too {size}, and its rim in the colours of "
        "what is beside that"
    ]


def _of_view(camera: Camera, turned: bool, across: bool) -> tuple[float, float] | None:
    """``off`` of a view, and the size of its mask in pixels; None where that cannot be told."""
    given = (
        images.read_alpha(camera.image, turned)
        if camera.mask is None
        else turns.mask(camera.mask, camera.image, turned, across)
    )
    picture = images.load(camera.image, finite=False, turned=turned).image
    if given is None or given.shape != picture.shape[:2]:
        return None
    mask = given > 0.5
    size = float(np.sqrt(mask.sum()))
    found = off(picture, mask)
    return None if found is None else (found, size)


def off(picture: np.ndarray, mask: np.ndarray) -> float | None:
    """How many pixels the border of a ``mask (H, W) bool`` lies outside of where the ``picture (H,
    W, 3)`` changes most across it, negative inside; None where too little of it is in the picture.
    By medians over the border: texture and clutter are nowhere in particular."""
    far = max(_PIXELS, round(_FAR * np.sqrt(mask.sum())))
    places, inwards = [], []
    for line in find_contours(mask.astype(np.float32), 0.5):
        if len(line) < 4 * _PIXELS or not np.allclose(line[0], line[-1]):
            continue  # a speck, or cut off by the picture
        line = line[:-1]
        along = np.roll(line, -3, axis=0) - np.roll(line, 3, axis=0)
        normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-6)
        at = np.clip((line + 2 * normal).round().astype(int), 0, np.array(mask.shape) - 1)
        # Contours go round all alike.
        normal *= 1 if mask[tuple(at.T)].mean() > 0.5 else -1
        places.append(line)
        inwards.append(normal)
    if not places:
        return None
    places, inwards = np.concatenate(places), np.concatenate(inwards)
    inside = ((places > far) & (places < np.array(mask.shape) - 1 - far)).all(axis=1)
    places, inwards = places[inside], inwards[inside]
    step = max(1, len(places) // _POINTS)
    places, inwards = places[::step], inwards[::step]
    if len(places) < _FEWEST:
        return None
    light = np.nan_to_num(picture.mean(axis=2))
    light = np.log(np.maximum(light, 0) + _BLACK * max(float(light.max()), 1e-6))
    steps = np.arange(-far - 0.5, far + 1)
    across = places[:, :, None] + inwards[:, :, None] * steps
    seen = map_coordinates(light, across.transpose(1, 0, 2), order=1, mode="nearest")
    change = np.median(np.abs(np.diff(seen, axis=1)), axis=0)
    most = int(change.argmax())
    return float(most - far) if change[most] > _CLEAR * change[far] else 0.0
