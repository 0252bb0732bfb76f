"""What every pixel sampler shares: settings, cells, and the way from cells to a distribution."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import ClassVar

import drjit as dr
import mitsuba as mi

from ..rendering.kernels import recorded
from ..rendering.pixels import PixelDistribution, Tiles
from ..runtime.errors import InputError
from ..scene.problem import Problem
from .stage1.cells import Cells


@dataclass
class Stage1Settings:
    """How stage 1 looks at the images (ISAS §4.1).

    ``resolution``: cells along the longer side of a view; 0 chooses it so that one look traces
    about as many paths as one gradient step, at least 32 (``relevant``, ``balanced`` and
    ``progress``, which look once or rarely, take more). ``spp``: random pixels per cell, one path
    each. ``probes``: tangents per look. ``denoise``: none, fast, balanced or high (Open Image
    Denoise). ``average``: share of what earlier looks found that is kept at a new look, in [0, 1):
    a running mean of the cells' weights, each look's scaled to sum to one. It helps where a look
    is noisy and the weights change slowly, and lags where they change fast.
    """

    resolution: int = 0
    spp: int = 1
    probes: int = 1
    denoise: str = "fast"
    average: float = 0.0

    def __post_init__(self) -> None:
        if self.resolution < 0:
            raise InputError(f"sampler.stage1.resolution={self.resolution}: 0 (auto) or more")
        for name in ("spp", "probes"):
            if getattr(self, name) < 1:
                raise InputError(f"sampler.stage1.{name}={getattr(self, name)}: at least 1")
        if self.denoise not in ("none", "fast", "balanced", "high"):
            raise InputError(
                f"sampler.stage1.denoise={self.denoise}: valid: none, fast, balanced, high"
            )
        if not 0 <= self.average < 1:
            raise InputError(f"sampler.stage1.average={self.average}: must lie in [0, 1)")


@dataclass
class Moments:
    """Adam's moments by key, one entry per entry of the unknown, flat, in Dr.Jit's order.

    ``first``: mean m of the gradient over all steps, in the unit of ∂ℒ/∂θ. ``noise``: what that
    mean, over few steps, keeps of the variance of the estimates. ``second``: v̂, what Adam divides
    by the root of, v / (1 - β₂ᵗ) after t steps. Where the optimiser leaves alone what a batch did
    not touch, v̂ counts the untouched steps as zeros as long as t is below about 1 / (1 - β₂): the
    mean square over all steps, which is what a pmf can change. Entries that no batch has touched
    are 0 in all three. ``rate``: η of each key at present.
    """

    first: dict
    second: dict
    noise: dict
    rate: dict


@dataclass
class Sampler:
    """Base of all samplers. State in, distribution out; knows no optimiser and no files.

    ``floor``: share of the uniform pmf mixed in, in [0, 1]; above 0 wherever unbiasedness needs
    every pixel to be reachable. ``refresh``: iterations between looks, 0 for one look at the
    start. The state is one array, the weight of every cell, so that it can be saved.

    ``uses`` names the settings that mean something to a sampler; others are refused, since an
    option without effect would pass for one with.
    """

    uses: ClassVar[frozenset[str]] = frozenset(
        ("floor", "refresh", "resolution", "spp", "probes", "denoise", "average")
    )
    needs_moments: ClassVar[bool] = False
    # What its looks take besides radiances: derivatives of paths, 'forward' (along a tangent) or
    # 'backward', or the widths of the unknowns' 'blur'.
    needs: ClassVar[frozenset[str]] = frozenset()
    # Progress of the schedules at the next look, told by the loop.
    scheduled: ClassVar[float] = 0.0

    floor: float = 0.05
    refresh: int = 50
    stage1: Stage1Settings = field(default_factory=Stage1Settings)

    def __post_init__(self) -> None:
        if not 0 <= self.floor <= 1:
            raise InputError(f"sampler.floor={self.floor}: must lie in [0, 1]")
        if self.refresh < 0:
            raise InputError(f"sampler.refresh={self.refresh}: 0 (once) or more iterations")
        made = {f.name: f for f in fields(self)}
        usual = made["stage1"].default_factory()
        for f in fields(usual):
            self._refuse_unused(f"stage1.{f.name}", getattr(self.stage1, f.name), vars(usual))
        for name in ("floor", "refresh"):
            self._refuse_unused(name, getattr(self, name), {name: made[name].default})

    def _refuse_unused(self, where: str, value, usual: dict) -> None:
        name = where.rpartition(".")[2]
        if name not in self.uses and value != usual[name]:
            raise InputError(
                f"sampler.{where}={value}: {self.name} has no use for it; leave it out"
            )

    def prepare(self, problem: Problem, loss, batch: int, freeze: bool = True) -> None:
        """Build what depends on the problem. Nothing is traced yet."""
        self.problem, self.loss = problem, loss
        self.cells = Cells.over(problem.film_sizes, self.resolution(problem, batch))
        self.tiles = Tiles.over(problem.views, finest=self.cells.finest)

        def expand(weights, cells, tiles, floor):
            return PixelDistribution.from_weights(cells.upsample(weights, tiles), tiles, floor)

        self._expand = recorded(expand, problem, freeze)

    @property
    def name(self) -> str:
        """As it is chosen."""
        return type(self).__name__.lower()

    def resolution(self, problem: Problem, batch: int) -> int:
        """Cells along the longer side of a view."""
        if self.stage1.resolution:
            return self.stage1.resolution
        return self._resolution_for(problem, batch)

    def _resolution_for(self, problem: Problem, lanes: float) -> int:
        """Cells along the longer side at which one pass traces ``lanes`` paths; at least 32."""
        per_view = lanes / (len(problem.film_sizes) * self.stage1.spp)
        return max(32, round(math.sqrt(per_view)))

    def due(self, iteration: int) -> bool:
        """Whether iteration ``iteration`` (0-based) starts with a look."""
        return iteration == 0 or (self.refresh > 0 and iteration % self.refresh == 0)

    def look(
        self, values: dict, seed: int, iteration: int, moments: Moments | None = None
    ) -> mi.Float:
        """Stage 1: the weight of every cell, ``(C,) float32``, any scale. Evaluates.

        ``moments``: where ``needs_moments``, from the second step on.
        """
        raise NotImplementedError

    def measured(self, values: dict, seed: int, iteration: int) -> list[mi.Color3f] | None:
        """What a look measures before it is denoised, images ``(3, C)`` over the cells whose means
        over several looks are better measurements; None where a look is no such thing."""
        return None

    def weighed(self, images: list[mi.Color3f]) -> mi.Float:
        """The weight of every cell from what was ``measured``. Evaluates."""
        raise NotImplementedError

    def blended(self, earlier: mi.Float | None, found: mi.Float) -> mi.Float:
        """The weights after a look that found ``found``: the running mean. Evaluates."""
        share = self.stage1.average
        if earlier is None or share == 0:
            return found

        def normalised(weights):
            weights = dr.select(dr.isfinite(weights) & (weights > 0), weights, 0)
            total = dr.sum(weights)
            return weights * dr.select(total > 0, dr.rcp(total), 0)

        weights = dr.lerp(normalised(found), normalised(earlier), dr.opaque(mi.Float, share))
        dr.eval(weights)
        return weights

    def distribution(self, weights: mi.Float) -> PixelDistribution:
        """The pmf over all pixels that the cells' weights stand for."""
        return self._expand(weights, self.cells, self.tiles, dr.opaque(mi.Float64, self.floor))

    @property
    def paths_per_derivative(self) -> int:
        """Light paths behind one derivative of a pixel."""
        return self.problem.integrator.paths_per_derivative

    @property
    def paths_per_look(self) -> int:
        """Light paths that one look traces."""
        return 0

    @property
    def paths_before(self) -> int:
        """Light paths that the first look traces beyond ``paths_per_look``."""
        return 0
