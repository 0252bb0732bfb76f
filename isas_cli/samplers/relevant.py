"""Uniform over the pixels that see an unknown."""

from __future__ import annotations

from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi

from .sampler import Sampler, Stage1Settings
from .stage1.cell_moments import Stage1


@dataclass
class Relevant(Sampler):
    """p_j ∝ 1 where some path through the pixel's cell depends on an unknown, else 0.

    A path depends on an unknown when its derivative along a random-sign tangent is not zero.
    The mask is taken once, grown by one cell, and ``floor`` keeps what it missed reachable, so
    the estimate stays unbiased. What any mask would do: without it in the comparison, a cleverer
    sampler is praised for not looking at the background.
    """

    uses = Sampler.uses - {"denoise"}
    needs = frozenset(("forward",))

    refresh: int = 0
    stage1: Stage1Settings = field(default_factory=lambda: Stage1Settings(spp=2, denoise="none"))

    def resolution(self, problem, batch: int) -> int:
        # One look is for the whole run: fine cells, as long as all views together stay cheap.
        return self.stage1.resolution or min(128, self._resolution_for(problem, 1 << 19))

    def prepare(self, problem, loss, batch: int, freeze: bool = True) -> None:
        super().prepare(problem, loss, batch, freeze)
        self._stage1 = Stage1(problem, loss, self.cells, self.stage1.spp, freeze)

    def look(self, values: dict, seed: int, iteration: int, moments=None) -> mi.Float:
        moment = self._stage1.second_moment(values, self.stage1.probes, seed, iteration)
        seen = dr.select(dr.sum(moment) > 0, mi.Float(1), 0)
        dr.eval(seen)
        weights = self.cells.dilate(seen)
        dr.eval(weights)
        return weights

    @property
    def paths_per_look(self) -> int:
        derivatives = self.paths_per_derivative * self.stage1.probes
        return self.cells.count * self.stage1.spp * derivatives
