"""Gradients smoothed over neighbouring entries: PBDR's gradient smoothing, for maps and grids.

The paper names it and prints no formula. Ours is a Gaussian K along each axis on which neighbours
are alike, reflected at open ends, around where the map closes on itself. Of entries that a view
sees, w = 1, it takes a mean,

    g' = K(w g) / K(w) where w = 1, g elsewhere,

which keeps constants, changes no place where the gradient is zero, and is symmetric in the inner
product weighted by K(w), as K is: another scale of the entries, of which Adam divides out all, and
what it makes of a gradient still points downhill. Not to be confused with blurred parameters
(`sampler=plateau`), which change the objective.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .filter import Filter, Layout, OnUnknown, within

# Narrower than this many entries, neighbours have no weight to speak of.
_NARROW = 0.25
# Widths are of a ladder of so many per cent: Dr.Jit keeps a table for every kernel that it has met.
_RUNG = 0.05


@dataclass(frozen=True)
class Gaussian(Filter):
    """``width``: a standard deviation, as a share of the array's side, which shrinks as the rate
    does. Raises InputError for one that is none."""

    width: float = 0.01
    name = "gaussian"

    def __post_init__(self) -> None:
        within("width", self.width, 0, 0.25)

    def on(self, layout: Layout, β: tuple[float, float], masked: bool) -> OnUnknown:
        return _Gaussian(layout, self.width)


class _Gaussian(OnUnknown):
    def __init__(self, layout: Layout, width: float):
        super().__init__(layout)
        self.width = width
        self.idle = max(_widths(layout, width)) < _NARROW

    def gradient(self, gradient: mi.Float, share: float) -> mi.Float:
        return smoothed(gradient, self.layout, self.width, share)


def smoothed(entries: mi.Float, layout: Layout, widest: float, share: float = 1.0) -> mi.Float:
    """``entries`` smoothed with a standard deviation of ``widest * share`` sides of the array;
    themselves below 0.25 entries of ``widest``. Traced: one kernel for all shares."""
    widths = _widths(layout, widest)
    share = (1 + _RUNG) ** round(math.log(max(share, 1e-6), 1 + _RUNG))
    if max(widths) < _NARROW:
        return entries
    kernels = [
        bell(max(width * share, 1e-3), reach(width)) if width >= _NARROW else None
        for width in widths
    ]
    return mean(entries, layout, kernels)


def _widths(layout: Layout, share: float) -> list[float]:
    """A width in entries along each axis."""
    return [share * layout.shape[axis] for axis, _ in layout.axes]


def reach(σ: float) -> int:
    """Entries to the last that is heard: beyond three standard deviations is next to nothing."""
    return math.ceil(3 * σ)


def bell(σ: float, radius: int) -> list[float]:
    """A Gaussian at the whole numbers from -``radius`` to ``radius``, of sum 1."""
    weights = [math.exp(-0.5 * (k / σ) ** 2) for k in range(-radius, radius + 1)]
    total = math.fsum(weights)
    return [weight / total for weight in weights]


def mean(entries: mi.Float, layout: Layout, kernels: list[list[float] | None]) -> mi.Float:
    """K(w ``entries``) / K(w) of the seen, by a kernel of sum 1 for each axis; the others as they
    are. Traced."""
    seen = layout.seen
    if seen is None:
        return convolved(entries, layout, kernels)
    above, below = (convolved(x, layout, kernels) for x in (entries * seen, seen))
    return dr.select(seen > 0, above / below, entries)


def convolved(entries: mi.Float, layout: Layout, kernels: list[list[float] | None]) -> mi.Float:
    """By a kernel for each axis (None: 1). Traced."""
    found = mi.TensorXf(entries, layout.shape)
    for (axis, wraps), kernel in zip(layout.axes, kernels):
        if kernel is not None:
            boundary = "wrap" if wraps else "reflect"
            # Symbolic: unrolled, the weights would be part of the kernel, and compile at each step.
            found = dr.convolve(found, kernel, axis=axis, boundary=boundary, mode="symbolic")
    return found.array
