"""From a configuration to a loop that can run, sharing what several loops have in common."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from ..config.schema import Config
from ..effects import Plan, decide
from ..estimators.estimator import Gradients
from ..estimators.staged import Staged
from ..rendering.renderer import Renderer
from ..runtime.budget import Budget
from ..runtime.errors import InputError
from ..scene.problem import Problem
from .choices import Choices
from .evaluate import Evaluator
from .floor import STOPS
from .loop import Loop
from .optimiser import Stepper


def plan_of(
    problem: Problem, choices: Choices, budget: Budget, planned: dict | None = None
) -> Plan:
    """The plan of effects of a run. ``planned``: its record, of a run that goes on. Raises
    InputError, see ``effects.decide``."""
    # What a clock decides would make other runs differ from machine to machine.
    timed = budget.seconds if budget.iterations is budget.paths is None else None
    how = choices.effects, choices.estimator, choices.loss
    prior = choices.prior.on(problem.unknowns) is not None
    return decide(problem, *how, timed, planned, str(_told(choices.loss)), prior)


def _told(choice) -> tuple[str, str]:
    """A choice in words, the same for the same settings."""
    return f"{type(choice).__module__}.{type(choice).__qualname__}", repr(choice)


class Workshop:
    """Makes loops on one problem.

    Loops of equal settings get the same estimator, sampler and evaluator, so that each kernel is
    recorded once: these hold no state of a run (a sampler's cells and distribution live in its
    loop). Where one setting differs, nothing that depends on it is shared.
    """

    def __init__(self, problem: Problem):
        self.problem = problem
        self.renderer = Renderer(problem)
        self._made: dict = {}

    def _once(self, kind: str, settings: tuple, make: Callable):
        key = kind, *settings
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]

    def loop(
        self, choices: Choices, typed: Config, budget: Budget, planned: dict | None = None
    ) -> Loop:
        """The loop of these choices. Renders references. ``planned``: the record of the plan of
        effects of a run that goes on.

        Raises InputError for settings that do not fit.
        """
        loss, estimator = choices.loss, choices.estimator
        how = _told(loss), _told(estimator)
        plan = self._once(
            "plan",
            (_told(choices.effects), _told(choices.prior), *how, str(budget), str(planned)),
            lambda: plan_of(self.problem, choices, budget, planned),
        )

        def estimating(finish: bool) -> Gradients:
            on = plan.on(self.problem, finish=finish)
            # What an estimator warns of is no matter of others on the same problem.
            on = dataclasses.replace(on, warnings=[*on.warnings])
            key = *how, on.integrator.paths, on.kept
            return self._once("estimator", key, lambda: estimator.on(on, loss))

        gradients = estimating(False)
        problem = gradients.problem

        def looking() -> tuple:
            on = dataclasses.replace(problem, warnings=[])
            return estimator.looks(choices.sampler, on, loss), on.warnings

        how_drawn = _told(choices.sampler), *how, plan.paths, plan.views
        sampler, told = self._once("sampler", how_drawn, looking)
        # As what an estimator warns of: no matter of others on the same problem.
        problem = dataclasses.replace(problem, warnings=[*problem.warnings, *told])
        if plan.staged(self.problem):
            gradients = Staged(gradients, estimating(True), 1 - plan.finish)
        loop = Loop(
            problem,
            sampler,
            Stepper(self.problem.unknowns, typed.optimizer, choices.filter),
            self._evaluator(loss, typed),
            budget,
            gradients,
            typed.seed,
            typed.evaluation.count,
            self._once("prior", _told(choices.prior), lambda: choices.prior.on(problem.unknowns)),
            plan,
            typed.budget.converged,
        )
        if typed.budget.converged and loop.floor is None:
            raise InputError(
                f"{STOPS}, which could not be measured: targets of one path a pixel do not tell "
                "it, nor do images that show no unknown; leave it out"
            )
        if plan.seconds:
            loop.clock.billed_seconds["probe"] = plan.seconds
            loop.position.paths = plan.traced
        return loop

    def _evaluator(self, loss, typed: Config) -> Evaluator:
        how = typed.evaluation.pixels, typed.evaluation.spp, typed.seed
        make = lambda: Evaluator(self.problem, loss, *how, self.renderer)
        return self._once("evaluator", (_told(loss), *how), make)
