"""All pixels of all views as one index range.

There are two orders. *Pixels* count row after row, as images are stored. *Slots* count patch after
patch, nested, and are what a distribution ranges over: its draws come out sorted, so neighbouring
lanes of a wavefront get neighbouring slots, and these should be neighbours in both directions.
Measured on pottery, 65,536 of 4 M pixels: the same step took 1.5 times as long row after row.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..config.photographs import LENS
from ..unknowns.parameters import own

# Sides of the nested patches, pixels. A packet of 16 lanes whose draws lie s pixels apart covers a
# compact patch for s around 64² / 4², 16² / 4² and 4: sparse, usual and concentrated sampling.
_PATCHES = (128, 32, 8)
# Numbers of a lens as ``Views.lens`` has them.
FOCAL, CENTRE_X, CENTRE_Y, RADIAL = range(4)
# What may be unknown → which numbers these are.
PARTS = dict(zip(LENS, ([FOCAL], [CENTRE_X, CENTRE_Y], [RADIAL])))


@dataclass
class Views:
    """The films of a problem laid end to end: pixel ``j`` of view ``v`` is ``offset[v] + y w + x``.

    ``exposure``: ``(3 V,)`` factors on the radiance of each view's channels, or None for ones;
    ``given``: others, which are known.
    ``motion``: ``(6 V,)`` turns (radians) and shifts of each view's camera, or None; ``lens``: ``(4
    V,)``, in what its lens is otherwise than the sensor (``unknowns.optics.Lens``), or None, and
    ``axes``: ``(9 V,)``, where to the right, down and forward are for it.
    ``width``, ``height``, ``offset``, ``end``: ``(V,) uint32`` device arrays (pixels; ``end`` is
    one past a view's last pixel); ``count``: views; ``total``: pixels of all views together.
    A plain dataclass, so that Dr.Jit sees the arrays when a kernel is frozen.
    """

    width: mi.UInt32
    height: mi.UInt32
    offset: mi.UInt32
    end: mi.UInt32
    count: int
    total: int
    sizes: tuple  # ((width, height), …) on the host
    exposure: mi.Float | None = None
    given: mi.Float | None = None
    motion: mi.Float | None = None
    lens: mi.Float | None = None
    axes: mi.Float | None = None

    @property
    def altered(self) -> bool:
        """Whether what a view shows is not what the scene's sensors alone show."""
        changed = self.exposure, self.given, self.motion, self.lens
        return any(each is not None for each in changed)

    def look(self, axes: np.ndarray) -> None:
        """Be told where cameras look, ``axes (V, 3, 3)``, rows."""
        self.axes = own(mi.Float, np.ascontiguousarray(axes, np.float32).ravel())

    def brightness(self, view: mi.UInt32) -> mi.Color3f | float:
        """By how much views are brighter than the scene says. Traced, without derivatives."""
        found = 1.0
        for factors in (self.exposure, self.given):
            if factors is not None:
                found = dr.gather(mi.Color3f, dr.detach(factors), view) * found
        return found

    @staticmethod
    def of(sizes: list[tuple[int, int]]) -> "Views":
        """Views of the given film sizes ``[(width, height), …]`` in pixels."""
        offsets, total = [], 0
        for width, height in sizes:
            offsets.append(total)
            total += width * height
        if total >= 2**32 - 1:
            raise ValueError(f"{total} pixels: pixel indices are 32 bits wide")
        return Views(
            mi.UInt32([w for w, _ in sizes]),
            mi.UInt32([h for _, h in sizes]),
            mi.UInt32(offsets),
            mi.UInt32([*offsets[1:], total]),
            len(sizes),
            total,
            tuple((int(w), int(h)) for w, h in sizes),
        )

    def _view(self, index: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
        """View of each pixel or slot, and its number within the view."""
        # The upper bound is inclusive: Dr.Jit's search may test it.
        view = dr.binary_search(
            0, self.count - 1, lambda v: dr.gather(mi.UInt32, self.end, mi.UInt32(v)) <= index
        )
        view = mi.UInt32(view)
        return view, index - dr.gather(mi.UInt32, self.offset, view)

    def locate(self, pixel: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32]:
        """View, column and row of each pixel. Traced."""
        view, rest = self._view(pixel)
        width = dr.gather(mi.UInt32, self.width, view)
        row = divide(rest, width)
        return view, rest - row * width, row

    def index(self, view: mi.UInt32, column: mi.UInt32, row: mi.UInt32) -> mi.UInt32:
        """The pixel at a column and row of a view. Traced."""
        width = dr.gather(mi.UInt32, self.width, view)
        return dr.gather(mi.UInt32, self.offset, view) + row * width + column

    def locate_slot(self, slot: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32]:
        """View, column and row of each slot. Traced.

        Bands of patches from top to bottom, patches from left to right, each patch again so with
        the next smaller side; patches at the border are cut off. One to one for films of any size.
        """
        view, rest = self._view(slot)
        width = dr.gather(mi.UInt32, self.width, view)
        height = dr.gather(mi.UInt32, self.height, view)
        column, row = mi.UInt32(0), mi.UInt32(0)
        for side in _PATCHES:
            band = divide(rest, width * side) * side
            rest -= band * width
            height = dr.minimum(height - band, side)
            left = divide(rest, height * side) * side
            rest -= left * height
            width = dr.minimum(width - left, side)
            column, row = column + left, row + band
        down = divide(rest, width)
        return view, column + rest - down * width, row + down

    def slot(self, view: mi.UInt32, column: mi.UInt32, row: mi.UInt32) -> mi.UInt32:
        """The inverse of ``locate_slot``. Traced."""
        width = dr.gather(mi.UInt32, self.width, view)
        height = dr.gather(mi.UInt32, self.height, view)
        slot = dr.gather(mi.UInt32, self.offset, view)
        for side in _PATCHES:
            band = divide(row, side) * side
            slot += band * width
            height = dr.minimum(height - band, side)
            left = divide(column, side) * side
            slot += left * height
            width = dr.minimum(width - left, side)
            column, row = column - left, row - band
        return slot + row * width + column


@dataclass(frozen=True)
class Glass:
    """The lenses of some views: ``of (V,)``: the number of each view's, -1 where nothing of it is
    unknown; ``focal``, ``width (V,)``: pixels;
    ``axes (V, 3, 3)``: of each camera to the right, down and forward, in the world, rows;
    ``parts``: of PARTS, what is unknown, in their order; ``names``: of the lenses."""

    of: np.ndarray
    focal: np.ndarray
    width: np.ndarray
    axes: np.ndarray
    parts: tuple[str, ...]
    names: tuple[str, ...]

    def of_views(self, start: int, stop: int) -> "Glass":
        cut = slice(start, stop)
        arrays = (each[cut] for each in (self.of, self.focal, self.width, self.axes))
        return Glass(*arrays, self.parts, self.names)

    @property
    def columns(self) -> list[int]:
        return [number for part in self.parts for number in PARTS[part]]

    @property
    def table(self) -> np.ndarray:
        """``unknowns.cameras.OfCameras``'s."""
        columns = self.columns
        found = np.full((len(self.of), 4), -1)
        found[:, columns] = self.of[:, None] * len(columns) + np.arange(len(columns))
        return np.where(self.of[:, None] < 0, -1, found)

    @property
    def sizes(self) -> np.ndarray:
        """What moves the middle of the picture's side by a pixel: a share of the focal length, the
        principal point on the plane at distance 1, k of r (1 + k r²) there."""
        half = self.width / 2
        away = half / self.focal
        return np.stack([1 / half, 1 / self.focal, 1 / self.focal, away**-3 / self.focal], axis=1)


def divide(a: mi.UInt32, b: mi.UInt32) -> mi.UInt32:
    """a // b, exactly: quotients of 32-bit numbers lie further apart than double precision rounds.

    Vectorised, which integer division is not, and safe: the idle lanes at the end of a wavefront
    gather zeros, and an integer division by zero kills the process.
    """
    return mi.UInt32(mi.Float64(a) / mi.Float64(dr.maximum(b, 1)))
