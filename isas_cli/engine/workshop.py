"""From a configuration to a loop that can run, sharing what several loops have in common."""

from __future__ import annotations

from collections.abc import Callable

from omegaconf import DictConfig, OmegaConf

from ..config.compose import instantiate
from ..config.schema import Config
from ..rendering.renderer import Renderer
from ..runtime.budget import Budget
from ..scene.problem import Problem
from .evaluate import Evaluator
from .loop import Loop
from .optimiser import Stepper


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

    def loop(self, cfg: DictConfig, typed: Config, budget: Budget) -> Loop:
        """The loop that ``cfg`` (``typed``: the same, checked) describes. Renders references.

        Raises InputError for settings that do not fit.
        """
        nodes = cfg.loss, cfg.estimator, cfg.sampler, cfg.prior
        named, how, chosen, held = (OmegaConf.to_yaml(node, resolve=True) for node in nodes)
        loss = self._once("loss", (named,), lambda: instantiate(cfg.loss, "loss"))
        estimator = self._once("settings", (how,), lambda: instantiate(cfg.estimator, "estimator"))
        problem = self._once("problem", (how,), lambda: estimator.on(self.problem))

        def sampler():
            made = instantiate(cfg.sampler, "sampler")
            estimator.prepare(problem, made, loss)
            return made

        measuring = named, typed.evaluation.pixels, typed.evaluation.spp, typed.seed
        return Loop(
            problem,
            self._once("sampler", (chosen, named, how), sampler),
            Stepper(self.problem.unknowns, typed.optimizer),
            self._once(
                "evaluator",
                measuring,
                lambda: Evaluator(self.problem, loss, *measuring[1:], self.renderer),
            ),
            budget,
            self._once("estimator", (named, how), lambda: estimator.made(problem, loss)),
            typed.seed,
            typed.evaluation.count,
            self._once(
                "prior", (held,), lambda: instantiate(cfg.prior, "prior").on(problem.unknowns)
            ),
        )
