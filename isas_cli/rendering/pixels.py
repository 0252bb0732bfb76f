"""A distribution over the pixels of all views."""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..scene.views import Views, divide

# Entries of a distribution's guide table at most: 256 KiB, which stays in the cache.
_GUIDE = 1 << 16
# Tiles of a distribution at most, about: 8 MiB.
_TILES_AT_MOST = 1 << 20


@dataclass
class Tiles:
    """All films cut into square tiles of ``side`` pixels, over which a distribution ranges.

    ``grid``: the tiles of all views as if they were pixels of small films; ``side`` (pixels) is 1
    for up to ``most`` pixels in all, so that a tile is a pixel; larger films get larger tiles and
    the cost of a distribution does not grow with them. Tiles at the right and lower border are
    cut off.
    """

    views: Views
    grid: Views
    side: int

    @staticmethod
    def over(views: Views, most: int = _TILES_AT_MOST, finest: float = math.inf) -> "Tiles":
        """``finest``, pixels: the size of the smallest detail, which no tile may exceed."""
        side = math.ceil(math.sqrt(views.total / most))
        side = max(1, min(side, math.floor(min(finest, 2**16))))
        sizes = [(math.ceil(w / side), math.ceil(h / side)) for w, h in views.sizes]
        return Tiles(views, Views.of(sizes), side)

    @property
    def count(self) -> int:
        return self.grid.total

    def corner(self, slot: mi.UInt32) -> tuple[mi.UInt32, ...]:
        """View, first column and row, and width and height in pixels of each tile. Traced."""
        view, column, row = self.grid.locate_slot(slot)
        column, row = column * self.side, row * self.side
        width = dr.minimum(dr.gather(mi.UInt32, self.views.width, view) - column, self.side)
        height = dr.minimum(dr.gather(mi.UInt32, self.views.height, view) - row, self.side)
        return view, column, row, width, height

    def slot(self, view: mi.UInt32, column: mi.UInt32, row: mi.UInt32) -> mi.UInt32:
        """The tile that a pixel lies in. Traced."""
        return self.grid.slot(view, divide(column, self.side), divide(row, self.side))


@dataclass
class PixelDistribution:
    """A pmf over the pixels of all views, constant within a tile, kept as its running sum.

    ``cdf``: ``(T,) float64`` over tile slots, not normalised; ``cdf[-1]`` is the total mass. In
    double precision: the probability of a tile is the step that the running sum takes there,
    divided by the total, exactly what is drawn, so importance weights match even where single
    precision could not tell neighbours apart. 8 bytes a tile, and a tile is at least a pixel.
    ``guide``: ``(G + 1,) uint32``, the tile at each G-th of the mass: a draw searches between two
    of its entries, which touches a few cache lines of the CDF instead of twenty.
    """

    cdf: mi.Float64
    guide: mi.UInt32
    tiles: Tiles

    @staticmethod
    def from_weights(weights: mi.Float, tiles: Tiles, floor: float = 0.0) -> "PixelDistribution":
        """The mixture (1 - floor) w_j / Σw + floor / n over all n pixels j.

        ``weights (T,) float32``: w_j of every pixel of a tile, for each slot; they need not be
        normalised. Non-finite and negative entries count as zero, and weights that are all zero
        give the uniform pmf: stage 1 of a solved problem says so, and every pixel must stay
        reachable. Evaluates.
        """
        weights = dr.select(dr.isfinite(weights) & (weights > 0), weights, 0)
        *_, width, height = tiles.corner(dr.arange(mi.UInt32, tiles.count))
        pixels = mi.Float64(width * height)
        # In float64 from here on: sums in float32 stop growing.
        mass = mi.Float64(weights) * pixels
        total = dr.sum(mass)
        some = total > 0
        scale = dr.select(some, (1.0 - floor) * tiles.views.total / dr.select(some, total, 1.0), 0)
        uniform = dr.select(some, mi.Float64(floor), mi.Float64(1.0))
        cdf = dr.cumsum(dr.fma(mass, scale, uniform * pixels))
        dr.eval(cdf)
        last = tiles.count - 1
        entries = min(_GUIDE, 1 << last.bit_length())
        goal = mi.Float64(dr.arange(mi.UInt32, entries + 1)) * (1.0 / entries)
        goal *= dr.gather(mi.Float64, cdf, last)
        guide = dr.binary_search(
            0, last, lambda j: dr.gather(mi.Float64, cdf, mi.UInt32(j)) <= goal
        )
        # In a single tile the search gives a bare 0.
        guide = mi.UInt32(guide) + dr.zeros(mi.UInt32, entries + 1)
        dr.eval(guide)
        return PixelDistribution(cdf, guide, tiles)

    @staticmethod
    def uniform(tiles: Tiles) -> "PixelDistribution":
        """Every pixel alike."""
        return PixelDistribution.from_weights(dr.full(mi.Float, 1, tiles.count), tiles)

    def draw(self, count: int, seed: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32, mi.Float]:
        """``count`` stratified draws: view, column and row of each, and its probability p_j.

        Sample ``i`` inverts the CDF at ``(i + ξ_i) / count`` with ``ξ`` of 53 bits: a float32
        number has 2^24 values and would miss pixels of large films. What is left of the number
        within the step that it hit picks the pixel of the tile, so strata are kept there as well.
        The expected number of draws of pixel ``j`` is ``count p_j`` exactly, so 1 / (count p_j)
        weights stay unbiased; tiles come in rising order of their slots, which keeps neighbouring
        lanes on neighbouring rays. Traced.
        """
        rng = mi.PCG32(size=count, initstate=mi.UInt64(seed))
        share = (mi.Float64(dr.arange(mi.UInt32, count)) + rng.next_float64()) * (1.0 / count)
        # Below 1, which the last share may round to: beyond the last tile that has mass.
        share = dr.minimum(share, 1 - 2.0**-53)
        goal = share * dr.gather(mi.Float64, self.cdf, self.tiles.count - 1)
        entries = dr.width(self.guide) - 1
        bucket = dr.minimum(mi.UInt32(share * entries), entries - 1)
        low = dr.gather(mi.UInt32, self.guide, bucket)
        high = dr.gather(mi.UInt32, self.guide, bucket + 1)

        def halve(low, high):
            middle = (low + high) >> 1
            right = dr.gather(mi.Float64, self.cdf, middle) <= goal
            return dr.select(right, middle + 1, low), dr.select(right, high, middle)

        slot, _ = dr.while_loop(
            (low, high), lambda low, high: low < high, halve, labels=("low", "high")
        )
        view, column, row, width, height = self.tiles.corner(slot)
        below, mass = self._step(slot)
        pixels = width * height
        inside = mi.UInt32(dr.clip((goal - below) / mass, 0, 1) * mi.Float64(pixels))
        inside = dr.minimum(inside, pixels - 1)
        down = divide(inside, width)
        probability = self._probability(mass, pixels)
        return view, column + inside - down * width, row + down, probability

    def probability(self, view: mi.UInt32, column: mi.UInt32, row: mi.UInt32) -> mi.Float:
        """p_j of each pixel. Traced."""
        slot = self.tiles.slot(view, column, row)
        *_, width, height = self.tiles.corner(slot)
        return self._probability(self._step(slot)[1], width * height)

    def _step(self, slot: mi.UInt32) -> tuple[mi.Float64, mi.Float64]:
        """The running sum before a tile, and the tile's own mass."""
        upper = dr.gather(mi.Float64, self.cdf, slot)
        lower = dr.gather(mi.Float64, self.cdf, slot - 1, slot > 0)
        # A running sum in blocks may step back by its rounding.
        return lower, dr.maximum(upper - lower, 0)

    def _probability(self, mass: mi.Float64, pixels: mi.UInt32) -> mi.Float:
        total = dr.gather(mi.Float64, self.cdf, self.tiles.count - 1)
        return mi.Float(mass / (total * mi.Float64(pixels)))
