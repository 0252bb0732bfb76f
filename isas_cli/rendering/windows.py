"""Square windows of pixels, for losses that read neighbours together."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy import ndimage

from ..scene.views import Views, divide


@dataclass(frozen=True)
class Windows:
    """Windows of ``side`` × ``side`` pixels, laid out window by window, rows first: lane ``i`` is
    pixel ``i mod side²`` of window ``i // side²``. At a picture's border a window repeats its last
    pixels, each with a path of its own."""

    side: int

    @property
    def count(self) -> int:
        """Pixels of a window."""
        return self.side**2

    def spread(self, views: Views, view: mi.UInt32, column: mi.UInt32, row: mi.UInt32, n: int):
        """View, column and row of every pixel of the windows around ``n`` pixels, ``(n side²,)``
        each, and each lane's window. Traced."""
        lane = dr.arange(mi.UInt32, n * self.count)
        window = divide(lane, self.count)
        place = lane - window * self.count
        down = divide(place, self.side)
        view = dr.gather(mi.UInt32, view, window)

        def beside(middle: mi.UInt32, step: mi.UInt32, sides: mi.UInt32) -> mi.UInt32:
            last = mi.Int(dr.gather(mi.UInt32, sides, view)) - 1
            at = mi.Int(dr.gather(mi.UInt32, middle, window)) + mi.Int(step) - self.side // 2
            return mi.UInt32(dr.clip(at, 0, last))

        column = beside(column, place - down * self.side, views.width)
        return view, column, beside(row, down, views.height), window

    def weights(self, mask: np.ndarray, views: Views) -> np.ndarray:
        """What the window around each pixel counts, ``(n,)``: the least that any of its pixels
        does. On the host, of ``mask (n,)``."""
        ends = np.cumsum([width * height for width, height in views.sizes])[:-1]
        films = [
            part.reshape(height, width)
            for part, (width, height) in zip(np.split(mask, ends), views.sizes)
        ]
        found = [ndimage.minimum_filter(film, self.side, mode="nearest") for film in films]
        return np.concatenate([film.ravel() for film in found])

    def mean(self, x: mi.Color3f) -> mi.Color3f:
        """Of each window's lanes, ``(3, n)``. Evaluates what is summed."""
        sums = (dr.block_reduce(dr.ReduceOp.Add, x[channel], self.count) for channel in range(3))
        return mi.Color3f(*sums) / self.count

    def least(self, x: mi.Float) -> mi.Float:
        """Of each window's lanes, ``(n,)``. Evaluates what is compared."""
        return dr.block_reduce(dr.ReduceOp.Min, x, self.count)

    def each(self, x: mi.Color3f) -> mi.Color3f:
        """One colour a window → one a lane."""
        return mi.Color3f(*(dr.repeat(x[channel], self.count) for channel in range(3)))
