"""The loop: refresh the distribution, estimate, check finite, step, project, record."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..effects import Plan
from ..estimators.estimator import Gradients
from ..losses.priors import OnUnknowns
from ..rendering.pixels import PixelDistribution
from ..runtime.backend import release, sync
from ..runtime.budget import Budget
from ..runtime.clock import Clock
from ..runtime.errors import NumericalError
from ..runtime.memory import parts
from ..samplers import reliability
from ..samplers.sampler import OnImages
from ..scene.problem import Problem
from ..unknowns.parameters import flat
from .evaluate import Evaluator
from .floor import Floor
from .optimiser import Stepper

# Recording a frozen kernel takes two or three calls; from the fourth on a step is steady.
_REHEARSAL_STEPS = 5
# Evaluations crowd towards the start, where the error falls fastest.
_EVALUATION_POWER = 1.5
# A look may cost as much as the last did, or the rehearsal's, by its paths, only where that is no
# more than this share of what is left: what it finds must pay.
_MOST_OF_REST = 1 / 4
# If more than this share of the touched gradient entries since the last evaluation is not finite,
# going on makes no sense.
_NONFINITE_LIMIT = 0.5
# Iteration numbers of the rehearsal: out of reach of any run, so that no stream repeats.
_REHEARSAL_BASE = 1 << 24


@dataclass
class Position:
    """Where a run stands: everything a continuation needs besides parameters and moments."""

    iteration: int = 0
    paths: int = 0
    evaluations: int = 0
    # What was spent before the first step: billed seconds, light paths.
    before: tuple[float, int] = (0.0, 0)
    looked: tuple[float, int] = (0.0, 0)  # what the last look took, the rehearsal's before any
    at: float = 0.0  # progress of the schedule when it was taken


@dataclass
class Hooks:
    """Whom the loop tells. None of these is billed."""

    evaluated: Callable[[dict], None] = lambda row: None
    stepped: Callable[["Loop", float], None] = lambda loop, spent: None
    stop: Callable[[], bool] = lambda: False


class Loop:
    """One run of Adam on one problem with one sampler and one estimator."""

    def __init__(
        self,
        problem: Problem,
        sampler: OnImages,
        stepper: Stepper,
        evaluator: Evaluator,
        budget: Budget,
        estimator: Gradients,
        seed: int,
        evaluations: int,
        prior: OnUnknowns | None = None,
        plan: Plan | None = None,
        until_converged: bool = False,
    ):
        self.problem, self.sampler, self.stepper = problem, sampler, stepper
        self.evaluator, self.budget, self.seed = evaluator, budget, seed
        self.evaluations, self.until_converged = evaluations, until_converged
        self.clock = Clock()
        self.position = Position()
        self.last: dict | None = None
        # As the evaluator, which loops may share, had it then.
        self.unresolved = False
        self.lost = 0  # paths of evaluations that came out non-finite
        # And of steps, where the estimator counts them: so far, and by the estimator when counted.
        self.lost_in_steps = self._lost_before = 0
        self.estimator, self.prior, self.plan = estimator, prior, plan
        self.warnings: list[str] = []
        self._weights = self._distribution = self._gradients = None
        self._counted = 0, 0
        self._memory = self._blank()

    def _blank(self) -> list[mi.Float]:
        """What an estimator that learns from its steps has learned before the first. Loops that
        take turns may share one: each puts its own in and takes it out again."""
        return [dr.opaque(mi.Float, 0, dr.width(each)) for each in self.estimator.memory]

    @property
    def whole(self) -> Problem:
        """The problem with all effects and views."""
        return self.evaluator.problem

    @property
    def floor(self) -> Floor | None:
        """What fitting the targets' noise to the end leaves, where that is known. Unbilled."""
        with self.clock.unbilled("evaluation"):
            return self.evaluator.floor

    @property
    def converged(self) -> bool:
        """Whether what the last evaluation found is the targets' noise."""
        floor, last = self.floor, self.last
        if floor is None or last is None or self.unresolved:
            return False
        return last["image_rmse"] <= floor.image_rmse

    @property
    def spent(self) -> float:
        p = self.position
        return self.budget.spent(self.clock.seconds, p.iteration, p.paths)

    @property
    def scheduled(self) -> float:
        """Progress of the learning rate's schedule, which runs from the first step to the end of
        the budget: a sampler whose first look takes long must not begin at a rate half decayed."""
        return self._scheduled(self.budget)

    def _scheduled(self, budget: Budget) -> float:
        p = self.position
        seconds, paths = p.before
        before = budget.spent(seconds, 0, paths)
        spent = budget.spent(self.clock.seconds, p.iteration, p.paths)
        return (spent - before) / (1 - before) if before < 1 else 1.0

    def turned_from(self, budget: Budget) -> dict[str, bool]:
        """Of unknowns that move where by another budget they would rest, or the other way round,
        whether they move, by key."""
        now, then = self.scheduled, self._scheduled(budget)
        items = self.problem.unknowns
        return {u.key: u.moves(now) for u in items if u.moves(now) != u.moves(then)}

    def rehearse(self) -> None:
        """Compile everything the run will launch, measure the gradient's scale, start afresh."""
        with self.clock.unbilled("rehearsal"):
            for level in range(len(self.problem.unknowns.switches)):
                self._rehearse_level(level)
            self.stepper.restart()
            values = self.stepper.values
            doubt = reliability.warning(self.sampler, values, self.seed, _REHEARSAL_BASE)
            self.warnings = [doubt] if doubt else []
            if not self._affordable(first=True):
                self.warnings.append(
                    f"sampler={self.sampler.settings.name}: its first look would take more than "
                    f"{_MOST_OF_REST:.0%} of the budget, so pixels are drawn uniformly: give more, "
                    "or take sampler=uniform"
                )
            self._weights = self._distribution = None
            self._memory = self._blank()
            release()

    def _rehearse_level(self, level: int) -> None:
        if level > self.stepper.level:
            self.stepper.refine(level)
        gradients = []
        for i in range(_REHEARSAL_STEPS):
            iteration = _REHEARSAL_BASE + i
            sync()
            begun, first = time.perf_counter(), i % 2 == 0  # later looks are other ones
            self._look(iteration, first)
            sync()
            if first and not level:  # the last one's time: what it needs was compiled before
                paths = self.sampler.paths_per_look + self.sampler.paths_before
                self.position.looked = time.perf_counter() - begun, paths
            gradients.append(self._estimate(iteration))
            self.stepper.step(gradients[-1], 0.0)
        # Other unknowns move then, and other kernels take the step.
        for share in {s for u in self.problem.unknowns for s in u.during if 0 < s < 1}:
            self.stepper.step(gradients[-1], share)
        later = [
            self._estimate(_REHEARSAL_BASE + i, share)
            for share in self.estimator.stages[1:]
            for i in range(_REHEARSAL_STEPS)
        ]
        self.stepper.calibrate(gradients, later)

    def run(self, hooks: Hooks) -> str:
        """Go on until the budget is spent. Returns 'done' or 'interrupted'.

        Raises NumericalError when the estimates are mostly non-finite; values and moments are
        then those of the last step, which are finite.
        """
        self.begin(hooks)
        return "done" if self.advance(hooks) else self.halt(hooks)

    def begin(self, hooks: Hooks) -> None:
        """Evaluate the start, which a continued run has behind it."""
        self._begin_counting()
        if self.last is None:
            self._evaluate(hooks)
        self._count_evaluations()
        if self.spent >= 1 and self.last["iteration"] != self.position.iteration:
            self._evaluate(hooks)

    def advance(self, hooks: Hooks, seconds: float = math.inf) -> bool:
        """Iterate for about ``seconds`` of billed time, at least once; True: the budget is spent,
        or it goes ``until_converged`` and is.

        Raises NumericalError like ``run``.
        """
        until = self.clock.seconds + seconds
        self._begin_counting()
        if self._ended_converged:
            return True
        while self.spent < 1:
            if hooks.stop():
                self._count_lost()
                return False
            self._iterate()
            spent = self.spent
            if spent >= 1 or spent >= self._next_evaluation():
                self._evaluate(hooks)
                if self.until_converged and self.converged:
                    self._count_lost()
                    return True
            hooks.stepped(self, spent)
            if self.clock.seconds >= until:
                break
        self._count_lost()
        return self.spent >= 1

    @property
    def _ended_converged(self) -> bool:
        """Whether it had ended so when it was stopped, before its pictures were made."""
        at = self.position.iteration
        if not (self.until_converged and at and self.last and self.last["iteration"] == at):
            return False
        return self.spent < 1 and self.converged

    def _begin_counting(self) -> None:
        # Loops that take turns may share an estimator, and a rehearsal was there before.
        self._lost_before = self.estimator.nonfinite

    def _count_lost(self) -> None:
        before = self._lost_before
        self._begin_counting()
        self.lost_in_steps += self._lost_before - before

    def halt(self, hooks: Hooks) -> str:
        """Stop before the budget is spent, with a row that says where. Returns 'interrupted'."""
        self._begin_counting()
        if self.last["iteration"] != self.position.iteration:
            self._evaluate(hooks)
        return "interrupted"

    def _iterate(self) -> None:
        p = self.position
        if p.iteration == 0:  # a probe's part; once more below, when the first look is over
            p.before = self.clock.seconds, p.paths
        # A level begins as a run does, and so does what had too little time before it went on.
        first = self._finer() or self._weights is None
        turned = self._turned()
        due = first or turned or self.sampler.settings.due(p.iteration)
        draws = self.scheduled >= self.estimator.undrawn
        if draws and due and self._affordable(first):
            seconds, paths = self.clock.seconds, p.paths
            with self.clock.billed("stage1"):
                p.at = self.scheduled
                self._look(p.iteration, first, turned)
            p.paths += self.sampler.paths_per_look
            if first:
                p.paths += self.sampler.paths_before
            p.looked = self.clock.seconds - seconds, p.paths - paths
        elif self._distribution is None or (draws and turned and self._turned(begun=True)):
            # No look of this run pays, or none is needed yet; or what now moves was left out of the
            # last one.
            p.at, self._weights = self.scheduled, None
            self._spread(None)
        if p.iteration == 0:
            p.before = self.clock.seconds, p.paths
        with self.clock.billed("step"):
            scheduled = self.scheduled
            self._gradients = self._estimate(p.iteration, scheduled)
            self.stepper.step(self._gradients, scheduled)
        p.paths += self.estimator.paths_per_step
        p.iteration += 1

    def _turned(self, begun: bool = False) -> bool:
        """Whether other unknowns move than at the last look, or more have ``begun``, of a sampler
        that looks at what moves alone."""
        if not self.sampler.settings.staged:
            return False
        now, then = self.scheduled, self.position.at
        moved = ((u.moves(now), u.moves(then)) for u in self.problem.unknowns)
        return any(moves != did and (moves or not begun) for moves, did in moved)

    def _affordable(self, first: bool) -> bool:
        """Whether a look, or the ``first`` of a run or level, which may trace more, would leave
        time for what it finds."""
        seconds, traced = self.position.looked
        paths = self.sampler.paths_per_look + first * self.sampler.paths_before
        seconds *= paths / traced if traced else 1
        return self.budget.spent(seconds, 0, paths) <= _MOST_OF_REST * (1 - self.spent)

    def _finer(self) -> bool:
        """Go on to the level that is due, if that is a finer one: with a larger budget, it may be
        coarser."""
        level = self.problem.unknowns.level(self.scheduled)
        if level <= self.stepper.level:
            return False
        with self.clock.billed("step"):
            self.stepper.refine(level)
        return True

    def _look(self, iteration: int, first: bool = False, turned: bool = False) -> None:
        """``first``: of a run or level, as if nothing had been before it; ``turned``: what earlier
        looks found was of other unknowns."""
        moments = None
        if "moments" in self.sampler.settings.needs and self.stepper.taken and not first:
            moments = self.stepper.moments(self.scheduled)
        where = self.stepper.values, self.seed, iteration
        found = self.sampler.look(*where, moments, self.scheduled)
        before = None if first or turned else self._weights
        self._weights = self.sampler.blended(before, found)
        self._spread(self._weights)

    @property
    def distribution(self) -> PixelDistribution | None:
        """The pmf that draws follow at present."""
        return self._distribution

    def gradient(self, iteration: int) -> dict:
        """What an iteration estimates at the present values and share of the schedule, by key;
        before any, after a look."""
        if self._distribution is None and self.position.iteration:  # no look of this run paid
            self._spread(None)
        elif self._distribution is None:
            self._look(iteration)
        before = self._memory
        found = self._estimate(iteration)
        self._memory = before
        return found

    def _spread(self, weights: mi.Float | None) -> None:
        """From the cells' weights to the distribution that draws follow; None: uniform."""
        if weights is None:
            weights = dr.opaque(mi.Float, 1, self.sampler.cells.count)
        self._distribution = self.sampler.distribution(weights)
        dr.eval(self._distribution.cdf)

    def _estimate(self, iteration: int, scheduled: float | None = None) -> dict:
        where = self._distribution, self.seed, iteration
        values = self.stepper.values
        share = self.scheduled if scheduled is None else scheduled
        if self._memory:
            self.estimator.memory = self._memory
        found = self.estimator.estimate(values, *where, share)
        if self._memory:
            self._memory = self.estimator.memory
        return found if self.prior is None else self.prior.add(values, found)

    def _count_evaluations(self) -> None:
        """How many evaluations are behind it, whether one stood for several that a
        long iteration jumped over, or the budget has grown since."""
        p = self.position
        p.evaluations = 1
        while self._next_evaluation() <= self.spent < 1:
            p.evaluations += 1

    def _next_evaluation(self) -> float:
        return (self.position.evaluations / self.evaluations) ** _EVALUATION_POWER

    def _evaluate(self, hooks: Hooks) -> None:
        p = self.position
        with self.clock.unbilled("evaluation"):
            before = self.evaluator.renderer.nonfinite
            row = self.evaluator(self.stepper.values)
            if self.prior is not None:
                row["prior"] = self.prior.value(self.stepper.values)
            self.lost += self.evaluator.renderer.nonfinite - before
            self._count_lost()
            nonfinite = sum(self.stepper.lost.values())
            norm = self._gradient_norm()
            noise = self._gradients and self.stepper.noise(self._gradients, self.scheduled)
        self._count_evaluations()
        row |= {
            "iteration": p.iteration,
            "seconds": self.clock.seconds,
            "paths": p.paths,
            "gradient_norm": norm,
            "gradient_noise": noise,
            "nonfinite": nonfinite,
            "stage1_seconds": self.clock.billed_seconds["stage1"],
            "learning_rate": self.stepper.rate(self.scheduled),
        }
        self.last, self.unresolved = row, self.evaluator.unresolved
        hooks.evaluated(row)
        self._check(nonfinite, int(self.stepper.touched[0]))

    def _check(self, nonfinite: int, touched: int) -> None:
        bad, all_ = nonfinite - self._counted[0], touched - self._counted[1]
        self._counted = nonfinite, touched
        if bad > _NONFINITE_LIMIT * all_:
            raise NumericalError(
                f"{bad} of the last {all_} gradient entries were not finite (zeros left out): the "
                "last good values are kept; look for values at the edge of their range"
            )

    def _gradient_norm(self) -> float:
        """‖⟨dℒ/dθ⟩‖ of the last estimate over its finite entries, all unknowns together."""
        if self._gradients is None:
            return float("nan")
        total = 0.0
        for gradient in self._gradients.values():
            every = np.array(flat(gradient))
            for part in parts(every.size):
                entries = every[part].astype(np.float64)
                total += float(np.sum(entries[np.isfinite(entries)] ** 2))
        return total**0.5

    def left_out(self) -> float | None:
        """Root mean square of what the plan of effects leaves out of the images at the present
        values, in units of radiance; None where it leaves out nothing."""
        whole, own = self.whole.integrator, self.problem.integrator.paths
        # By the samples that the whole has: the same random numbers, so that noise is not left out.
        lacking = replace(whole.paths, depth=own.depth, derivative=own.depth, caustics=own.caustics)
        if lacking == whole.paths:
            return None
        planned = replace(self.whole, integrator=whole.cut(lacking))
        with self.clock.unbilled("evaluation"):
            return self.evaluator.apart(planned, self.stepper.values)

    def export(self) -> tuple[dict[str, np.ndarray], dict]:
        """Everything that a continuation needs, as arrays and JSON state. Random streams are
        functions of the base seed and the iteration, so the iteration is their state."""
        arrays, state = self.stepper.export()
        if self._weights is not None:
            arrays["cells"] = np.array(self._weights)
        arrays |= {f"met/{i}": np.array(each) for i, each in enumerate(self._memory)}
        p = self.position
        state |= {
            "seed": self.seed,
            "iteration": p.iteration,
            "paths": p.paths,
            "before": p.before,
            "looked": p.looked,
            "at": p.at,
            "counted": self._counted,
            "lost": self.lost,
            "lost_in_steps": self.lost_in_steps,
            "unresolved": self.unresolved,
            "billed": dict(self.clock.billed_seconds),
            "unbilled": dict(self.clock.unbilled_seconds),
        }
        return arrays, state

    def restore(self, arrays: dict[str, np.ndarray], state: dict) -> None:
        """Go on where ``export`` was called: after ``rehearse``, before ``run``. Raises KeyError
        or ValueError where something is missing or does not fit."""
        self.stepper.restore(arrays, state)
        if "cells" in arrays:
            self._weights = mi.Float(arrays["cells"])
            self._spread(self._weights)
        known = range(len(self._memory))
        self._memory = [mi.Float(arrays[f"met/{i}"]) for i in known]
        before, looked = ((float(s), int(paths)) for s, paths in (state["before"], state["looked"]))
        self.position = Position(int(state["iteration"]), int(state["paths"]))
        self.position.before, self.position.looked = before, looked
        self.position.at = float(state.get("at", 0.0))
        self._counted, self.lost = tuple(state["counted"]), state["lost"]
        self.lost_in_steps = state["lost_in_steps"]
        self.unresolved = state["unresolved"]
        self.clock.billed_seconds.update(state["billed"])
        for phase, seconds in state["unbilled"].items():
            self.clock.unbilled_seconds[phase] += seconds
        self._count_evaluations()

    def density(self) -> np.ndarray | None:
        """p_j n of every pixel at present (1: as often as uniformly), or None before a look."""
        if self._distribution is None:
            return None
        views = self.problem.views
        pixel = views.locate(dr.arange(mi.UInt32, views.total))
        found = np.array(self._distribution.probability(*pixel) * self.whole.views.total)
        if self.problem.kept is None:
            return found
        density = np.zeros(self.whole.views.total, found.dtype)
        density[self.whole.pixels(self.problem.kept)] = found
        return density
