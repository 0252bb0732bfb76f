"""Differences of renderings by single numbers whose derivative no path carries."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..rendering import rays
from ..rendering.kernels import recorded
from ..rendering.pixels import PixelDistribution
from ..runtime.errors import InputError
from ..scene.problem import Problem
from ..unknowns.parameters import as_numpy
from ..unknowns.unknowns import Unknown

# Of the range to each side, or of the number or its start where that has no end; and the least of
# it where there is no other measure.
_STEP, _LEAST = 0.01, 1e-3


class Aside:
    """∂ℒ/∂θ_k for each entry k of the unknowns that Mitsuba does not differentiate by itself
    (``Kind.aside``), beside path replay for all others: from the same drawn pixels,

        1/N Σ_i ⟨∂ℒ/∂I⟩_{j_i} (I_{j_i}(θ + h e_k) - I_{j_i}(θ - h e_k)) / 2h / p_{j_i} .

    Both sides along paths of the same random numbers, ∂ℒ/∂I from a path of its own. h is a
    hundredth of the unknown's range, or of what it is where that has no end; at the range's ends
    the difference is to one side. What rests is not rendered for.

    Bias: O(h²) of the images' third derivative, O(h) at an end, beside that of a loss whose
    derivative is not linear. Entries k cost two paths a pixel each, and one for all.
    """

    def __init__(self, problem: Problem, loss, batch: int, freeze: bool):
        self.problem, self.batch = problem, batch
        self.unknowns = self._moving = [u for u in problem.unknowns if u.kind.aside]
        if self.unknowns and loss.windows is not None:
            raise InputError(
                f"scene.unknowns: '{self.unknowns[0].key}' is found by differences of pixels by "
                "themselves: take loss=l2, relative_l2 or l1"
            )
        integrator = problem.integrator

        def shown(scene, sensors, views, leaves, distribution, targets, mask, seeds):
            """Radiance of a path of each drawn pixel, and what ∂ℒ/∂I it makes over p N."""
            with dr.suspend_grad():
                *place, probability = distribution.draw(batch, seeds[0])
                pixel = views.index(*place)
                dr.eval(*place, pixel, probability)
                stream = rays.stream(seeds[1], batch)
                radiance = rays.radiance(integrator, scene, sensors, views, place, stream)
                dr.eval(radiance)
                target = dr.gather(mi.Color3f, targets, pixel)
                residual = rays.sound(loss.derivative(radiance, target), radiance)
                residual = rays.masked(residual / (probability * batch), mask, pixel)
                dr.eval(residual)
            return radiance, residual

        self._shown = recorded(shown, problem, freeze)
        self._lost = dr.opaque(mi.UInt32, 0)

    @property
    def paths_per_step(self) -> int:
        """Light paths of one estimate, the latest."""
        entries = sum(unknown.start.size for unknown in self._moving)
        return self.batch * (1 + 2 * entries if entries else 0)

    @property
    def nonfinite(self) -> int:
        """Products so far that were left out as they were not finite. Waits."""
        return int(self._lost[0])

    def sides(
        self,
        values: dict,
        distribution: PixelDistribution,
        seed: int,
        iteration: int,
        spent: float,
    ):
        """By key of what moves at the share ``spent`` of the budget, for each entry, the difference
        of both sides' images over 2h. Leaves the scene at other values than ``values``. Evaluates.
        """
        self._moving = [unknown for unknown in self.unknowns if unknown.moves(spent)]
        return {
            unknown.key: self._slopes(unknown, values, distribution, seed, iteration)
            for unknown in self._moving
        }

    def gradients(self, slopes: dict, distribution, seed: int, iteration: int) -> dict:
        """The estimate by key, of the scene's types, from ``sides``, and 0 of what rests; with the
        scene at the values again. Waits."""
        found = {u.key: np.zeros(u.start.shape, np.float32) for u in self.unknowns}
        if slopes:
            residual = self._render(distribution, seed, iteration, "primal")[1]
        for key, each in slopes.items():
            sums = np.array([self._sum(dr.sum(residual * slope)) for slope in each])
            sums *= float(self.problem.share[0])
            found[key] = sums.reshape(found[key].shape).astype(np.float32)
        return self.problem.unknowns.values_of(found)

    def _sum(self, terms: mi.Float) -> float:
        dr.eval(terms)
        whole = dr.isfinite(terms)
        self._lost += dr.count(~whole)
        dr.eval(self._lost)
        return float(dr.sum(dr.select(whole, terms, 0))[0])

    def _slopes(self, unknown: Unknown, values: dict, *drawn) -> list[mi.Color3f]:
        unknowns, array, found = self.problem.unknowns, as_numpy(values[unknown.key]), []
        for entry in range(array.size):
            images, places = [], _sides(unknown, float(array.flat[entry]))
            for place in places:
                moved = array.copy()
                moved.flat[entry] = place
                unknowns.write(values | unknowns.values_of({unknown.key: moved}))
                images.append(self._render(*drawn, "aside")[0])
            found.append((images[1] - images[0]) / (places[1] - places[0]))
        return found

    def _render(self, distribution, seed: int, iteration: int, purpose: str):
        p = self.problem
        seeds = rays.seeds(seed, iteration, "draw", purpose)
        return self._shown(*p.traced, distribution, p.targets, p.mask, seeds)


def _sides(unknown: Unknown, place: float) -> tuple[float, float]:
    wide = unknown.high - unknown.low
    if not np.isfinite(wide):  # in whatever unit
        wide = max(abs(place), float(np.abs(unknown.start).max()))
    step = _STEP * wide or _LEAST
    return max(unknown.low, place - step), min(unknown.high, place + step)
