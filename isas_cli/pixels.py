"""All pixels of all views as one index range, and a distribution over it.

There are two orders. *Pixels* count row after row, as images are stored. *Slots* count tile after
tile, nested, and are what a distribution ranges over: its draws come out sorted, so neighbouring
lanes of a wavefront get neighbouring slots, and these should be neighbours in both directions.
Measured on pottery, 65,536 of 4 M pixels: the same step took 1.5 times as long row after row.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

# Sides of the nested tiles, pixels. A packet of 16 lanes whose draws lie s pixels apart covers a
# compact patch for s around 64² / 4², 16² / 4² and 4: sparse, usual and concentrated sampling.
_TILES = (128, 32, 8)
# Entries of a distribution's guide table at most: 256 KiB, which stays in the cache.
_GUIDE = 1 << 16


@dataclass
class Views:
    """The films of a problem laid end to end: pixel ``j`` of view ``v`` is ``offset[v] + y w + x``.

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
        row = _divide(rest, width)
        return view, rest - row * width, row

    def index(self, view: mi.UInt32, column: mi.UInt32, row: mi.UInt32) -> mi.UInt32:
        """The pixel at a column and row of a view. Traced."""
        width = dr.gather(mi.UInt32, self.width, view)
        return dr.gather(mi.UInt32, self.offset, view) + row * width + column

    def locate_slot(self, slot: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32]:
        """View, column and row of each slot. Traced.

        Bands of tiles from top to bottom, tiles from left to right, each tile again so with the
        next smaller side; tiles at the border are cut off. One to one for films of any size.
        """
        view, rest = self._view(slot)
        width = dr.gather(mi.UInt32, self.width, view)
        height = dr.gather(mi.UInt32, self.height, view)
        column, row = mi.UInt32(0), mi.UInt32(0)
        for side in _TILES:
            band = _divide(rest, width * side) * side
            rest -= band * width
            height = dr.minimum(height - band, side)
            left = _divide(rest, height * side) * side
            rest -= left * height
            width = dr.minimum(width - left, side)
            column, row = column + left, row + band
        down = _divide(rest, width)
        return view, column + rest - down * width, row + down


def _divide(a: mi.UInt32, b: mi.UInt32) -> mi.UInt32:
    """a // b, exactly: quotients of 32-bit numbers lie further apart than double precision rounds.

    Vectorised, which integer division is not, and safe: the idle lanes at the end of a wavefront
    gather zeros, and an integer division by zero kills the process.
    """
    return mi.UInt32(mi.Float64(a) / mi.Float64(dr.maximum(b, 1)))


@dataclass
class PixelDistribution:
    """A pmf over the slots (pixels, tile after tile) of all views, kept as its running sum.

    ``cdf``: ``(n,) float64``, not normalised; ``cdf[-1]`` is the total mass. In double precision:
    the probability of a pixel is the step that the running sum takes there, divided by the
    total, exactly what is drawn, so importance weights match even where single precision could
    not tell neighbours apart. 8 bytes a pixel. At 70 M equal pixels a step is exact to 1e-8.
    ``guide``: ``(G + 1,) uint32``, the slot at each G-th of the mass: a draw searches between two
    of its entries, which touches a few cache lines of the CDF instead of twenty.
    """

    cdf: mi.Float64
    guide: mi.UInt32
    size: int

    @staticmethod
    def from_weights(weights: mi.Float, floor: float = 0.0) -> "PixelDistribution":
        """The mixture (1 - floor) w / Σw + floor / n.

        ``weights (n,) float32``, one per slot, need not be normalised. Non-finite and negative
        entries count as zero, and weights that are all zero give the uniform pmf: stage 1 of a
        solved problem says so, and every pixel must stay reachable. Evaluates.
        """
        size = dr.width(weights)
        weights = dr.select(dr.isfinite(weights) & (weights > 0), weights, 0)
        # Twice: float32 sums stop growing, so the total must come from float64 as well.
        mass = mi.Float64(weights)
        total = dr.sum(mass)
        some = total > 0
        scale = dr.select(some, (1.0 - floor) * size / dr.select(some, total, 1.0), 0.0)
        uniform = dr.select(some, mi.Float64(floor), mi.Float64(1.0))
        cdf = dr.cumsum(dr.fma(mass, scale, uniform))
        dr.eval(cdf)
        entries = min(_GUIDE, 1 << (size - 1).bit_length())
        goal = mi.Float64(dr.arange(mi.UInt32, entries + 1)) * (1.0 / entries)
        goal *= dr.gather(mi.Float64, cdf, size - 1)
        guide = dr.binary_search(
            0, size - 1, lambda j: dr.gather(mi.Float64, cdf, mi.UInt32(j)) <= goal
        )
        guide = mi.UInt32(guide)
        dr.eval(guide)
        return PixelDistribution(cdf, guide, size)

    @staticmethod
    def uniform(size: int) -> "PixelDistribution":
        """Every pixel alike."""
        return PixelDistribution.from_weights(dr.full(mi.Float, 1, size))

    def draw(self, count: int, seed: mi.UInt32) -> tuple[mi.UInt32, mi.Float]:
        """``count`` stratified draws: slots in rising order and their probabilities.

        Sample ``i`` inverts the CDF at ``(i + ξ_i) / count`` with ``ξ`` of 53 bits: a float32
        number has 2^24 values and would miss pixels of large films. The expected number of
        draws of slot ``j`` is ``count p_j`` exactly, so 1 / (count p_j) weights stay unbiased;
        rising order keeps neighbouring lanes on neighbouring rays. Traced.
        """
        rng = mi.PCG32(size=count, initstate=mi.UInt64(seed))
        share = (mi.Float64(dr.arange(mi.UInt32, count)) + rng.next_float64()) * (1.0 / count)
        goal = share * dr.gather(mi.Float64, self.cdf, self.size - 1)
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
        return slot, self.probability(slot)

    def probability(self, slot: mi.UInt32) -> mi.Float:
        """p_j of each slot. Traced."""
        total = dr.gather(mi.Float64, self.cdf, self.size - 1)
        upper = dr.gather(mi.Float64, self.cdf, slot)
        lower = dr.gather(mi.Float64, self.cdf, slot - 1, slot > 0)
        return mi.Float((upper - lower) / total)
