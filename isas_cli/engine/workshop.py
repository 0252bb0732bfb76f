"""From a configuration to a loop that can run, sharing what several loops have in common."""

from __future__ import annotations

from collections.abc import Callable

from omegaconf import DictConfig, OmegaConf

from ..config.compose import instantiate
from ..config.schema import Config
from ..rendering import derivative_sampling
from ..rendering.renderer import Renderer
from ..runtime.budget import Budget
from ..runtime.errors import InputError
from ..samplers.sampler import Sampler
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

        Raises InputError for settings of loss or sampler that do not fit.
        """
        named, chosen = (OmegaConf.to_yaml(node, resolve=True) for node in (cfg.loss, cfg.sampler))
        loss = self._once("loss", (named,), lambda: instantiate(cfg.loss, "loss"))
        batch, freeze = typed.estimator.batch, typed.estimator.freeze
        special = typed.estimator.derivative_sampling
        problem = self._once(
            "derivatives",
            (special,),
            lambda: derivative_sampling.chosen(self.problem, typed.estimator),
        )
        shared = named, batch, freeze, special

        def sampler():
            made = instantiate(cfg.sampler, "sampler")
            made.prepare(problem, loss, batch, freeze)
            return made

        measuring = named, typed.evaluation.pixels, typed.evaluation.spp, typed.seed
        made = self._once("sampler", (chosen, *shared), sampler)
        # Path replay is one for all samplers; other gradients have settings of their own.
        usual = type(made).estimator is Sampler.estimator
        settings = shared if usual else (chosen, *shared)
        for name, wanted in (
            ("profile", typed.profile),
            ("estimator.derivative_sampling", special),
        ):
            if wanted and not usual:
                raise InputError(
                    f"{name}=true is about path replay, which sampler={cfg.sampler.name} does not "
                    "use: leave it out"
                )
        return Loop(
            problem,
            made.looking,
            Stepper(self.problem.unknowns, typed.optimizer),
            self._once(
                "evaluator",
                measuring,
                lambda: Evaluator(self.problem, loss, *measuring[1:], self.renderer),
            ),
            budget,
            self._once("estimator", settings, lambda: made.estimator(problem, loss, batch, freeze)),
            typed.seed,
            typed.evaluation.count,
        )
