"""What every estimator shares: its settings, and what is checked before targets are rendered."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

from ..config.schema import MOST_LANES
from ..rendering.pixels import PixelDistribution
from ..runtime.errors import InputError
from ..samplers.sampler import Sampler

if TYPE_CHECKING:
    from ..scene.problem import Problem


class Gradients(Protocol):
    """An estimator at work on one problem and loss."""

    @property
    def paths_per_step(self) -> int:
        """Light paths of one estimate."""

    def estimate(
        self,
        values: dict,
        distribution: PixelDistribution,
        seed: int,
        iteration: int,
        spent: float,
    ) -> dict:
        """The gradient at ``values``, by key, in the unknowns' own shapes, from pixels drawn by
        ``distribution``; ``seed``, ``iteration``: the random streams; ``spent``: share of the
        budget, in [0, 1]."""


@dataclass
class Estimator:
    """Settings of how gradients are estimated; knows nothing of a run.

    ``batch``: pixels drawn per step. ``replays``: whether paths are differentiated, so that a step
    can be taken apart (``profile=true``).
    """

    replays: ClassVar[bool] = False
    # Whether its paths are isas's own, so that fewer effects can be simulated.
    plannable: ClassVar[bool] = True
    # Where there is no setting of that name: paths of a drawn pixel in a rendering, and whether
    # kernels are recorded once instead of being traced every iteration.
    spp: ClassVar[int] = 1
    freeze: ClassVar[bool] = True

    batch: int = 65536

    def __post_init__(self) -> None:
        at_least_one(self, "batch")
        if self.batch > MOST_LANES:
            raise InputError(f"estimator.batch={self.batch}: at most {MOST_LANES}")

    def fits(self, sampler: Sampler) -> None:
        """Raises InputError for a sampler whose pixels it cannot use. Needs no scene."""
        raise NotImplementedError

    def check(self, problem: "Problem", sampler: Sampler, loss) -> None:
        """Raises InputError for what estimator, sampler and ``problem`` cannot do together. Needs
        no targets, which may take minutes; traces nothing."""
        self.fits(sampler)
        problem = self.on(problem)
        # What it cannot differentiate comes first: with no sampler could it.
        self.made(problem, loss)
        if "forward" in sampler.needs and not problem.integrator.has_forward:
            raise InputError(
                f"sampler={sampler.name} differentiates paths in forward mode, which the scene's "
                f"integrator {problem.integrator.name} cannot: take sampler=uniform or "
                "sampler=gradient"
            )
        self.prepare(problem, sampler, loss)

    def on(self, problem: "Problem") -> "Problem":
        """``problem``, with paths differentiated as the settings say."""
        return problem

    def prepare(self, problem: "Problem", sampler: Sampler, loss) -> None:
        """Prepare ``sampler`` to draw pixels for this estimator."""
        # By paths, as a look's cost is to be that of a few steps.
        sampler.prepare(problem, loss, self.batch * self.spp, self.freeze)

    def made(self, problem: "Problem", loss) -> Gradients:
        """The estimator at work. Raises InputError for a problem that it cannot differentiate."""
        raise NotImplementedError

    def derivatives(self, problem: "Problem") -> str:
        """How the images are differentiated, in words, for the record."""
        raise NotImplementedError


@dataclass
class Comparing(Estimator):
    """Base of estimators that compare renderings at several places of parameter space and
    differentiate none. Pixels are drawn by a sampler that looks at no derivative of a path.

    ``spp``: paths of each drawn pixel in each rendering; ``freeze``: record kernels once instead of
    tracing every iteration.
    """

    freeze: bool = True
    spp: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least_one(self, "spp")
        if 2 * self.batch * self.spp > MOST_LANES:
            raise InputError(
                f"estimator.spp={self.spp} times estimator.batch={self.batch}: at most "
                f"{MOST_LANES // 2} paths a rendering"
            )

    def fits(self, sampler: Sampler) -> None:
        if sampler.needs & {"forward", "backward"}:
            raise InputError(
                f"sampler={sampler.name} looks at derivatives of paths, which "
                f"estimator={self.name} does not take; valid: {', '.join(self.samplers)}"
            )

    name: ClassVar[str]
    samplers: ClassVar[tuple[str, ...]] = ("uniform", "gradient")


def whole_images(sampler: Sampler, where: str) -> None:
    """Raises InputError, naming ``where``, for a sampler that leaves pixels out."""
    if sampler.name != "uniform":
        raise InputError(
            f"{where} renders whole images and draws no pixels: take sampler=uniform, not "
            f"sampler={sampler.name}"
        )


def at_least_one(settings, *names: str) -> None:
    for name in names:
        if getattr(settings, name) < 1:
            raise InputError(f"estimator.{name}={getattr(settings, name)}: at least 1")


def choice(name: str, value: str, valid: Iterable[str]) -> None:
    if value not in valid:
        raise InputError(f"estimator.{name}={value}: valid: {', '.join(valid)}")
