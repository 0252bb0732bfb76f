"""Directions to the map of a sky, drawn and weighed by one lookup each.

Mitsuba finds a bright texel by a search through ten levels of means, each a lookup that waits for
the one before. Here the map is cut into rectangles, small where it varies. Each holds some of a
fixed number of tickets, in proportion to its light. A random ticket names a rectangle, and the
direction is uniform in it. That is not quite in proportion to the radiance, as Mitsuba's are; but
what is drawn and what it is weighed by agree, whatever the map.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..unknowns.parameters import own

_RECTANGLES, _TICKETS = 1 << 14, 1 << 17
# A black texel counts as this share of a mean one: a lamp that the cells overlook is still found.
_FLOOR = 1e-3
_LEAST_CELLS, _MOST_CELLS = 1 << 19, 1 << 21
_LANES = 1 << 22


@dataclass
class Sky:
    """Over (u, v), longitude and polar angle about z, each in [0, 1].

    ``ticket``: the rectangle that each ticket names; ``rectangle``: u, v, width and height of each;
    ``inside``: density of a rectangle; ``density``: of each of ``rows`` × ``columns`` cells; both
    by area of (u, v). A plain dataclass, so that Dr.Jit sees the arrays when a kernel is frozen.
    """

    ticket: mi.UInt32
    rectangle: mi.Float
    inside: mi.Float
    density: mi.Float
    rows: int
    columns: int

    def draw(self, point: mi.Point2f) -> tuple[mi.Vector3f, mi.Float]:
        """A direction from the world to the sky, and its density by solid angle, from a uniform
        ``point`` of the unit square, whose x runs through neighbours. Traced."""
        ticket = dr.minimum(mi.UInt32(point.x * _TICKETS), _TICKETS - 1)
        index = dr.gather(mi.UInt32, self.ticket, ticket)
        corner = dr.gather(mi.Vector4f, self.rectangle, index)
        # A float has 23 random bits. The ticket leaves too few of x: the last ones of y are as
        # good, within a rectangle.
        last = point.y * (1 << 12)
        u, v = corner.x + (last - dr.floor(last)) * corner.z, corner.y + point.y * corner.w
        direction, sine = _direction(u, v)
        return direction, dr.gather(mi.Float, self.inside, index) * _by_solid_angle(sine)

    def pdf(self, direction: mi.Vector3f, active: mi.Bool) -> mi.Float:
        """Density of ``draw`` by solid angle. Traced."""
        sine = dr.sqrt(dr.square(direction.x) + dr.square(direction.y))
        u = dr.atan2(direction.y, direction.x) * dr.inv_two_pi
        u = dr.select(u < 0, u + 1, u)
        v = dr.atan2(sine, direction.z) * dr.inv_pi
        row, column = (
            dr.minimum(mi.UInt32(x * n), n - 1) for x, n in ((v, self.rows), (u, self.columns))
        )
        found = dr.gather(mi.Float, self.density, row * self.columns + column, active)
        return dr.select(active, found * _by_solid_angle(sine), 0)


def _by_solid_angle(sine: mi.Float) -> mi.Float:
    return dr.rcp(2 * dr.pi**2 * dr.maximum(sine, 1e-6))


def _direction(u: mi.Float, v: mi.Float) -> tuple[mi.Vector3f, mi.Float]:
    """And the sine of the polar angle."""
    (sine, z), (y, x) = dr.sincos(v * dr.pi), dr.sincos(u * dr.two_pi)
    return mi.Vector3f(sine * x, sine * y, z), sine


def of_map(scene: mi.Scene) -> Sky | None:
    """For a scene that has a map of a sky, not of one colour, and no other light."""
    sky = scene.environment()
    if sky is None or len(scene.emitters()) != 1 or sky.class_name() != "EnvironmentMapEmitter":
        return None
    (texels,) = (value for key, value in mi.traverse(sky) if key == "data")
    if np.ptp(np.array(texels), axis=(0, 1)).max() == 0:
        return None
    size = texels.shape[0] * texels.shape[1]
    # Its texels may lie across the cells, and a lamp's light then falls on parts of some.
    finer, coarser = (
        max(1, math.ceil(ratio**0.5)) for ratio in (_LEAST_CELLS / size, size / _MOST_CELLS)
    )
    rows, columns = (max(1, n * finer // coarser) for n in texels.shape[:2])
    means, squares = _moments(sky, rows, columns, max(2, coarser))
    found = _rectangles(means, squares)
    first, last = found[:, :2], found[:, 2:]
    tickets = _tickets(_summed(means)(found))
    sizes = (last - first) / (rows, columns)
    inside = (tickets / _TICKETS / sizes.prod(axis=1)).astype(np.float32)
    density = np.empty((rows, columns), np.float32)
    for (a, b, c, d), each in zip(found, inside):
        density[a:c, b:d] = each
    corners = np.hstack([(first / (rows, columns))[:, ::-1], sizes[:, ::-1]])
    return Sky(
        own(mi.UInt32, np.repeat(np.arange(len(found), dtype=np.uint32), tickets)),
        own(mi.Float, corners.astype(np.float32).ravel()),
        own(mi.Float, inside),
        own(mi.Float, density.ravel()),
        rows,
        columns,
    )


def _moments(sky: mi.Emitter, rows: int, columns: int, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Of the luminance times the sine of the polar angle, in each cell, mean and mean square, from
    ``side``² points of it."""
    width, band = columns * side, max(1, _LANES // (columns * side**2))
    found = []
    for row in range(0, rows, band):
        count = min(band, rows - row)
        index = dr.arange(mi.UInt32, count * side * width)
        first = dr.opaque(mi.UInt32, row * side)
        u = (mi.Float(index % width) + 0.5) / width
        v = (mi.Float(index // width + first) + 0.5) / (rows * side)
        si = dr.zeros(mi.SurfaceInteraction3f)
        direction, sine = _direction(u, v)
        si.wi = -direction
        values = np.array(mi.luminance(sky.eval(si)) * sine, np.float64)
        values = np.maximum(np.nan_to_num(values, posinf=0), 0)
        values = values.reshape(count, side, columns, side)
        found.append([(values**power).mean(axis=(1, 3)) for power in (1, 2)])
    means, squares = (np.concatenate(parts) for parts in zip(*found))
    least = _FLOOR * (means.mean() or 1)
    return means + least, squares + 2 * least * means + least**2


def _rectangles(means: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """The cells cut into rectangles (first row, first column, last row, last column, the last ones
    outside), neighbours after one another. Those are halved, again and again, in which a uniform
    density is furthest from the light's, by what that adds to the variance of its estimate."""
    light, square = (_summed(each) for each in (means, squares))

    def excess(boxes) -> np.ndarray:
        own = light(boxes)
        with np.errstate(divide="ignore", invalid="ignore"):  # the empty half of a single cell
            return (boxes[:, 2:] - boxes[:, :2]).prod(axis=1) * square(boxes) / own - own

    def halves(boxes) -> np.ndarray:
        """Of each the better two, ``(n, 2, 4)``."""
        ways = []
        for axis in (0, 1):
            middle = (boxes[:, axis] + boxes[:, axis + 2]) // 2
            two = np.stack([boxes, boxes], axis=1)
            two[:, 0, axis + 2] = two[:, 1, axis] = middle
            cost = sum(excess(two[:, side]) for side in (0, 1))
            ways.append((two, np.where(middle > boxes[:, axis], cost, np.inf)))
        (rows, of_rows), (columns, of_columns) = ways
        return np.where((of_rows <= of_columns)[:, None, None], rows, columns)

    boxes = np.array([[0, 0, *means.shape]])
    while len(boxes) < _RECTANGLES:
        cells = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
        worst = np.argsort(np.where(cells > 1, -excess(boxes), np.inf))
        some = worst[: max(1, min(len(boxes) // 4, _RECTANGLES - len(boxes)))]
        some = some[cells[some] > 1]
        if not len(some):
            break
        counts = np.ones(len(boxes), np.int64)
        counts[some] = 2
        first = np.cumsum(counts) - counts
        found = np.repeat(boxes, counts, axis=0)
        two = halves(boxes[some])
        found[first[some]], found[first[some] + 1] = two[:, 0], two[:, 1]
        boxes = found
    return boxes


def _summed(cells: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """What gives the sum of ``cells`` in each of some rectangles."""
    sums = np.pad(cells.cumsum(0).cumsum(1), ((1, 0), (1, 0)))

    def of(boxes: np.ndarray) -> np.ndarray:
        a, b, c, d = boxes.T
        return sums[c, d] - sums[a, d] - sums[c, b] + sums[a, b]

    return of


def _tickets(light: np.ndarray) -> np.ndarray:
    """Whole numbers in proportion to ``light``, at least one each, ``_TICKETS`` in all."""
    free = _TICKETS - len(light)
    ends = np.rint(np.cumsum(light) / light.sum() * free).astype(np.int64)
    return 1 + np.diff(ends, prepend=0)
