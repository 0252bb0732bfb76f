"""More paths where targets are dark, as errors show there: by the targets alone."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from isas_cli.runtime.errors import InputError
from isas_cli.samplers.sampler import OnImages, Sampler


class Darkness(OnImages):
    """``Dark`` at work on the images of one problem: ``self.problem``, cut into ``self.cells``."""

    settings: Dark

    def look(self, values, seed, iteration, moments=None, spent=0.0) -> mi.Float:
        views, count = self.problem.views, self.problem.views.total
        target = dr.gather(mi.Color3f, self.problem.targets, dr.arange(mi.UInt32, count))
        view, column, row = views.locate(dr.arange(mi.UInt32, count))
        cell = self.cells.views.index(
            view,
            mi.UInt32(mi.Float(column) / dr.gather(mi.Float, self.cells.scale_x, view)),
            mi.UInt32(mi.Float(row) / dr.gather(mi.Float, self.cells.scale_y, view)),
        )
        sums, pixels = (dr.zeros(mi.Float, self.cells.count) for _ in range(2))
        dr.scatter_reduce(dr.ReduceOp.Add, sums, dr.maximum(dr.mean(target), 0), cell)
        dr.scatter_reduce(dr.ReduceOp.Add, pixels, mi.Float(1), cell)
        bright = sums / dr.maximum(pixels, 1)
        mean = dr.mean(bright) + 1e-6
        weights = dr.power(mean / (mean + bright), self.settings.power)
        dr.eval(weights)
        return weights


@dataclass(frozen=True)
class Dark(Sampler):
    """p_j ∝ (m / (m + T_j))^power, T_j the target's mean over a cell, m that over all.

    Unbiased as long as ``floor`` is above 0, as the estimator divides by p.
    """

    # Of the settings that samplers share, what means something here; others are refused.
    uses = frozenset(("floor",))
    works = Darkness

    refresh: int = 0  # one look, at the start: targets do not change
    power: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.power > 0:
            raise InputError(f"sampler.power={self.power}: must be above 0")
