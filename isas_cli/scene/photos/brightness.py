"""Whether photographs were exposed unlike, by how bright they show the same places of the object.

A surface that is not glossy is as bright from all sides, if light and object stand still. Of each
two views the median over the places that both show says how much brighter one is; the median
deviation from it, how sure that is. One exposure a view has to account for all pairs.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ...scenes.meshes import Surface
from . import outlines
from .importing import Photograph

# Places that two views must share, and about how many lie in a cell of the depths that say what
# hides what.
_SHARED, _IN_CELL = 50, 8
# Of a normal number's deviations, over their median; how many of these the views must lie apart,
# and by which factor at least; what of all pairs exposures must account for.
_NORMAL, _SURE, _APART, _TOLD = 1.4826, 3.0, 1.25, 0.9
_MOST = 40  # views that are compared, evenly among them


def unlike(photographs: list[Photograph], surface: Surface) -> tuple[float, str, str] | None:
    """How many times as bright the brightest view shows the object as the darkest, and their names;
    None where they are alike, or nothing is sure."""
    chosen = np.unique(np.linspace(0, len(photographs) - 1, min(_MOST, len(photographs))).round())
    views = [photographs[int(number)] for number in chosen]
    points = outlines.scattered(surface)
    logs = np.stack([_seen(each, points) for each in views])
    rows, apart, deviation = [], [], []
    for a, b in combinations(range(len(views)), 2):
        ratios = logs[a] - logs[b]
        ratios = ratios[np.isfinite(ratios)]
        if ratios.size < _SHARED:
            continue
        row = np.zeros(len(views))
        row[a], row[b] = 1, -1
        rows.append(row)
        apart.append(np.median(ratios))
        deviation.append(_NORMAL * np.median(np.abs(ratios - apart[-1])))
    if not rows:
        return None
    # Of parts that no pair connects, each has its own zero.
    pairs, apart = np.stack(rows), np.array(apart)
    exposures, _, rank, _ = np.linalg.lstsq(pairs, apart, rcond=None)
    left = apart - pairs @ exposures
    if rank < len(views) - 1 or np.sum(left**2) > (1 - _TOLD) * np.sum(apart**2):
        return None
    low, high = int(exposures.argmin()), int(exposures.argmax())
    factor = exposures[high] - exposures[low]
    if factor < max(np.log(_APART), _SURE * float(np.median(deviation))):
        return None
    return float(np.exp(factor)), views[high].camera.name, views[low].camera.name


def _seen(photograph: Photograph, points: np.ndarray) -> np.ndarray:
    """The logarithm of how bright each point is, at exposure 1; NaN where it is not seen."""
    camera = photograph.camera
    place, depth = camera.project(points)
    found = np.full(len(points), np.nan)
    inside = (depth > 0) & (place >= 0).all(axis=1)
    inside &= (place < [camera.width, camera.height]).all(axis=1)
    if not inside.any():
        return found
    place, depth = place[inside], depth[inside]
    side = max(1.0, np.sqrt(np.prod(np.ptp(place, axis=0)) * _IN_CELL / len(place)))
    column, row = (place // side).astype(np.int64).T
    cell = row * (int(camera.width // side) + 1) + column
    nearest = np.full(cell.max() + 1, np.inf)
    np.minimum.at(nearest, cell, depth)
    # A cell's own slope is not taken for something behind it.
    before = depth <= nearest[cell] + 2 * side * depth / camera.fx
    across, down = place.astype(np.int64).T
    light = photograph.image[down, across] / np.asarray(camera.exposure)
    bright = light.mean(axis=1)
    known = before & (photograph.mask[down, across] > 0) & (bright > 0)
    values = np.full(len(place), np.nan)
    values[known] = np.log(bright[known])
    found[inside] = values
    return found
