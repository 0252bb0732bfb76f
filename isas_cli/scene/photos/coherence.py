"""Whether the outlines of all views are of one object, at the poses that their files say.

What lies within all outlines fills each of them, if they are of one object and poses are right:
silhouette coherence (Hernández, Schmitt and Cipolla 2007). A view that alone takes away what the
others show has another pose, mask or picture than its file says; where a mask shows what no other
view leaves room for, it holds more than the object.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...config import grammar
from . import outlines
from .importing import Photograph

# Points along each side: of twice the box around what lies within all outlines, where one view may
# have cut too much away, and then of what all but a few views leave there; so many may be odd.
_COARSE, _FINE, _FEW = 40, 80, 2
# Whether one view contradicts the others is asked of so many; it does where the others' masks are
# filled by so much more without it, in the mean, and by so many times what leaving another out
# gains, in the median. (Of a real set 0.0093 with a wrong pose, 0.0048 without: the worst mask.)
_SEVERAL, _GAIN, _TIMES = 4, 0.007, 3.0
# A share of a mask that is filled by nothing, from which on it is told; and cells of a mask that
# must be whole for its share to be one.
_UNFILLED, _CELLS = 0.05, 20
_NAMED = 3
_WHOLE = 0.5  # of a pixel


@dataclass
class Coherence:
    """``odd``: numbers of the views that contradict the others; ``gained``: what the others' masks
    are filled more without each of them, in the mean; ``unfilled``: ``(V,)``, the share of each
    mask that is filled by nothing that all other views but those leave, NaN where it is too small
    to say."""

    odd: np.ndarray
    gained: np.ndarray
    unfilled: np.ndarray

    def told(self, names: list[str]) -> list[str]:
        """What should be said. ``names``: of the views."""
        found = [
            f"photos.start=hull: {names[odd]} alone takes away {gained:.1%} (mean) of what the "
            "other views' masks show: its pose, mask or picture is probably wrong; mend it, or "
            f"{grammar.listed('photos.without', [names[odd]])}"
            for odd, gained in zip(self.odd, self.gained)
        ]
        above = np.nan_to_num(self.unfilled) >= _UNFILLED
        above[self.odd] = False
        views = np.flatnonzero(above)
        if not views.size:
            return found
        most = ", ".join(
            f"{names[view]} ({self.unfilled[view]:.0%})"
            for view in sorted(views, key=lambda view: -self.unfilled[view])[:_NAMED]
        )
        if views.size > len(names) / 2:
            why = "poses do not fit the pictures, or several masks are too small"
        else:
            why = "these masks hold more than the object, or their poses are wrong"
        return [
            *found,
            f"photos.start=hull: the masks of {views.size} of {len(names)} views show what no "
            f"other view leaves room for, most of all {most}: {why}",
        ]


def found(photographs: list[Photograph], low: np.ndarray, high: np.ndarray) -> Coherence:
    """Of views with ``part``, by points in and around a box, ``(3,)`` each."""
    middle, half = (low + high) / 2, high - low
    points, outside, seen, _ = _looked(photographs, middle - half, middle + half, _COARSE)
    # What most views do not show may be anywhere.
    left = points[(outside.sum(axis=0) <= _FEW) & (seen >= len(photographs) / 2)]
    if len(left):
        step = 2 * half / (_COARSE - 1)
        low, high = left.min(axis=0) - step, left.max(axis=0) + step
    points, outside, _, reach = _looked(photographs, low, high, _FINE)
    odd: list[int] = []
    gained: list[float] = []
    while True:
        gains, unfilled = _filled(photographs, points, outside, odd, reach)
        if len(photographs) - len(odd) < _SEVERAL or len(odd) == _FEW:
            break
        view = int(gains.mean(axis=0).argmax())
        # Of the others' masks: its own may be filled more without any of them.
        means = np.delete(gains, view, axis=0).sum(axis=0) / (len(photographs) - len(odd) - 1)
        most, other = means[view], np.median(np.delete(means, [view, *odd]))
        if most < max(_GAIN, _TIMES * other):
            break
        odd.append(view)
        gained.append(float(most))
    return Coherence(np.array(odd, int), np.array(gained), unfilled)


def _looked(
    photographs: list[Photograph], low: np.ndarray, high: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Points of a grid ``(P, 3)`` that lie within all outlines but a few, which of them lie outside
    each ``(V, P)``, how many views show each, and how long what each stands for is: what is thinner
    is not lost."""
    axes = [np.linspace(*ends, count) for ends in zip(low, high)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    reach = float(np.linalg.norm(high - low)) / (count - 1)
    number, beyond = np.arange(len(points)), []  # by view, the numbers of the points outside it
    times, seen = np.zeros(len(points), int), np.zeros(len(points), int)
    for each in photographs:
        deep = outlines.within(each, points, np.inf, outlines.signed(each.part))
        out = deep < -reach / 2
        beyond.append(number[out])
        times, seen = times + out, seen + np.isfinite(deep)
        kept = times <= _FEW + 1
        points, number, times, seen = points[kept], number[kept], times[kept], seen[kept]
    outside = np.zeros((len(beyond), len(number)), bool)
    for row, numbers in zip(outside, beyond):
        row[:] = np.isin(number, numbers)
    return points, outside, seen, reach


def _filled(
    photographs: list[Photograph],
    points: np.ndarray,
    outside: np.ndarray,
    odd: list[int],
    reach: float,
) -> tuple[np.ndarray, np.ndarray]:
    """``(V, V)``: by how much the first view's mask is filled more without the second one; and
    ``(V,)``: what share of its own mask is filled by nothing. Without the views ``odd``."""
    count = len(photographs)
    kept = np.setdiff1d(np.arange(count), odd)
    times = outside[kept].sum(axis=0)
    near = np.flatnonzero(times <= 1)
    # The view that alone has a point outside; count: none has.
    by = np.where(times[near] == 1, kept[outside[kept][:, near].argmax(axis=0)], count)
    gains, unfilled = np.zeros((count, count)), np.full(count, np.nan)
    for view, each in enumerate(photographs):
        cells, place, inside = _cells(each, points[near], reach)
        total = np.count_nonzero(cells)
        if total < _CELLS:
            continue
        of, who = place[inside], by[inside]
        filled = np.zeros(cells.size, bool)
        filled[of[who == count]] = True
        empty = cells.ravel() & ~filled
        unfilled[view] = np.count_nonzero(empty) / total
        if view in odd:
            continue
        more = (who < count) & empty[of]
        pairs = np.unique(np.stack([of[more], who[more]]), axis=1)
        gains[view] = np.bincount(pairs[1], minlength=count) / total
    np.fill_diagonal(gains, 0.0)
    return gains, unfilled


def _cells(
    photograph: Photograph, points: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of a picture in cells as large as what a point stands for: which lie wholly within its mask;
    the number of the cell of each point; and which points lie in any."""
    camera = photograph.camera
    place, depth, seen = camera.seen(points)
    seen &= depth > reach
    if not seen.any():
        return np.zeros((1, 1), bool), np.zeros(len(points), int), seen
    side = max(1, int(np.ceil(reach * camera.fx / np.percentile(depth[seen], 5))))
    high, wide = (number // side for number in photograph.part.shape)
    if not (high and wide):
        return np.zeros((1, 1), bool), np.zeros(len(points), int), np.zeros(len(points), bool)
    blocks = photograph.part[: high * side, : wide * side].reshape(high, side, wide, side)
    cells = (blocks > _WHOLE).all(axis=(1, 3))
    column, row = (place[seen] / side).astype(int).T
    number, fits = np.zeros(len(points), int), seen.copy()
    fits[seen] = (column < wide) & (row < high)
    number[fits] = (row * wide + column)[fits[seen]]
    return cells, number, fits
