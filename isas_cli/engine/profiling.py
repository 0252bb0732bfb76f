"""Where the time of an iteration goes: measured after a run, from its last state, unbilled.

The frozen step traces both of a pixel's paths, differentiates and scatters in one or two kernels,
so the phases cannot be read off a clock. Three cut-down steps run beside the whole one, on the
same draws and with the same random numbers, each ending one phase later:

    drawing    t₁: a step that ends with the drawn pixels
    primal     t₂ - t₁: … with the radiance of the first path, or of both where both are
               differentiated, and the loss derivative
    adjoint    t₃ - t₂: … with the paths' derivatives taken *forward* along a tangent, which
               needs the same paths and partial derivatives and gives one number per channel
               where the whole step adds to every unknown that a path meets
    scatter    t₄ - t₃: the whole estimate, up to gradients in the unknowns' own order: clearing
               and reducing the gradient arrays too

t: the sum of the kernels' execution times as Dr.Jit counts them. A difference of two measurements
may come out slightly negative where a phase is cheap. Forward differentiation gathers tangents
where the backward pass scatters, so what scatter shows is that much too small. Checked on pottery
against a texture whose derivative is summed into one factor instead of scattered: with 1024² texels
t₄ - t₃ was 14 to 15 ms of 87 ms by the forward pass and 15 to 16 ms by the factor, with 256² not to
be told from zero by either.

    Adam       kernels of the step on the unknowns, projection included
    update     kernels that put new values into the scene
    stage 1    what the run was billed for it, per iteration (its own host time included)
    host       wall time of a step, less the kernels': Python, tracing, launches

Wall times are taken without counting kernels, alternating with the counted steps. Nothing of this
touches a run's record or state: draws have iteration numbers of their own, out of any run's reach,
and values and moments are put back to the bit.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pandas
from rich.table import Table

from ..estimators.renderings import draw_kernel
from ..estimators.two_path import TwoPath
from ..records import write_text
from ..rendering.kernels import recorded
from ..runtime import streams
from ..runtime.backend import sync
from ..runtime.clock import Clock
from ..unknowns.parameters import flat, unflat
from .loop import Loop

FILE = "profile.csv"
# Rounds measured, and the seconds after which there are fewer; at least a few in any case.
_ROUNDS, _SECONDS, _LEAST = 50, 15.0, 5
_WARM_UP = 4  # recording a frozen kernel takes two or three calls
_BASE = 1 << 25  # iteration numbers beyond those of runs and of their rehearsals


@dataclass(frozen=True)
class Phase:
    """One row: milliseconds per iteration (median, quartiles), share of the billed time, and
    ``how`` they were measured: as kernels' times, as a difference of two measurements, or as billed
    in the run."""

    phase: str
    milliseconds: float
    low: float
    high: float
    share: float
    how: str


@dataclass(frozen=True)
class Profile:
    """``rounds``: how many iterations were measured; ``run``: milliseconds per iteration that the
    run itself was billed."""

    phases: list[Phase]
    rounds: int
    run: float


_HOW = {
    "drawing": "kernels",
    "primal": "difference",
    "adjoint": "difference",
    "scatter": "difference",
    "Adam": "kernels",
    "update": "kernels",
    "stage 1": "billed",
    "host": "difference",
}


def _up_to_primal(integrator, scene, streams, rays, adjoints) -> None:
    """What derivatives are weighted with, and none."""
    dr.eval(adjoints(integrator.radiances(scene, streams, rays)))


def _up_to_adjoint(integrator, scene, streams, rays, adjoints) -> None:
    """A derivative that is summed over the unknowns instead of scattered to them."""
    integrator.pair(scene, streams, rays, adjoints, dr.ADMode.Forward)


class _Pass:
    """The whole step of a loop and the cut-down ones, timed."""

    def __init__(self, loop: Loop, freeze: bool):
        self.loop = loop
        problem, whole = loop.problem, loop.estimator
        shared = problem, whole.loss, whole.batch, freeze
        self._cut = {
            "primal": TwoPath(*shared, _up_to_primal),
            "adjoint": TwoPath(*shared, _up_to_adjoint),
        }
        self._draw = recorded(draw_kernel(whole.batch), problem, freeze)
        # A frozen function evaluates all that its arguments hold, which nothing else does for a
        # scene: new values would be counted where they are first used.
        self._evaluate = recorded(lambda scene, one: one + 1, None)

    def _settle(self) -> None:
        self._evaluate(self.loop.problem.scene, dr.opaque(mi.Float, 1))

    def step(self, iteration: int) -> dict[str, float]:
        """Milliseconds of each phase but stage 1. Evaluates."""
        wall = self._wall(iteration)
        counted = self._kernels(iteration)
        host = wall - sum(counted[phase] for phase in ("estimate", "Adam", "update"))
        ends = [0.0, *(counted[end] for end in ("drawing", "primal", "adjoint", "estimate"))]
        names = ("drawing", "primal", "adjoint", "scatter")
        steps = dict(zip(names, np.diff(ends).tolist()))
        return steps | {"Adam": counted["Adam"], "update": counted["update"], "host": host}

    def _wall(self, iteration: int) -> float:
        unknowns, stepper, clock = self.loop.problem.unknowns, self.loop.stepper, Clock()
        with clock.billed("step"):
            unknowns.attach(stepper.values)
            self._estimate(self.loop.estimator, iteration)
            stepper.step(unknowns.gradients(), self.loop.scheduled)
        return 1e3 * clock.seconds

    def _kernels(self, iteration: int) -> dict[str, float]:
        loop, unknowns, stepper = self.loop, self.loop.problem.unknowns, self.loop.stepper
        spent = {}
        unknowns.write(stepper.values)
        self._settle()
        with _count(spent, "drawing"):
            seed = dr.opaque(mi.UInt32, streams.seed(loop.seed, iteration, "draw"))
            self._draw(loop.problem.views, loop._distribution, seed)
        with _count(spent, "primal"):
            self._estimate(self._cut["primal"], iteration)
        tangents = {
            key: unflat(value, dr.full(mi.Float, 1, dr.width(flat(value))))
            for key, value in stepper.values.items()
        }
        unknowns.push_tangent(stepper.values, tangents)
        self._settle()
        with _count(spent, "adjoint"):
            self._estimate(self._cut["adjoint"], iteration)
        with _count(spent, "update"):
            unknowns.attach(stepper.values)
            self._settle()
        with _count(spent, "estimate"):
            self._estimate(loop.estimator, iteration)
            gradients = unknowns.gradients()
            dr.eval(gradients)
        with _count(spent, "Adam"):
            stepper.step(gradients, loop.scheduled)
        return spent

    def _estimate(self, estimator: TwoPath, iteration: int) -> None:
        estimator.accumulate(self.loop._distribution, self.loop.seed, iteration)


@contextmanager
def _count(spent: dict[str, float], name: str) -> Iterator[None]:
    """Milliseconds that the kernels launched within take, one after the other."""
    sync()
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        yield
        sync()
        spent[name] = sum(kernel["execution_time"] for kernel in dr.kernel_history())


def measure(loop: Loop, freeze: bool) -> Profile:
    """Profile ``loop``, which has run, where it stands; ``freeze`` as its estimator has it.

    Values and moments of the loop are afterwards what they were, and the scene holds the values
    without derivatives. Evaluates.
    """
    stepper = loop.stepper
    arrays, state = stepper.export()
    way = stepper.begun, dict(stepper.reach), stepper.since
    try:
        steps = _measured(_Pass(loop, freeze))
    finally:
        stepper.restore(arrays, state)
        stepper.begun, stepper.reach, stepper.since = way
        loop.problem.unknowns.write(stepper.values)
    times = {name: [step[name] for step in steps] for name in steps[0]}
    per_iteration = 1e3 / loop.position.iteration
    times["stage 1"] = [per_iteration * loop.clock.billed_seconds["stage1"]]
    billed = sum(float(np.median(values)) for values in times.values())
    phases = []
    for name, how in _HOW.items():
        low, middle, high = np.quantile(times[name], [0.25, 0.5, 0.75]).tolist()
        phases.append(Phase(name, middle, low, high, middle / billed, how))
    return Profile(phases, len(steps), per_iteration * loop.clock.seconds)


def _measured(timed: _Pass) -> list[dict[str, float]]:
    for i in range(_WARM_UP):
        timed.step(_BASE + i)
    steps, begin = [], time.perf_counter()
    while len(steps) < _ROUNDS:
        steps.append(timed.step(_BASE + _WARM_UP + len(steps)))
        if len(steps) >= _LEAST and time.perf_counter() - begin > _SECONDS:
            break
    return steps


def write(profile: Profile, folder: Path) -> None:
    """profile.csv. Raises IsasError, one line naming the file, when the disk refuses."""
    names = [field.name for field in fields(Phase)]
    rows = pandas.DataFrame(map(asdict, profile.phases), columns=names)
    write_text(folder / FILE, rows.to_csv(index=False))


def table(profile: Profile) -> Table:
    """What a person sees, with a word on how it was measured."""
    shown = Table(box=None, pad_edge=False, caption_justify="left", caption=_caption(profile))
    shown.add_column("phase", no_wrap=True)
    for title in ("ms per iteration", "quartiles", "billed time"):
        shown.add_column(title, justify="right", no_wrap=True)
    shown.add_column("measured as")
    for p in profile.phases:
        span = f"{p.low:.2f} … {p.high:.2f}"
        shown.add_row(p.phase, f"{p.milliseconds:.2f}", span, f"{p.share:.1%}", p.how)
    return shown


def _caption(profile: Profile) -> str:
    total = sum(phase.milliseconds for phase in profile.phases)
    return (
        f"{total:.2f} ms in all, from {profile.rounds} iterations after the run and from its last "
        f"state, stage 1 as billed; the run was billed {profile.run:.2f} ms per iteration. "
        "difference: between steps cut short, as the whole step's kernels do several phases; "
        "host: wall time less the kernels'."
    )
