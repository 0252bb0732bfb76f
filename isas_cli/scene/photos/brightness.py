"""How unlike photographs were exposed, by how bright they show the same places of the object.

A surface that is not glossy is as bright from all sides, if light and object stand still. Of each
two views the median over the places that both show says how much brighter one is; the median
deviation from it, how sure that is. One exposure a view has to account for all pairs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import lsqr

from ...scenes.meshes import Surface
from . import outlines
from .importing import Photograph

# Places that two views must share, and about how many lie in a cell of the depths that say what
# hides what.
_SHARED, _IN_CELL = 50, 8
# Of a normal number's deviations, over their median; how many of these the views must lie apart,
# and by which factor at least; what of all pairs exposures must account for.
_NORMAL, _SURE, _APART, _TOLD = 1.4826, 3.0, 1.25, 0.9
_TINTED = 1.1  # the same of a colour beside green
# Places seen from the side, at a smaller cosine, are taken for others, and those that look away are
# hidden; exposures are known to this share at best, and at worst where they are said to be told.
_ASLANT, _NEAR, _VAGUE = 0.2, 0.01, 0.2
# Views that a place must be in; what of its variance a light that goes with the camera must account
# for (of a box on a turntable it is 0.9, of 70 sets whose light stands still at most 0.3, of glossy
# balls), and by how much of its brightness.
_OFTEN, _GOES, _LIT = 3, 0.6, 0.1
# The same of what a lens does, by how much of a place's brightness it must, and within which
# factors halves of the views must say it alike.
_FALLS, _FALLEN, _ALIKE = 0.2, 0.03, (0.5, 2.0)
_MOST = 40  # views that all others are compared with, evenly among them


@dataclass(frozen=True)
class Apart:
    """``exposures (V,)``: their logarithms, of mean 0; ``deviation``: of a place's, between two
    views; ``share``: of what pairs of views tell that these account for; ``doubt``: the standard
    deviation of what a pair tells from these, infinite where so few hardly check each other."""

    exposures: np.ndarray
    deviation: float
    share: float
    doubt: float


def apart(
    photographs: list[Photograph], surface: Surface, channel: int | None = None
) -> Apart | None:
    """How unlike views are exposed, in a ``channel`` or all; None where no pairs connect them."""
    return _apart(shown(photographs, surface, channel))


def _apart(logs: np.ndarray) -> Apart | None:
    """The same of what ``shown`` tells, or of differences of such."""
    count = len(logs)
    chosen = np.unique(np.linspace(0, count - 1, min(_MOST, count)).round().astype(int))
    pairs, found, deviation = [], [], []
    for a, b in ((a, int(b)) for a in range(count) for b in chosen):
        if a in chosen and a >= b:
            continue
        ratios = logs[a] - logs[b]
        ratios = ratios[np.isfinite(ratios)]
        if ratios.size < _SHARED:
            continue
        pairs.append((a, b))
        found.append(np.median(ratios))
        deviation.append(_NORMAL * np.median(np.abs(ratios - found[-1])))
    if not pairs:
        return None
    (a, b), found, number = np.transpose(pairs), np.array(found), np.arange(len(pairs))
    # Of parts that no pair connects, each has its own zero.
    if connected_components(coo_array((number + 1, (a, b)), (count, count)), False)[0] > 1:
        return None
    signs = np.repeat([1.0, -1.0], len(pairs))
    places = np.tile(number, 2), np.concatenate([a, b])
    differences = csr_array((signs, places), (len(pairs), count))
    exposures = lsqr(differences, found, atol=1e-9, btol=1e-9)[0]
    left = found - differences @ exposures
    share = 1 - np.sum(left**2) / max(np.sum(found**2), 1e-12)
    spare = len(pairs) - (count - 1)
    # Fewer do not check each other.
    doubt = np.sqrt(np.sum(left**2) / spare) if spare >= count - 1 > 0 else np.inf
    return Apart(exposures, float(np.median(deviation)), float(share), float(doubt))


def shown(
    photographs: list[Photograph], surface: Surface, channel: int | None = None
) -> np.ndarray:
    """The logarithms ``(V, P)`` of how bright each view shows places of the object, at exposure 1,
    in a ``channel`` or all; NaN where it does not show them, or from the side."""
    points, normals = outlines.facing(surface)
    logs = np.stack([_seen(each, points, channel) for each in photographs])
    cosines = np.stack([_cosines(each.camera.centre, points, normals) for each in photographs])
    # Normals may all point inwards; most of what seems to be seen is.
    cosines *= np.sign(np.sum(cosines, where=np.isfinite(logs))) or 1
    logs[cosines < _ASLANT] = np.nan
    return logs


def unlike(photographs: list[Photograph], surface: Surface) -> tuple[float, str, str] | None:
    """How many times as bright the brightest view shows the object as the darkest, and their names;
    None where they are alike, or nothing is sure."""
    return _extremes(photographs, apart(photographs, surface), _APART)


def tinted(photographs: list[Photograph], surface: Surface) -> tuple[float, str, str] | None:
    """How many times as red or blue, beside green, the object is in one view as in another, and
    their names; None where that is alike, or nothing is sure."""
    red, green, blue = (shown(photographs, surface, channel) for channel in range(3))
    casts = (_extremes(photographs, _apart(each - green), _TINTED) for each in (red, blue))
    return max(filter(None, casts), default=None)


def _extremes(
    photographs: list[Photograph], found: Apart | None, least: float
) -> tuple[float, str, str] | None:
    """The factor between the brightest and the darkest view, if it is sure and ``least`` or more,
    and their names."""
    if found is None or found.share < _TOLD:
        return None
    low, high = int(found.exposures.argmin()), int(found.exposures.argmax())
    factor = found.exposures[high] - found.exposures[low]
    if factor < max(np.log(least), _SURE * found.deviation):
        return None
    return float(np.exp(factor)), *(photographs[each].camera.name for each in (high, low))


def moved(photographs: list[Photograph], surface: Surface) -> float | None:
    """By how much, as a factor of a standard deviation, places are brighter and darker by how they
    are turned to the camera; None where that does not tell what they differ by. It does where the
    light goes with the camera: on a turntable, or as its flash.

    Of a place's logarithms, less their means over views, and each view's own exposure: how much of
    their variance a plane over the normal in the camera's axes accounts for.
    """
    photographs = photographs[:: -(-len(photographs) // _MOST)]
    found = _apart_from_means(photographs, surface, _turned)
    if found is None:
        return None
    left, before, more = found
    spread = [_rest(left, told) for told in (before, np.hstack([before, more]))]
    by = np.sqrt(max(spread[0] - spread[1], 0.0))
    return float(np.exp(by)) if by > _LIT and spread[1] < (1 - _GOES) * spread[0] else None


def fallen(photographs: list[Photograph], surface: Surface) -> float | None:
    """By which factor places are darker where a picture's margin shows them than where its middle
    does, over the parts of pictures that show the object; None where they are not, or nothing is
    sure. It is what a lens does that no program has put right (vignetting).

    Of the same logarithms: what the squared distance from the middle accounts for, beside how
    places are turned to the camera, alike in every second view and in the others.
    """
    photographs = photographs[:: -(-len(photographs) // _MOST)]
    slopes = []
    for part in (photographs, photographs[::2], photographs[1::2]):
        found = _apart_from_means(part, surface, lambda *of: [*_turned(*of), _distant(*of)])
        if found is None:
            return None
        left, before, more = found
        told = np.hstack([before, more])
        slopes.append(np.linalg.lstsq(told, left, rcond=None)[0][-1])
        if part is photographs:
            low, high = np.quantile(more[:, -1], [0.05, 0.95])
            spread = [_rest(left, each) for each in (told[:, :-1], told)]
    fall = -slopes[0] * (high - low)
    alike = min(slopes[1:]) > _ALIKE[1] * slopes[0] and max(slopes[1:]) < _ALIKE[0] * slopes[0]
    sure = alike and spread[1] < (1 - _FALLS) * spread[0]
    return float(np.exp(-fall)) if sure and fall > _FALLEN else None


def _apart_from_means(
    photographs: list[Photograph], surface: Surface, by: Callable
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Of every place in every view that shows it, and of places that are in several: its logarithm
    less its mean over views, ``(n,)``; the same of what each view adds, ``(n, V - 1)``, and of each
    array ``(V, P)`` that ``by`` gives of views, places and normals. None of too few."""
    points, normals = outlines.facing(surface)
    logs = shown(photographs, surface)
    seen = np.isfinite(logs)
    chosen = seen.sum(axis=0) >= _OFTEN
    logs, seen = logs[:, chosen], seen[:, chosen]
    if seen.sum() < _SHARED * len(photographs):
        return None

    def apart_of(values: np.ndarray) -> np.ndarray:
        means = np.sum(values, axis=0, where=seen) / seen.sum(axis=0)
        return (values - means)[seen]

    left = apart_of(np.where(seen, logs, 0.0))
    most = _SURE * _NORMAL * np.median(np.abs(left))
    views = np.eye(len(photographs))[:-1, :, None] * np.ones(seen.shape[1])
    before, more = (
        np.stack([apart_of(each) for each in every], axis=1)
        for every in (views, by(photographs, points[chosen], normals[chosen]))
    )
    return np.clip(left, -most, most), before, more


def _rest(left: np.ndarray, told: np.ndarray) -> float:
    return float(np.var(left - told @ np.linalg.lstsq(told, left, rcond=None)[0]))


def _turned(photographs: list[Photograph], points: np.ndarray, normals: np.ndarray) -> list:
    """Normals in the camera's axes, one after another."""
    turned = np.stack([normals @ each.camera.to_world[:3, :3] for each in photographs])
    return [turned[..., axis] for axis in range(3)]


def _distant(photographs: list[Photograph], points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The squared distance from the picture's middle, of 1 in its corners."""
    found = []
    for camera in (each.camera for each in photographs):
        half = np.array([camera.width, camera.height]) / 2
        found.append((((camera.project(points)[0] - half) / np.hypot(*half)) ** 2).sum(axis=1))
    return np.stack(found)


def told(
    photographs: list[Photograph], surface: Surface, channels: int
) -> tuple[np.ndarray, float] | None:
    """Exposures, ``(V, channels)``, the first view's 1, and the share by which they may be off;
    None where nothing tells them."""
    over = [None] if channels == 1 else range(channels)
    found = [apart(photographs, surface, channel) for channel in over]
    if any(each is None for each in found):
        return None
    logs = np.stack([each.exposures - each.exposures[0] for each in found], axis=1)
    near = max(_NEAR, _SURE * max(each.doubt for each in found))
    return None if near > _VAGUE else (np.exp(logs).astype(np.float32), near)


def _cosines(centre: np.ndarray, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Of the angles between normals and where a camera is."""
    way = centre - points
    return np.einsum("nk,nk->n", way, normals) / np.maximum(np.linalg.norm(way, axis=1), 1e-30)


def _seen(photograph: Photograph, points: np.ndarray, channel: int | None) -> np.ndarray:
    """The logarithm of how bright each point is, at exposure 1; NaN where it is not seen."""
    camera = photograph.camera
    place, depth, inside = camera.seen(points)
    found = np.full(len(points), np.nan)
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
    bright = light.mean(axis=1) if channel is None else light[:, channel]
    known = before & (photograph.mask[down, across] > 0) & (bright > 0)
    values = np.full(len(place), np.nan)
    values[known] = np.log(bright[known])
    found[inside] = values
    return found
