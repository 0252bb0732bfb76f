"""Uniform over the pixels that see an unknown."""

from __future__ import annotations

from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi

from .sampler import Looking, Sampler, Stage1Settings


class Mask(Looking):
    """``Relevant`` at work."""

    settings: Relevant
    lasting = True

    def look(self, values, seed, iteration, moments=None, spent=0.0) -> mi.Float:
        probes = self.settings.stage1.probes
        moment = self._stage1.second_moment(values, probes, seed, iteration)
        if (counting := self._stage1.counting(seed, iteration)) is not None:
            moment *= counting
        seen = dr.select(dr.sum(moment) > 0, mi.Float(1), 0)
        dr.eval(seen)
        weights = self.cells.dilate(seen)
        dr.eval(weights)
        return weights

    @property
    def paths_per_look(self) -> int:
        return self.paths_per_pass * self.settings.stage1.probes * self.paths_per_derivative


@dataclass(frozen=True)
class Relevant(Sampler):
    """p_j ∝ 1 where some path through the pixel's cell depends on an unknown, else 0.

    A path depends on an unknown when its derivative along a random-sign tangent is not zero.
    The mask is taken once, grown by one cell, and ``floor`` keeps what it missed reachable, so
    the estimate stays unbiased. What any mask would do: without it in the comparison, a cleverer
    sampler is praised for not looking at the background.
    """

    uses = Sampler.uses - {"denoise"}
    needs = frozenset(("forward",))
    works = Mask

    refresh: int = 0
    stage1: Stage1Settings = field(default_factory=lambda: Stage1Settings(spp=2, denoise="none"))
