"""The gradient at one point, estimated again and again with each of several samplers in turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import drjit as dr
import numpy as np

from ...config.schema import OptimizerConfig
from ...engine.optimiser import Stepper
from ...estimators.two_path import TwoPath
from ...rendering.pixels import PixelDistribution
from ...runtime.clock import Clock
from ...samplers.sampler import Moments, OnImages, Sampler
from ...samplers.uniform import Uniform
from ...scene.problem import Problem
from ...unknowns.parameters import flat
from .tally import Directions, Tally

# Estimates from one look: about as many as in a run, fewer where that would make fewer rounds than
# these. Rounds are what intervals resample, and what the luck of a look averages over.
_PER_LOOK, _ROUNDS = 16, 64
PILOT = 32
_PILOT_BASE = 1 << 24  # iteration numbers, out of reach of the repeats'
_CALIBRATION = 5  # gradients that tell Adam their scale
_WARM_UP = 4  # recording a frozen kernel takes two or three calls
_FORGOTTEN = 0.02  # share of the first look that a running mean may still hold

_COURSE = 1000  # iterations of a usual run


@dataclass
class Contestant:
    """A sampler, or a fixed pmf (``sampler`` None), and what was measured of it.

    ``estimates``, ``looks``: seconds of each; ``second_moments``: Σ_j A_j / p_j of each round.
    """

    label: str
    sampler: OnImages | None
    tally: Tally
    distribution: PixelDistribution | None = None
    weights: object = None
    estimates: list[float] = field(default_factory=list)
    looks: list[float] = field(default_factory=list)
    second_moments: list[float] = field(default_factory=list)

    @property
    def looks_per_estimate(self) -> float:
        """Of iterations 1 to 1,000; the look at a run's start does not count."""
        if self.sampler is None:
            return 0.0
        return sum(self.sampler.settings.due(i) for i in range(1, _COURSE + 1)) / _COURSE

    @property
    def paths_per_look(self) -> int:
        return self.sampler.paths_per_look if self.sampler else 0


class Bench:
    """One problem, loss, point θ and batch; every contestant's estimates are of the same gradient.

    Repeat r has the same random numbers with every contestant. Nothing moves: looks and estimates
    are all at θ. ``moments`` are what samplers that need Adam's would get after ``PILOT`` uniformly
    sampled steps whose gradients are all taken at θ; ``pilot`` is the mean of these gradients.
    ``second_moment``: Σ_j A_j / p_j of a pmf, where it is to be known (``moments.Moments``).
    """

    def __init__(
        self,
        problem: Problem,
        loss,
        values: dict,
        batch: int,
        seed: int,
        optimizer: OptimizerConfig,
        freeze: bool = True,
    ):
        self.problem, self.loss, self.values = problem, loss, values
        self.batch, self.seed, self.freeze = batch, seed, freeze
        self.second_moment: Callable[[PixelDistribution], float] | None = None
        self.estimator = TwoPath(problem, loss, batch, freeze)
        self.moments, self.pilot = self._piloted(optimizer)
        self._directions = Directions(self.pilot, seed)

    def _piloted(self, optimizer: OptimizerConfig) -> tuple[Moments, dict[str, np.ndarray]]:
        uniform = Uniform().on(self.problem, self.loss, self.batch, self.freeze)
        pmf = uniform.distribution(uniform.look(self.values, self.seed, 0))
        stepper, means = Stepper(self.problem.unknowns, optimizer), {}

        def take(gradient: dict) -> None:
            stepper.step(gradient, 0.0)
            for key, entries in self._host(gradient).items():
                finite = np.where(np.isfinite(entries), entries, 0)
                means[key] = means.get(key, 0) + finite.astype(np.float64) / PILOT

        first = [self._gradients(pmf, _PILOT_BASE + i) for i in range(_CALIBRATION)]
        # Adam's ε would show in gradients as small as those of means over millions of pixels.
        stepper.calibrate(first)
        for gradient in first:
            take(gradient)
        for i in range(_CALIBRATION, PILOT):
            take(self._gradients(pmf, _PILOT_BASE + i))
        self.problem.unknowns.write(self.values)
        return stepper.moments(0.0), means

    def sampled(self, label: str, sampler: Sampler) -> Contestant:
        """A contestant with a sampler, warmed up: kernels recorded, and where looks are averaged,
        as many of them taken as a run in its course has behind it. Evaluates."""
        at_work = sampler.on(self.problem, self.loss, self.batch, self.freeze)
        made = Contestant(label, at_work, Tally(self._directions))
        for number in range(self._before(sampler)):
            self._look(made, number)
        self._warm(made)
        return made

    def fixed(self, label: str, distribution: PixelDistribution) -> Contestant:
        """A contestant with a pmf that stays, warmed up. Evaluates."""
        made = Contestant(label, None, Tally(self._directions), distribution)
        self._warm(made)
        return made

    def _warm(self, contestant: Contestant) -> None:
        for number in range(_WARM_UP):
            self._gradients(contestant.distribution, _PILOT_BASE + PILOT + number)
        self.problem.unknowns.write(self.values)

    @staticmethod
    def _before(sampler: Sampler) -> int:
        """Looks before the first that is measured."""
        kept = sampler.stage1.average
        return _WARM_UP + (int(np.ceil(np.log(_FORGOTTEN) / np.log(kept))) if kept else 0)

    def run(
        self,
        contestants: list[Contestant],
        repeats: int,
        finished: Callable[[list[int]], None],
        stop: Callable[[], bool] = lambda: False,
    ) -> bool:
        """``repeats`` estimates with each contestant, in rounds of one look each.

        Rounds go through all contestants, the order turning by one, so that a drift of the machine
        falls on all alike. ``finished(rounds)`` is called after each with the repeats of all rounds
        so far. ``stop()`` leaves the round that it interrupts out. True when all is done.
        """
        each = min(_PER_LOOK, -(-repeats // _ROUNDS))
        rounds: list[int] = []
        while (begun := sum(rounds)) < repeats:
            size = min(each, repeats - begun)
            turn = len(rounds) % len(contestants)
            for contestant in contestants[turn:] + contestants[:turn]:
                if not self._round(contestant, len(rounds), range(begun, begun + size), stop):
                    return False
                if self.second_moment:
                    contestant.second_moments.append(self.second_moment(contestant.distribution))
            rounds.append(size)
            finished(rounds)
        return True

    def _round(self, contestant: Contestant, number: int, repeats: range, stop) -> bool:
        if contestant.sampler:
            clock = Clock()
            with clock.billed("look"):
                self._look(contestant, self._before(contestant.sampler.settings) + number)
            contestant.looks.append(clock.seconds)
        for repeat in repeats:
            if stop():
                return False
            clock = Clock()
            with clock.billed("estimate"):
                gradients = self._gradients(contestant.distribution, repeat)
            contestant.estimates.append(clock.seconds)
            contestant.tally.add(self._host(gradients))
        # Without derivatives: they would break passes of others through this scene.
        self.problem.unknowns.write(self.values)
        return True

    def _look(self, contestant: Contestant, number: int) -> None:
        sampler = contestant.sampler
        moments = self.moments if "moments" in sampler.settings.needs and number else None
        found = sampler.look(self.values, self.seed, number, moments)
        contestant.weights = sampler.blended(contestant.weights, found)
        contestant.distribution = sampler.distribution(contestant.weights)
        dr.eval(contestant.distribution.cdf)

    def _gradients(self, distribution: PixelDistribution, iteration: int) -> dict:
        """One estimate, as a step makes it. Evaluates."""
        unknowns = self.problem.unknowns
        unknowns.attach(self.values)
        self.estimator.accumulate(distribution, self.seed, iteration)
        gradients = unknowns.gradients()
        dr.eval(gradients)
        return gradients

    @staticmethod
    def _host(gradients: dict) -> dict[str, np.ndarray]:
        return {key: np.array(flat(value)) for key, value in gradients.items()}
