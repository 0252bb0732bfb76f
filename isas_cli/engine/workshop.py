"""From a configuration to a loop that can run, sharing what several loops have in common."""

from __future__ import annotations

from collections.abc import Callable

from omegaconf import DictConfig, OmegaConf

from ..config.compose import instantiate
from ..config.schema import Config
from ..effects import Plan, decide
from ..estimators.staged import Staged
from ..rendering.renderer import Renderer
from ..runtime.budget import Budget
from ..runtime.errors import InputError
from ..scene.problem import Problem
from .evaluate import Evaluator
from .loop import Loop
from .optimiser import Stepper


def plan_of(problem: Problem, cfg: DictConfig, budget: Budget, planned: dict | None = None) -> Plan:
    """The plan of effects of the run that ``cfg`` describes. ``planned``: its record, of a run that
    goes on. Raises InputError, see ``effects.decide``."""
    loss, estimator, settings = (
        instantiate(cfg[name], name) for name in ("loss", "estimator", "effects")
    )
    # What a clock decides would make other runs differ from machine to machine.
    timed = budget.seconds if budget.iterations is budget.paths is None else None
    described = OmegaConf.to_yaml(cfg.loss, resolve=True)
    return decide(problem, settings, estimator, loss, timed, planned, described)


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
        self, cfg: DictConfig, typed: Config, budget: Budget, planned: dict | None = None
    ) -> Loop:
        """The loop that ``cfg`` (``typed``: the same, checked) describes. Renders references.
        ``planned``: the record of the plan of effects of a run that goes on.

        Raises InputError for settings that do not fit.
        """
        nodes = cfg.loss, cfg.estimator, cfg.sampler, cfg.prior, cfg.effects
        named, how, chosen, held, simulated = (OmegaConf.to_yaml(n, resolve=True) for n in nodes)
        loss = self._once("loss", (named,), lambda: instantiate(cfg.loss, "loss"))
        settings = self._once("settings", (how,), lambda: instantiate(cfg.estimator, "estimator"))
        plan = self._once(
            "plan",
            (simulated, named, how, str(budget), str(planned)),
            lambda: plan_of(self.problem, cfg, budget, planned),
        )
        paths = plan.paths, plan.views
        problem = self._once("problem", (how, paths), lambda: settings.on(plan.on(self.problem)))

        def sampler():
            made = instantiate(cfg.sampler, "sampler")
            settings.prepare(problem, made, loss)
            return made

        def estimator(problem):
            key = named, how, problem.integrator.paths, problem.kept
            return self._once("estimator", key, lambda: settings.made(problem, loss))

        gradients = estimator(problem)
        if plan.staged(self.problem):
            finish = lambda: settings.on(plan.on(self.problem, finish=True))
            whole = self._once("problem", (how, paths, "finish"), finish)
            gradients = Staged(gradients, estimator(whole), 1 - plan.finish)

        measuring = named, typed.evaluation.pixels, typed.evaluation.spp, typed.seed
        loop = Loop(
            problem,
            self._once("sampler", (chosen, named, how, paths), sampler),
            Stepper(
                self.problem.unknowns,
                typed.optimizer,
                instantiate(cfg.optimizer.filter, "optimizer.filter"),
            ),
            self._once(
                "evaluator",
                measuring,
                lambda: Evaluator(self.problem, loss, *measuring[1:], self.renderer),
            ),
            budget,
            gradients,
            typed.seed,
            typed.evaluation.count,
            self._once(
                "prior", (held,), lambda: instantiate(cfg.prior, "prior").on(problem.unknowns)
            ),
            plan,
            typed.budget.converged,
        )
        if typed.budget.converged and loop.floor is None:
            raise InputError(
                "budget.converged=true stops a run at its targets' noise, which is not known here: "
                "it is of rendered targets, where nothing moves; leave it out"
            )
        if plan.seconds:
            loop.clock.billed_seconds["probe"] = plan.seconds
        return loop
