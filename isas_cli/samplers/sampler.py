"""What every pixel sampler shares: its settings, and what it does on the images of a problem."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import drjit as dr
import mitsuba as mi

from ..rendering.kernels import recorded
from ..rendering.pixels import PixelDistribution, Tiles
from ..runtime.errors import InputError
from ..scene.problem import Problem
from .stage1.cell_moments import Stage1
from .stage1.cells import Cells
from .stage1.denoise import Denoiser

if TYPE_CHECKING:
    from ..unknowns.blur import Blur


@dataclass(frozen=True)
class Stage1Settings:
    """How stage 1 looks at the images (ISAS §4.1).

    ``resolution``: cells along the longer side of a view; 0: at least 32. ``denoise``: by Open
    Image Denoise. ``average``: of a running mean of the cells' weights, each look's scaled to sum
    to one. It helps where a look is noisy and weights change slowly, and lags where they change
    fast.
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
    """Adam's moments by key, one entry per entry of the unknown, flat, in Dr.Jit's order, of ∂ℒ/∂θ
    over ``unit``, about the size of the largest key's: float32 does not hold the squares of a dim
    scene's gradients.

    ``first``: mean m of the gradient over all steps. ``noise``: what that mean, over few steps,
    keeps of the variance of the estimates. ``second``: v̂, what Adam divides by the root of,
    v / (1 - β₂ᵗ) after t steps. Where the optimiser leaves alone what a batch did not touch, v̂
    counts the untouched steps as zeros as long as t is below about 1 / (1 - β₂): the mean square
    over all steps, which is what a pmf can change. Entries that no batch has touched are 0 in all
    three. ``rate``: η of each key at present.
    """

    first: dict
    second: dict
    noise: dict
    rate: dict
    unit: float = 1.0


class Blurred(NamedTuple):
    """What an estimator blurs, and in which space: ``smooth`` is image or loss."""

    blur: Blur
    smooth: str


class OnImages:
    """A sampler on the images of one problem: state in, distribution out. It knows no optimiser and
    no files, and holds no state of a run: that is one array, the weight of every cell, which its
    caller keeps, so that loops of equal settings share their samplers.

    ``batch``: light paths of a gradient step; ``blurred``: of an estimator that has it. Nothing is
    traced yet.
    """

    # Whether one look is for the whole run: fine cells, as long as all views together stay cheap.
    lasting: ClassVar[bool] = False

    def __init__(
        self,
        settings: Sampler,
        problem: Problem,
        loss,
        batch: int,
        freeze: bool = True,
        blurred: Blurred | None = None,
    ):
        self.settings, self.problem, self.loss = settings, problem, loss
        self.cells = Cells.over(problem.film_sizes, self.resolution(batch))
        self.tiles = Tiles.over(problem.views, finest=self.cells.finest)

        def expand(weights, cells, tiles, floor):
            return PixelDistribution.from_weights(cells.upsample(weights, tiles), tiles, floor)

        self._expand = recorded(expand, problem, freeze)

    def resolution(self, batch: int) -> int:
        """Cells along the longer side of a view."""
        return self.settings.stage1.resolution or self.usual_resolution(batch)

    def usual_resolution(self, batch: int) -> int:
        """The same, where it is not set."""
        if self.lasting:
            return min(128, self._resolution_for(1 << 19))
        return self._resolution_for(batch)

    def _resolution_for(self, lanes: float) -> int:
        """Cells along the longer side at which one pass traces ``lanes`` paths; at least 32."""
        per_view = lanes / (len(self.problem.film_sizes) * self.settings.stage1.spp)
        return max(32, round(math.sqrt(per_view)))

    def look(
        self,
        values: dict,
        seed: int,
        iteration: int,
        moments: Moments | None = None,
        spent: float = 0.0,
    ) -> mi.Float:
        """Stage 1: the weight of every cell, ``(C,) float32``, any scale. Evaluates.

        ``moments``: Adam's, from the second step on, for a sampler that ``needs`` them; ``spent``:
        progress of the schedules, in [0, 1].
        """
        images = self.measured(values, seed, iteration)
        if images is None:
            raise NotImplementedError
        return self.weighed(images)

    def measured(self, values: dict, seed: int, iteration: int) -> list[mi.Color3f] | None:
        """What a look measures before it is denoised, images ``(3, C)`` over the cells whose means
        over several looks are better measurements; None where a look is no such thing."""
        return None

    def weighed(self, images: list[mi.Color3f]) -> mi.Float:
        """The weight of every cell from what was ``measured``. Evaluates."""
        raise NotImplementedError

    def blended(self, earlier: mi.Float | None, found: mi.Float) -> mi.Float:
        """The weights after a look that found ``found``: the running mean. Evaluates."""
        share = self.settings.stage1.average
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
        floor = dr.opaque(mi.Float64, self.settings.floor)
        return self._expand(weights, self.cells, self.tiles, floor)

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


class Looking(OnImages):
    """Base of samplers that look by stage 1's paths through cells."""

    def __init__(self, settings, problem, loss, batch, freeze=True, blurred=None):
        super().__init__(settings, problem, loss, batch, freeze, blurred)
        own = settings.stage1
        self._stage1 = Stage1(problem, loss, self.cells, own.spp, freeze)
        denoise = own.denoise
        self._denoise = Denoiser(self.cells, denoise) if denoise != "none" else (lambda x: x)

    @property
    def paths_per_pass(self) -> int:
        """Light paths of one path through each of a cell's random pixels."""
        return self.cells.count * self.settings.stage1.spp


@dataclass(frozen=True)
class Sampler:
    """Base of the samplers' settings; ``on`` gives the sampler at work, ``works``.

    ``floor``: share of the uniform pmf mixed in, in [0, 1]; above 0 wherever unbiasedness needs
    every pixel to be reachable. ``refresh``: iterations between looks, 0 for one look at the
    start.

    ``uses`` names the settings that mean something to a sampler; others are refused, since an
    option without effect would pass for one with.
    """

    uses: ClassVar[frozenset[str]] = frozenset(
        ("floor", "refresh", "resolution", "spp", "probes", "denoise", "average")
    )
    works: ClassVar[type[OnImages]]
    # What its looks take besides radiances: derivatives of paths, 'forward' (along a tangent) or
    # 'backward', the widths of the unknowns' 'blur', Adam's 'moments'. An estimator that does not
    # give one of these (``Estimator.gives``) does not take the sampler.
    needs: ClassVar[frozenset[str]] = frozenset()
    # Whether it draws uniformly, with a word, where the scene's integrator does not differentiate
    # paths in forward mode, instead of being refused: what is taken by itself has to do anywhere.
    forgoes: ClassVar[bool] = False
    # Whether it draws all pixels alike, as estimators that render whole images do.
    alike: ClassVar[bool] = False
    # Whether its looks leave out what rests until its stage, so that one is due where a stage
    # begins.
    staged: ClassVar[bool] = False

    floor: float = 0.05
    refresh: int = 50
    stage1: Stage1Settings = field(default_factory=Stage1Settings)

    def __post_init__(self) -> None:
        if not 0 <= self.floor <= 1:
            raise InputError(f"sampler.floor={self.floor}: must lie in [0, 1]")
        if self.refresh < 0:
            raise InputError(f"sampler.refresh={self.refresh}: 0 (once) or more iterations")
        made = {f.name: f for f in fields(self)}
        usual = made["stage1"].default_factory()  # type: ignore[operator]
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

    def on(
        self,
        problem: Problem,
        loss,
        batch: int,
        freeze: bool = True,
        blurred: Blurred | None = None,
    ) -> OnImages:
        """The sampler at work on the images of ``problem``, see ``OnImages``."""
        return self.works(self, problem, loss.pixelwise, batch, freeze, blurred)

    @property
    def name(self) -> str:
        """As it is chosen."""
        return type(self).__name__.lower()

    def due(self, iteration: int) -> bool:
        """Whether iteration ``iteration`` (0-based) starts with a look."""
        return iteration == 0 or (self.refresh > 0 and iteration % self.refresh == 0)
