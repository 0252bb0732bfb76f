"""What a configuration chooses, each made once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from ..config.compose import instantiate
from ..runtime.errors import InputError

if TYPE_CHECKING:
    from ..config.schema import Config
    from ..effects.settings import Effects
    from ..estimators.estimator import Estimator
    from ..filters.filter import Filter
    from ..losses.priors import Prior
    from ..samplers.sampler import Sampler
    from ..scene.problem import Problem


@dataclass(frozen=True)
class Choices:
    """Frozen settings, which a problem gets to work: ``sampler.on(problem, …)`` and so on. A loss
    works as it is. ``profile``: whether the run is to be taken apart."""

    loss: Any
    sampler: Sampler
    estimator: Estimator
    prior: Prior
    effects: Effects
    filter: Filter
    profile: bool

    @staticmethod
    def of(cfg: DictConfig) -> Choices:
        """Raises InputError for settings that a choice refuses. Needs the backend."""
        made = {name: instantiate(cfg[name], name) for name in _GROUPS}
        made["filter"] = instantiate(cfg.optimizer.filter, "optimizer.filter")
        return Choices(**made, profile=cfg.profile)

    def check(self, typed: Config) -> None:
        """Raises InputError where they do not fit each other. Needs no scene."""
        self.estimator.fits(self.sampler)
        if typed.scene.photos.edges and not self.estimator.outlines:
            raise InputError(
                "photos.edges=true: edges are followed by estimator=silhouettes alone, not by "
                f"{self.estimator.chosen}"
            )
        if self.profile and self.effects.finish:
            raise InputError(
                f"profile=true takes one kind of step apart, and effects.finish="
                f"{self.effects.finish} makes two: leave one of them out"
            )
        if self.profile and not self.estimator.replays:
            raise InputError(
                f"profile=true takes path replay's step apart, which {self.estimator.chosen} does "
                "not do: leave it out"
            )

    def check_on(self, problem: Problem) -> None:
        """Raises InputError for what they cannot do on ``problem``, which needs no targets yet."""
        from .. import effects
        from . import footprint

        # What is said here is said again where they get to work; others share this problem.
        problem = replace(problem, warnings=[*problem.warnings])
        self.estimator.check(problem, self.sampler, self.loss)
        effects.check(problem, self.effects, self.estimator)
        if self.profile and not problem.integrator.has_forward:
            raise InputError(
                "profile=true differentiates paths in forward mode, which the scene's "
                f"integrator {problem.integrator.name} cannot: leave it out"
            )
        paths = self.estimator.paths_at_once(problem)
        footprint.check(problem, self.estimator.batch, self.estimator.outlines, paths)
        beside = ["a prior"] if self.prior.on(problem.unknowns) is not None else []
        beside += ["estimator.blurred"] if self.estimator.whole else []
        other = (u for u in problem.unknowns if u.kind.aside or not u.kind.carried)
        beside += [f"'{u.key}', whose derivative paths do not carry," for u in other]
        beside += ["a loss of windows"] if self.loss.windows else []
        if self.profile and beside:
            raise InputError(
                f"profile=true takes path replay's step apart, and {beside[0]} is no part of it: "
                "leave one of them out"
            )


_GROUPS = ("loss", "sampler", "estimator", "prior", "effects")
