"""Steps at all resolutions of a map at once: a pyramid as a preconditioner ('Practical Inverse
Rendering of Textured and Translucent Appearance', Weier et al. 2025).

There the unknown is the pyramid z and θ = Σ_l U_l z_l, U_l the way from level l up to the array, by
linear interpolation; each level is half of the one before along each axis, and level 0 is the array
itself. Adam steps each level's entries by ∂ℒ/∂z_l = U_lᵀ ∂ℒ/∂θ,

    θ ← θ - c rate Σ_l U_l (m̂_l / √v̂_l).

z itself is never kept: many z are one θ, and no step asks which it is, so what clamps θ clamps
nothing twice. Level 0 is Adam's own step. Coarse levels hear many texels and find their way through
noise soon, so that a smaller rate does, c of what it would be for the texels alone, with which
their noise is less; and where views tell nothing of the texels they still tell of coarser ones.

Bias: none beyond Adam's: the gradient by z is estimated without any, and the minima are θ's.
Entries that are not seen tell the coarser levels nothing, and are moved by them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..rendering.kernels import recorded
from .axes import Table, applied, interpolation
from .filter import Filter, Layout, OnUnknown, Step, along, at_least, within


@dataclass(frozen=True)
class Laplacian(Filter):
    """``rate``: c, what each level takes of the unknown's rate; ``coarsest``: entries that the
    shortest axis of the last level has at least. Raises InputError for numbers that are none."""

    rate: float = 0.5
    coarsest: int = 4
    name = "laplacian"
    layered = True

    def __post_init__(self) -> None:
        within("rate", self.rate, 0, math.inf)
        at_least(1, "coarsest", self.coarsest)

    def on(self, layout: Layout, β: tuple[float, float], masked: bool) -> OnUnknown:
        return _Laplacian(layout, self, β, masked)


class _Laplacian(OnUnknown):
    moves = True

    def __init__(self, layout: Layout, settings: Laplacian, β: tuple[float, float], masked: bool):
        self.rate, self.β, self.masked = settings.rate, β, masked
        self.shapes = pyramid(layout, settings.coarsest)
        # For each level but the last and each axis: from the next coarser one up, and back.
        self._ways = [
            [_ways(fine[axis], coarse[axis], wraps) for axis, wraps in layout.axes]
            for fine, coarse in zip(self.shapes, self.shapes[1:])
        ]
        super().__init__(layout)
        self.idle = not self.memory  # too few entries for a coarser level
        self._stepped = recorded(self._traced, None)

    def remembers(self) -> dict[str, int]:
        size = sum(int(np.prod(shape)) for shape in self.shapes[1:])
        return {"first": size, "second": size} if size else {}

    def moved(self, step: Step) -> mi.Float:
        if self.idle:
            return step.after
        arguments = step.gradient, step.corrected, self.memory, self.layout.seen, self._ways
        coarser, self.memory = self._stepped(*arguments)
        found = step.after - step.before - coarser
        # Opaque, because it differs from run to run and would compile anew.
        return dr.fma(found, dr.opaque(mi.Float, self.rate), step.before)

    def _traced(self, gradient, corrected, memory, seen, ways):
        """What coarser levels subtract, and their moments."""
        β1, β2 = self.β
        rest = gradient if seen is None else gradient * seen
        moments, steps, begin = [], [], 0
        for level, shape in enumerate(self.shapes[1:]):
            rest = self._passed(rest, level, ways, False)
            dr.eval(rest)
            place = begin + dr.arange(mi.UInt32, int(np.prod(shape)))
            begin += int(np.prod(shape))
            m, v = (dr.gather(mi.Float, memory[name], place) for name in ("first", "second"))
            touched = (rest != 0) | (not self.masked)
            m = dr.select(touched, dr.lerp(rest, m, β1), m)
            v = dr.select(touched, dr.lerp(dr.square(rest), v, β2), v)
            moments.append((m, v))
            steps.append(dr.select(touched, along(corrected, m, v), 0))
        dr.eval(moments, steps)
        found = steps[-1]
        for level in reversed(range(len(steps))):
            found = self._passed(found, level, ways, True)
            if level:
                found += steps[level - 1]
                dr.eval(found)
        first, second = (dr.concat([each[k] for each in moments]) for k in (0, 1))
        return found, {"first": first, "second": second}

    def _passed(self, entries, level: int, ways, up: bool):
        """From level + 1 to ``level``, or back by the transpose. Traced."""
        to = self.shapes[level if up else level + 1]
        shape = self.shapes[level + 1 if up else level]
        for (axis, _), way in zip(self.layout.axes, ways[level]):
            entries = applied(entries, shape, axis, way[0 if up else 1])
            shape = (*shape[:axis], to[axis], *shape[axis + 1 :])
        return entries


def _ways(fine: int, coarse: int, wraps: bool) -> tuple[Table, Table]:
    matrix = interpolation(fine, coarse, wraps)
    return Table.of(matrix), Table.of(matrix.T)


def pyramid(layout: Layout, coarsest: int) -> list[tuple[int, ...]]:
    """The shapes of all levels, that of the array first."""
    shapes = [layout.shape]
    while True:
        shape = list(shapes[-1])
        for axis, _ in layout.axes:
            shape[axis] = (shape[axis] + 1) // 2
        if min(shape[axis] for axis, _ in layout.axes) < coarsest or tuple(shape) == shapes[-1]:
            return shapes
        shapes.append(tuple(shape))
