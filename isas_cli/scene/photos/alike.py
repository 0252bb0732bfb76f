"""Whether views show the same places of the object alike: poses and meshes that do not fit them.

Of each two views, how far the logarithms of what they show of the same places lie apart, and how
they go together, tell whether both look at the same object. A view that agrees with none of the
others, which agree with each other, has another pose than its file says; where none agree, but do
when the mesh is turned by its axes, it is in another program's axes. Where nothing helps the mesh
may stand elsewhere, or be a mirror: then its outline tells, which lies on edges of the pictures.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from scipy.stats import rankdata

from ...config import grammar
from ...scenes.meshes import Surface
from . import brightness, edges
from .importing import Photograph
from .outlines import scattered
from .transforms import TO_OPENCV

# Places that two views must share; views that each is compared with, at most.
_SHARED, _MOST = 50, 12
# Correlations: of views of one object at least, of others at most; and the deviation, as a share of
# brightness and over that of the other views, below which nothing is to be seen on the object.
_FITS, _UNLIKE, _PLAIN, _TIMES = 0.5, 0.3, 0.1, 2.5
_AS_GOOD = 0.97  # of the best: a box fits as well when it is turned round
# Views whose outline tells, and below which median of ``edges.ranks`` it is not the object's. Of 70
# sets it is at least 0.96 where the mesh is right, of mirrors, hulls and noisy scans, too, and at
# most 0.71 where it is turned, of another scale, or pictures are cropped. (Correlations are as low
# of mirrors, 0.1, and of a glossy head's hull, 0.3, as of what does not fit.)
_TELLING, _ON = 3, 0.8
# Of the object's points, the share in a picture from which on it is seen; and of views, how many
# must not see it.
_SEEN, _MANY = 0.1, 1 / 3
_NORMAL = 1.4826  # a normal number's deviation, over its median


def doubts(photographs: list[Photograph], surface: Surface | None, cut: bool = False) -> list[str]:
    """What should be said. ``cut``: whether the surface is a hull, which the cameras put there."""
    if surface is None or len(photographs) < 3:
        return []
    if not cut and (told := _inverted(photographs, surface)):
        return told
    found = _blind(photographs, surface)
    together, apart, _ = _pairs(photographs, surface)
    if not np.isfinite(together).any():
        return found
    middle = np.nanmedian(together)
    if middle >= _FITS:
        return found + _odd(photographs, together, apart)
    some = photographs[:: -(-len(photographs) // _MOST)]  # each turn looks at all their pairs
    if middle > _UNLIKE:
        return found + ([] if cut else _elsewhere(some, surface))
    tried = [(*_fit(some, turned), name, turned) for name, turned in _turns(surface)]
    most = max((score for score, fits, *_ in tried if fits >= _FITS), default=0.0)
    as_good = (each for each in tried if each[1] >= _FITS and each[0] >= _AS_GOOD * most)
    name = next((name for *_, name, turned in as_good if not _off_edges(some, turned)), None)
    if name is None:
        return found + ([] if cut else _elsewhere(some, surface))
    return found + [
        "the views show the same places of the object alike if the mesh's axes x, y, z become "
        f"{name}, and unlike as they are: export it in the axes of the cameras' world"
    ]


def _elsewhere(photographs: list[Photograph], surface: Surface) -> list[str]:
    """Of views that show the object unlike, if its outline lies on no edges either."""
    if not _off_edges(photographs, surface):
        return []
    return [
        "the views show the same places of the object unlike, and its outline lies on no edges of "
        "theirs: the mesh does not stand where the cameras see it (other axes, scale, origin or "
        "photos.world; photos.pose=true finds what is a little off), or pictures were cropped or "
        "resized after calibration (another principal point; photos.scale), or poses are wrong"
    ]


def _off_edges(photographs: list[Photograph], surface: Surface) -> bool:
    """Whether the outline lies elsewhere than where pictures have edges."""
    ranks = edges.ranks(photographs, surface)
    ranks = ranks[np.isfinite(ranks)]
    return len(ranks) >= _TELLING and float(np.median(ranks)) < _ON


def _inverted(photographs: list[Photograph], surface: Surface) -> list[str]:
    """Of poses that lead the other way, from world to camera in place of from camera to world: as
    they stand many views do not see the object, and inverted all do. Files whose cameras have
    other axes (OpenGL's) have them on both sides."""
    points = scattered(surface)
    poses = [each.camera.to_world for each in photographs]
    seen = [_sees(p, pose, points) for p, pose in zip(photographs, poses)]
    blind = len(seen) - sum(seen)
    if blind < max(2, len(seen) * _MANY):
        return []
    for axes in (np.eye(4), TO_OPENCV):
        inverted = (axes @ np.linalg.inv(pose) @ axes for pose in poses)
        if all(_sees(p, pose, points) for p, pose in zip(photographs, inverted)):
            break
    else:
        return []
    return [
        f"the object is in {blind} of {len(seen)} views behind the camera or outside the picture, "
        "and in none if each pose is inverted: their file probably has matrices from world to "
        "camera where those from camera to world are meant, or the other way round: invert them"
    ]


def _sees(photograph: Photograph, pose: np.ndarray, points: np.ndarray) -> bool:
    """Whether a view would show the object from ``pose (4, 4)``."""
    inside = replace(photograph.camera, to_world=pose).seen(points)[2]
    return bool(inside.mean() >= _SEEN)


def _blind(photographs: list[Photograph], surface: Surface) -> list[str]:
    """Of few views, those in which no place of the object can lie."""
    points, names = scattered(surface), []
    for each in photographs:
        if not each.camera.seen(points)[2].any():
            names.append(each.camera.name)
    # Where most are, it is the mesh, of which others speak.
    if not 0 < len(names) <= len(photographs) / 2:
        return []
    return [
        f"the object is in {len(names)} of {len(photographs)} views behind the camera or outside "
        f"the picture, first {names[0]}: they tell nothing of it; mend their poses, or leave them "
        f"out by {grammar.listed('photos.without', names)}"
    ]


def _odd(photographs: list[Photograph], together: np.ndarray, apart: np.ndarray) -> list[str]:
    """Of views most of which agree, those that agree with none."""
    usual, odd = np.nanmedian(apart), []
    for view, (own, far) in enumerate(zip(together, apart)):
        known = np.isfinite(own)
        if known.sum() < 2:
            continue
        unlike = np.median(own[known]) < _UNLIKE
        if unlike and np.median(far[known]) > max(_PLAIN, _TIMES * usual):
            odd.append(photographs[view].camera.name)
    if not odd:
        return []
    return [
        f"{len(odd)} of {len(photographs)} views show the object's places unlike all others, first "
        f"{odd[0]}: its pose, or which picture it has, is probably wrong; or something stands "
        f"before the object; {grammar.listed('photos.without', odd)} leaves them out"
    ]


def _pairs(
    photographs: list[Photograph], surface: Surface
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``(V, V)`` each: rank correlation, and the deviation of the difference, of the logarithms of
    what two views show of the same places, NaN where they share too few, or show nothing on them;
    and how many they share."""
    logs = brightness.shown(photographs, surface)
    count = len(photographs)
    together, apart = np.full((2, count, count), np.nan)
    shared = np.zeros((count, count))
    steps = np.unique(np.linspace(1, count - 1, min(_MOST, count - 1)).round().astype(int))
    for a, b in ((a, (a + step) % count) for a in range(count) for step in steps):
        both = np.isfinite(logs[a]) & np.isfinite(logs[b])
        if both.sum() < _SHARED:
            continue
        one, other = logs[a][both], logs[b][both]
        between = one - other
        apart[a, b] = _NORMAL * np.median(np.abs(between - np.median(between)))
        shared[a, b] = both.sum()
        if min(one.std(), other.std()) > 1e-6:
            # Of ranks: at edges single places are of something else, much darker.
            together[a, b] = np.corrcoef(rankdata(one), rankdata(other))[0, 1]
    return together, apart, shared


def _fit(photographs: list[Photograph], surface: Surface) -> tuple[float, float]:
    """How well a mesh fits: by all places that two views share, and the median correlation of two
    views."""
    together, _, shared = _pairs(photographs, surface)
    if not np.isfinite(together).any():
        return 0.0, -1.0
    return float(np.nansum(together * shared)), float(np.nanmedian(together))


def _turns(surface: Surface) -> list[tuple[str, Surface]]:
    """All ways but its own to take an axis for another, also mirrored: new axes, and the surface
    in them. Those that people meet stand first: turned by 90°, then all others, mirrored ones
    last."""
    found = []
    for order, signs in itertools.product(
        itertools.permutations(range(3)), itertools.product((1, -1), repeat=3)
    ):
        turn = np.zeros((3, 3))
        turn[order, range(3)] = signs
        if (turn == np.eye(3)).all():
            continue
        name = ", ".join(("" if s > 0 else "-") + "xyz"[to] for to, s in zip(order, signs))
        found.append((name + (" (mirrored)" if np.linalg.det(turn) < 0 else ""), turn))
    found.sort(key=lambda each: (np.linalg.det(each[1]) < 0, -np.trace(each[1])))
    places = surface.vertices
    return [
        (name, replace(surface, vertices=(places @ turn.T).astype(np.float32)))
        for name, turn in found
    ]
