"""What every pixel sampler shares: settings, cells, and the way from cells to a distribution."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi

from ..errors import InputError
from ..pixels import PixelDistribution
from ..problem import Problem
from .cells import Cells


@dataclass
class Stage1Settings:
    """How stage 1 looks at the images (ISAS §4.1).

    ``resolution``: cells along the longer side of a view; 0 chooses it so that one look traces
    about as many paths as one gradient step, at least 32. ``samples``: random pixels per cell,
    one path each. ``probes``: random-sign tangents per look. ``denoise``: none, fast, balanced
    or high (Open Image Denoise).
    """

    resolution: int = 0
    samples: int = 1
    probes: int = 1
    denoise: str = "fast"

    def __post_init__(self) -> None:
        if self.resolution < 0:
            raise InputError(f"sampler.stage1.resolution={self.resolution}: 0 (auto) or more")
        for name in ("samples", "probes"):
            if getattr(self, name) < 1:
                raise InputError(f"sampler.stage1.{name}={getattr(self, name)}: at least 1")
        if self.denoise not in ("none", "fast", "balanced", "high"):
            raise InputError(
                f"sampler.stage1.denoise={self.denoise}: valid: none, fast, balanced, high"
            )


@dataclass
class Sampler:
    """Base of all samplers. State in, distribution out; knows no optimiser and no files.

    ``floor``: share of the uniform pmf mixed in, in [0, 1]; above 0 wherever unbiasedness needs
    every pixel to be reachable. ``refresh``: iterations between looks, 0 for one look at the
    start. The state is one array, the weight of every cell, so that it can be saved.
    """

    floor: float = 0.05
    refresh: int = 20
    stage1: Stage1Settings = field(default_factory=Stage1Settings)

    def __post_init__(self) -> None:
        if not 0 <= self.floor <= 1:
            raise InputError(f"sampler.floor={self.floor}: must lie in [0, 1]")
        if self.refresh < 0:
            raise InputError(f"sampler.refresh={self.refresh}: 0 (once) or more iterations")

    def prepare(self, problem: Problem, loss, batch: int, freeze: bool = True) -> None:
        """Build what depends on the problem. Nothing is traced yet."""
        self.problem, self.loss = problem, loss
        self.cells = Cells.over(problem.film_sizes, self.resolution(problem, batch))

        def expand(weights, cells, views, floor):
            return PixelDistribution.from_weights(cells.upsample(weights, views), floor)

        self._expand = dr.freeze(expand) if freeze else expand

    def resolution(self, problem: Problem, batch: int) -> int:
        """Cells along the longer side of a view."""
        if self.stage1.resolution:
            return self.stage1.resolution
        per_view = batch / (len(problem.film_sizes) * self.stage1.samples)
        return max(32, round(math.sqrt(per_view)))

    def due(self, iteration: int) -> bool:
        """Whether iteration ``iteration`` (0-based) starts with a look."""
        return iteration == 0 or (self.refresh > 0 and iteration % self.refresh == 0)

    def look(self, values: dict, base: int, iteration: int) -> mi.Float:
        """Stage 1: the weight of every cell, ``(C,) float32``, any scale. Evaluates."""
        raise NotImplementedError

    def distribution(self, weights: mi.Float) -> PixelDistribution:
        """The pmf over all pixels that the cells' weights stand for."""
        return self._expand(
            weights, self.cells, self.problem.views, dr.opaque(mi.Float64, self.floor)
        )

    @property
    def paths_per_look(self) -> int:
        """Light paths that one look traces."""
        return 0
