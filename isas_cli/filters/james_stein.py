"""How much to smooth is estimated, entry by entry: James and Stein's combination of a gradient and
its smoothed version ('James-Stein Gradient Combiner for Inverse Monte Carlo Rendering', 2025).

S smooths by a Gaussian, d = g - S g is what that takes away: detail and noise. It is put back as
far as it is more than noise,

    g' = S g + ρ d,    ρ = max(0, 1 - (P - 2) / P · Σ_W σ² / Σ_W d̄²),

the sums over the P seen entries of a window W around the entry, each channel by itself; d̄ a mean of
d over the latest steps, and σ² the variance of that mean. In the paper d̄ is one step's d, whose
noise nearly always outweighs what a step tells: ρ = 0 would leave the bias of S, which does not
average out over steps as noise does. Ours is

    d̄_t = β d̄_(t-1) + (1 - β) d_t, over 1 - β^t;
    σ²  = s² (1 - β) / (1 + β) · (1 + β^t) / (1 - β^t),

with s² the same mean of (d_t - d_(t-1))² / 2, the paper's estimate of the variance of d, which a
slow change of the mean does not enter. Steps have random numbers of their own, so neighbours in
time are independent.

Bias: g' is biased where 0 < ρ < 1 or ρ = 0; without noise ρ = 1, and g' = g. Were σ² known and
alike in W, the squared error of ρ d̄ over W would be below that of d̄ whatever the truth is (P > 2).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..rendering.kernels import recorded
from .axes import Table, applied, convolution
from .filter import Filter, Layout, OnUnknown, at_least, within
from .gaussian import bell, reach


@dataclass(frozen=True)
class JamesStein(Filter):
    """``width``: of S, a standard deviation as a share of the array's side, the same at all steps;
    ``window``: entries from the middle of W to its edge along each axis; ``memory``: β, about
    1 / (1 - β) steps. Raises InputError for values that are none."""

    width: float = 0.02
    window: int = 5
    memory: float = 0.99
    name = "james_stein"

    def __post_init__(self) -> None:
        within("width", self.width, 0, 0.25)
        within("memory", self.memory, 0, 1)
        at_least(1, "window", self.window)

    def on(self, layout: Layout, β: tuple[float, float], masked: bool) -> OnUnknown:
        return _JamesStein(layout, self)


class _JamesStein(OnUnknown):
    def __init__(self, layout: Layout, settings: JamesStein):
        self.settings = settings
        super().__init__(layout)
        side = 2 * settings.window + 1
        bells, windows = [], []
        for axis, wraps in layout.axes:
            entries = layout.shape[axis]
            kernel = bell(settings.width * entries, reach(settings.width * entries))
            bells.append(Table.of(convolution(entries, kernel, wraps)))
            windows.append(Table.of(convolution(entries, [1.0] * side, wraps)))
        self._tables = bells, windows
        self._combined = recorded(self._traced, None)

    def remembers(self) -> dict[str, int]:
        size = self.layout.size
        return {"mean": size, "spread": size, "last": size, "steps": 1}

    def gradient(self, gradient: mi.Float, share: float) -> mi.Float:
        arguments = gradient, self.memory, self.layout.seen, *self._tables
        found, self.memory = self._combined(*arguments)
        return found

    def _traced(self, gradient, memory, seen, bells, windows):
        """What Adam is given, and what is remembered."""
        β = self.settings.memory
        smooth = self._along(gradient if seen is None else gradient * seen, bells)
        if seen is not None:
            smooth = dr.select(seen > 0, smooth / self._along(seen, bells), gradient)
        detail = gradient - smooth
        steps = memory["steps"] + 1
        mean = dr.lerp(detail, memory["mean"], β)
        # The first difference is that of the second step.
        half = dr.select(steps > 1, 0.5 * dr.square(detail - memory["last"]), 0)
        spread = dr.lerp(half, memory["spread"], β)
        dr.eval(mean, spread)
        told = 1 - dr.power(mi.Float(β), steps)
        differed = dr.maximum(1 - dr.power(mi.Float(β), steps - 1), 1 - β)
        forgets = (1 - β) / (1 + β) * (2 - told) / told / differed
        w = dr.ones(mi.Float, self.layout.size) if seen is None else seen
        parts = w, w * spread * forgets, w * dr.square(mean / told)
        count, noise, squares = (self._along(each, windows) for each in parts)
        ρ = 1 - dr.maximum(count - 2, 0) / count * noise / squares
        ρ = dr.select((squares > 0) & (count > 0), dr.maximum(ρ, 0), 1)
        after = {"mean": mean, "spread": spread, "last": detail, "steps": steps}
        return smooth + ρ * detail, after

    def _along(self, entries: mi.Float, tables: list[Table]) -> mi.Float:
        for (axis, _), table in zip(self.layout.axes, tables):
            entries = applied(entries, self.layout.shape, axis, table)
        return entries
