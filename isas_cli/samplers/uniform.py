"""Every pixel alike: the usual mini-batch."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..rendering.pixels import PixelDistribution
from .sampler import OnImages, Sampler


class Alike(OnImages):
    """``Uniform`` at work."""

    def resolution(self, batch: int) -> int:
        return 1

    def look(self, values, seed, iteration, moments=None, spent=0.0) -> mi.Float:
        return dr.opaque(mi.Float, 1, self.cells.count)

    def distribution(self, weights: mi.Float) -> PixelDistribution:
        return PixelDistribution.uniform(self.tiles)


@dataclass(frozen=True)
class Uniform(Sampler):
    """p_j = 1/n. Needs no look at the images; stratified draws all the same."""

    uses = frozenset()
    works = Alike
    alike = True

    refresh: int = 0
