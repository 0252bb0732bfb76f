"""One estimator for the first part of a budget, another for the rest."""

from __future__ import annotations

from dataclasses import dataclass

from .estimator import Gradients


@dataclass
class Staged(Gradients):
    """``first`` up to the share ``until`` of the budget, ``second`` from there on."""

    first: Gradients
    second: Gradients
    until: float

    def __post_init__(self) -> None:
        # Shares of the budget at which kernels differ, for a rehearsal.
        self.stages = tuple(sorted({self.until, *self.first.stages, *self.second.stages}))
        self.blurs = self.first.blurs or self.second.blurs
        self.present, self.problem = self.first, self.first.problem

    @property
    def heeds_blurs(self) -> bool:
        return self.first.heeds_blurs or self.second.heeds_blurs

    @property
    def paths_per_step(self) -> int:
        """Light paths of the latest estimate."""
        return self.present.paths_per_step

    @property
    def nonfinite(self) -> int:
        """Paths so far whose residual was not finite."""
        return self.first.nonfinite + self.second.nonfinite

    def estimate(self, values: dict, distribution, seed: int, iteration: int, spent: float) -> dict:
        """The gradient at ``values``, by key, see ``Gradients``."""
        self.present = self.first if spent < self.until else self.second
        return self.present.estimate(values, distribution, seed, iteration, spent)
