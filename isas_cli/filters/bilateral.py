"""Adam's moments, averaged over neighbours of like value ('Spatiotemporal Bilateral Gradient
Filtering for Inverse Rendering', Chang et al. 2024).

Where a parameter is alike, so is its gradient, they hold; the value itself guides the mean. Of both
moments of an entry p, from Adam's own and once for each level l = 0, 1, … (à trous),

    m'_p = Σ_q h(q) k(θ_p, θ_q) m_q / Σ_q h(q) k(θ_p, θ_q),    k = exp(-|θ_p - θ_q| / edge),

over five entries along each axis, 2^l apart, of weights h = (1, 4, 6, 4, 1) / 16, |·| over the
channels. The step is Adam's with m' and v'; Adam goes on with its own moments. Entries that are out
of the array, or not seen, have no weight.

Bias: detail that is not in θ yet, or finer in value than ``edge``, is slowed down, but its gradient
has the same zero as long as k falls to nothing: ``edge`` shrinks as the rate does, where the
paper's stays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..rendering.kernels import recorded
from ..runtime.errors import InputError
from .filter import Filter, Layout, OnUnknown, Step, along, at_least, within

_TAPS = 5


@dataclass(frozen=True)
class Bilateral(Filter):
    """``edge``: the difference of values, in the unknown's unit, at which neighbours have 1/e of
    their weight; ``levels``: passes, which reach 2^(levels + 1) - 2 entries each way. Raises
    InputError for values that are none."""

    edge: float = 0.03
    levels: int = 3
    name = "bilateral"

    def __post_init__(self) -> None:
        within("edge", self.edge, 0, math.inf)
        at_least(1, "levels", self.levels)
        if self.levels > 10:
            raise InputError(f"optimizer.filter.levels={self.levels}: at most 10")

    def on(self, layout: Layout, β: tuple[float, float], masked: bool) -> OnUnknown:
        return _Bilateral(layout, self, masked)


class _Bilateral(OnUnknown):
    moves = True

    def __init__(self, layout: Layout, settings: Bilateral, masked: bool):
        super().__init__(layout)
        self.settings, self.masked = settings, masked
        self._passed = recorded(self._traced, None)

    def moved(self, step: Step) -> mi.Float:
        edge = dr.opaque(mi.Float, max(self.settings.edge * step.share, 1e-20))
        moments = step.first, step.second
        for level in range(self.settings.levels):
            apart = dr.opaque(mi.Int32, 1 << level)
            moments = self._passed(*moments, step.before, edge, apart, self.layout.seen)
        found = step.before - along(step.corrected, *moments)
        if self.masked:
            found = dr.select(step.gradient != 0, found, step.before)
        return found

    def _traced(self, first, second, value, edge, apart, seen):
        """Both moments after one pass."""
        shape, axes = self.layout.shape, self.layout.axes
        strides = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
        channels = shape[-1] if axes[-1][0] < len(shape) - 1 else 1
        own = dr.arange(mi.UInt32, self.layout.size)
        base = own - own % channels
        places = [mi.Int32(own // strides[axis] % shape[axis]) for axis, _ in axes]
        values = [dr.gather(mi.Float, value, base + c) for c in range(channels)]

        def tap(number, total, m, v):
            index, weight, inside, digits = mi.Int32(own), mi.Float(1), mi.Bool(True), number
            for (axis, wraps), place in zip(axes, places):
                offset = mi.Int32(digits % _TAPS) - _TAPS // 2
                digits = digits // _TAPS
                there = place + offset * apart
                size = shape[axis]
                if wraps:
                    there = (there % size + size) % size
                else:
                    inside &= (there >= 0) & (there < size)
                index += (there - place) * strides[axis]
                far = dr.abs(offset)
                weight *= dr.select(far == 0, 0.375, dr.select(far == 1, 0.25, 0.0625))
            at = mi.UInt32(index)
            if seen is not None:
                weight *= dr.gather(mi.Float, seen, at, inside)
            squared = mi.Float(0)
            for c in range(channels):
                other = dr.gather(mi.Float, value, at - at % channels + c, inside)
                squared += dr.square(other - values[c])
            weight *= dr.exp(-dr.sqrt(squared) / edge)
            weight = dr.select(inside, weight, 0)
            m += weight * dr.gather(mi.Float, first, at, inside)
            v += weight * dr.gather(mi.Float, second, at, inside)
            return number + 1, total + weight, m, v

        start = mi.UInt32(0), *(dr.zeros(mi.Float, self.layout.size) for _ in range(3))
        count = _TAPS ** len(axes)
        _, total, m, v = dr.while_loop(start, lambda n, *_: n < count, tap, label="bilateral")
        return self._blended(seen, total, first, m), self._blended(seen, total, second, v)

    @staticmethod
    def _blended(seen, total, before, above):
        told = total > 0 if seen is None else (total > 0) & (seen > 0)
        return dr.select(told, above / total, before)
