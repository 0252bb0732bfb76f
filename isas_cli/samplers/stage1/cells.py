"""A coarse grid of cells over every view, for quantities that stage 1 estimates per cell."""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ...rendering.pixels import Tiles
from ...scene.views import Views


@dataclass
class Cells:
    """Grids of at most ``resolution`` cells along the longer side of each view.

    All views' cells share one index range, like the pixels: ``views`` holds the grids' sizes as
    if they were films. ``scale_x``, ``scale_y``: ``(V,) float32``, pixels per cell.
    """

    views: Views
    scale_x: mi.Float
    scale_y: mi.Float
    film_sizes: list  # [(width, height), …] in pixels, on the host
    sizes: list  # [(columns, rows), …] on the host

    @staticmethod
    def over(film_sizes: list[tuple[int, int]], resolution: int) -> "Cells":
        sizes = []
        for width, height in film_sizes:
            side = max(1.0, max(width, height) / resolution)
            fit = (math.ceil(width / side), math.ceil(height / side))
            sizes.append((min(fit[0], resolution), min(fit[1], resolution)))
        return Cells(
            Views.of(sizes),
            mi.Float([w / c for (w, _), (c, _) in zip(film_sizes, sizes)]),
            mi.Float([h / r for (_, h), (_, r) in zip(film_sizes, sizes)]),
            film_sizes,
            sizes,
        )

    @property
    def count(self) -> int:
        return self.views.total

    @property
    def finest(self) -> float:
        """The shortest side of any cell, in pixels, but along what has one cell of a view: its
        border cuts tiles off."""
        views = zip(self.film_sizes, self.sizes)
        ways = (way for film, cells in views for way in zip(film, cells))
        return min((pixels / count for pixels, count in ways if count > 1), default=math.inf)

    def place(self, pixels: Views, samples: int, seed: mi.UInt32) -> tuple:
        """``samples`` random pixels of each cell: (view, column, row), cell after cell. Traced."""
        count = self.count * samples
        rng = mi.PCG32(size=count, initstate=mi.UInt64(seed))
        cell = dr.arange(mi.UInt32, count) // samples
        view, column, row = self.views.locate(cell)
        x = (mi.Float(column) + rng.next_float32()) * dr.gather(mi.Float, self.scale_x, view)
        y = (mi.Float(row) + rng.next_float32()) * dr.gather(mi.Float, self.scale_y, view)
        width = dr.gather(mi.UInt32, pixels.width, view)
        height = dr.gather(mi.UInt32, pixels.height, view)
        return view, dr.minimum(mi.UInt32(x), width - 1), dr.minimum(mi.UInt32(y), height - 1)

    def upsample(self, values: mi.Float, tiles: Tiles) -> mi.Float:
        """Bilinear interpolation of ``values`` (one per cell) at the middle of every tile, in the
        order of their slots. Traced."""
        slot = dr.arange(mi.UInt32, tiles.count)
        view, column, row, width, height = tiles.corner(slot)
        offset = dr.gather(mi.UInt32, self.views.offset, view)
        columns = dr.gather(mi.UInt32, self.views.width, view)
        rows = dr.gather(mi.UInt32, self.views.height, view)
        x = mi.Float(column) + 0.5 * mi.Float(width)
        y = mi.Float(row) + 0.5 * mi.Float(height)
        x = x / dr.gather(mi.Float, self.scale_x, view) - 0.5
        y = y / dr.gather(mi.Float, self.scale_y, view) - 0.5
        x = dr.clip(x, 0, mi.Float(columns) - 1)
        y = dr.clip(y, 0, mi.Float(rows) - 1)
        x0, y0 = mi.UInt32(x), mi.UInt32(y)
        fx, fy = x - mi.Float(x0), y - mi.Float(y0)
        x1, y1 = dr.minimum(x0 + 1, columns - 1), dr.minimum(y0 + 1, rows - 1)

        def at(cx, cy):
            return dr.gather(mi.Float, values, offset + cy * columns + cx)

        top = dr.lerp(at(x0, y0), at(x1, y0), fx)
        bottom = dr.lerp(at(x0, y1), at(x1, y1), fx)
        return dr.lerp(top, bottom, fy)

    def dilate(self, values: mi.Float) -> mi.Float:
        """Largest value among each cell and its eight neighbours in the same view. Traced."""
        view, column, row = self.views.locate(dr.arange(mi.UInt32, self.count))
        offset = dr.gather(mi.UInt32, self.views.offset, view)
        columns = dr.gather(mi.UInt32, self.views.width, view)
        rows = dr.gather(mi.UInt32, self.views.height, view)
        largest = mi.Float(values)
        for dy in (-1, 0, 1):
            y = mi.UInt32(dr.clip(mi.Int32(row) + dy, 0, mi.Int32(rows) - 1))
            for dx in (-1, 0, 1):
                x = mi.UInt32(dr.clip(mi.Int32(column) + dx, 0, mi.Int32(columns) - 1))
                largest = dr.maximum(largest, dr.gather(mi.Float, values, offset + y * columns + x))
        return largest
