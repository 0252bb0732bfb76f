"""What every estimator shares: its settings, and what is checked before targets are rendered."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from ..config.schema import MOST_LANES
from ..rendering.pixels import PixelDistribution
from ..runtime.errors import InputError
from ..samplers.sampler import Blurred, OnImages, Sampler

if TYPE_CHECKING:
    import mitsuba as mi

    from ..scene.problem import Problem


class Gradients:
    """An estimator at work on one problem and loss.

    ``problem``: its paths as they are differentiated. An estimator that learns from its steps has a
    ``memory``: arrays that are the state of one run, which are put back before its next step.
    """

    problem: Problem
    # Paths so far whose residual was not finite.
    nonfinite: int = 0
    # The share of the budget up to which no pixels are drawn.
    undrawn: float = 0.0
    # Shares of the budget at which kernels differ, for a rehearsal.
    stages: tuple[float, ...] = (0.0,)
    # Whether unknowns are blurred, by widths that follow the budget.
    blurs: bool = False
    memory: Sequence[mi.Float] = ()

    @property
    def heeds_blurs(self) -> bool:
        """Whether the width of an unknown's blur changes its gradients."""
        return self.blurs

    @property
    def paths_per_step(self) -> int:
        """Light paths of one estimate, the latest."""
        raise NotImplementedError

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
        raise NotImplementedError


class Need(NamedTuple):
    """What a sampler's look may take, as it is said where an estimator does not give it."""

    told: str
    instead: str


_PATHS = Need("looks at derivatives of paths", "take sampler=uniform or sampler=gradient")
NEEDS = {
    "forward": _PATHS,
    "backward": _PATHS,
    "blur": Need("looks at blurred renderings", "take estimator=plateau"),
    "moments": Need(
        "reads Adam's moments entry by entry", "take sampler=ours, relevant or uniform"
    ),
}


@dataclass(frozen=True)
class Estimator:
    """Settings of how gradients are estimated; ``on`` gives the estimator at work.

    ``batch``: pixels drawn per step. ``replays``: whether paths are differentiated, so that a step
    can be taken apart (``profile=true``).
    """

    name: ClassVar[str]
    # What it has for a sampler's looks, see ``NEEDS``; whether it draws pixels at all.
    gives: ClassVar[frozenset[str]] = frozenset()
    draws: ClassVar[bool] = True
    replays: ClassVar[bool] = False
    # Whether its paths are isas's own, so that fewer effects can be simulated.
    plannable: ClassVar[bool] = True
    # Whether it moves or blurs unknowns as a whole, so that none may grow by levels.
    whole: ClassVar[bool] = False
    # Whether its derivatives draw light by themselves, whatever the plan of effects says.
    own_lights: ClassVar[bool] = False
    # Whether it takes losses that read windows of pixels.
    of_windows: ClassVar[bool] = False
    # Whether it asks for pictures alone, and so could do with any renderer's.
    black_box: ClassVar[bool] = False
    # Whether it follows edges in photographs.
    outlines: ClassVar[bool] = False
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
        if not self.draws and not sampler.alike:
            raise InputError(
                f"{self.chosen} renders whole images and draws no pixels: take sampler=uniform, "
                f"not sampler={sampler.name}"
            )
        for need in sorted(sampler.needs - self.gives):
            told, instead = NEEDS.get(need, Need(f"needs {need}", "take sampler=uniform"))
            raise InputError(
                f"sampler={sampler.name} {told}, which {self.chosen} does not give: {instead}"
            )

    @property
    def chosen(self) -> str:
        """As it is typed."""
        return f"estimator={self.name}"

    def check(self, problem: Problem, sampler: Sampler, loss) -> None:
        """Raises InputError for what estimator, sampler and ``problem`` cannot do together. Needs
        no targets, which may take minutes; traces nothing."""
        self.fits(sampler)
        if problem.integrator.black_box and not self.black_box:
            raise InputError(
                f"{self.chosen} differentiates paths, and scene=external has none: take "
                "estimator=plateau or finite_differences"
            )
        if loss.windows is not None and not self.of_windows:
            raise InputError(
                f"{self.chosen} takes losses of pixels by themselves: take loss=l2, relative_l2 or "
                "l1, or estimator=two_path"
            )
        # What it cannot differentiate comes first: with no sampler could it.
        problem = self.on(problem, loss).problem
        for unknown in problem.unknowns if self.whole else ():
            if unknown.doubled:
                raise InputError(
                    f"scene.unknowns['{unknown.key}'].levels: {self.chosen} blurs and moves whole "
                    "unknowns; leave levels out"
                )
        forward = problem.integrator.has_forward or sampler.forgoes
        if "forward" in sampler.needs and not forward:
            raise InputError(
                f"sampler={sampler.name} differentiates paths in forward mode, which the scene's "
                f"integrator {problem.integrator.name} cannot: take sampler=uniform or "
                "sampler=gradient"
            )
        self.looks(sampler, problem, loss)

    def on(self, problem: Problem, loss) -> Gradients:
        """The estimator at work. Raises InputError for a problem that it cannot differentiate."""
        return self.made(self.differentiated(problem), loss)

    def differentiated(self, problem: Problem) -> Problem:
        """``problem``, with paths differentiated as the settings say."""
        return problem

    def made(self, problem: Problem, loss) -> Gradients:
        """``on`` a problem whose paths are differentiated as the settings say."""
        raise NotImplementedError

    def looks(self, sampler: Sampler, problem: Problem, loss) -> OnImages:
        """``sampler`` at work, to draw pixels of ``problem`` for this estimator."""
        # By paths, as a look's cost is to be that of a few steps.
        lanes = self.batch * self.spp
        return sampler.on(problem, loss, lanes, self.freeze, self.blurred_on(problem, sampler))

    def blurred_on(self, problem: Problem, sampler: Sampler) -> Blurred | None:
        """What it blurs, for a sampler that needs it."""
        return None

    def paths_at_once(self, problem: Problem) -> int:
        """Light paths of its largest launch, where a drawn pixel has several."""
        return self.batch

    def derivatives(self, problem: Problem) -> str:
        """How the images are differentiated, in words, for the record."""
        raise NotImplementedError


@dataclass(frozen=True)
class Comparing(Estimator):
    """Base of estimators that compare renderings at several places of parameter space and
    differentiate none. Pixels are drawn by a sampler that looks at no derivative of a path.

    ``spp``: paths of each drawn pixel in each rendering; ``freeze``: record kernels once instead of
    tracing every iteration.
    """

    whole: ClassVar[bool] = True
    black_box: ClassVar[bool] = True

    freeze: bool = True  # type: ignore[misc]
    spp: int = 1  # type: ignore[misc]

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least_one(self, "spp")
        if 2 * self.batch * self.spp > MOST_LANES:
            raise InputError(
                f"estimator.spp={self.spp} times estimator.batch={self.batch}: at most "
                f"{MOST_LANES // 2} paths a rendering"
            )

    def paths_at_once(self, problem: Problem) -> int:
        return 2 * self.batch * self.spp  # a loss is of two renderings


def at_least_one(settings, *names: str) -> None:
    for name in names:
        if getattr(settings, name) < 1:
            raise InputError(f"estimator.{name}={getattr(settings, name)}: at least 1")


def choice(name: str, value: str, valid: Iterable[str]) -> None:
    if value not in valid:
        raise InputError(f"estimator.{name}={value}: valid: {', '.join(valid)}")
