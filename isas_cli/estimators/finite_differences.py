"""Central finite differences of the loss, a baseline."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..runtime import streams
from ..runtime.errors import InputError
from ..scene.problem import Problem
from ..unknowns import smoothing
from ..unknowns.blur import Blur
from .estimator import Comparing, Gradients
from .renderings import Renderings


@dataclass(frozen=True)
class Settings(Comparing):
    """``FiniteDifferences``. ``step``: in widths of the unknown's last blur; ``spp``: paths of
    each drawn pixel in each rendering."""

    name: ClassVar[str] = "finite_differences"

    step: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.step < math.inf:
            raise InputError(f"estimator.step={self.step}: must be a finite number above 0")

    def made(self, problem: Problem, loss) -> "FiniteDifferences":
        return FiniteDifferences(problem, loss, self.batch, self.step, self.freeze, self.spp)

    def derivatives(self, problem: Problem) -> str:
        return "none taken: difference quotients of the loss of plain renderings"


class FiniteDifferences(Gradients):
    """(ℒ(θ + h_k e_k) - ℒ(θ - h_k e_k)) / 2 h_k for each entry k of the unknowns, h_k ``step``
    times the last width of the unknown's blur; less where a side would leave the legal range.

    Both sides with the same random numbers, each ℒ from two independent renderings. Unbiased for
    the difference quotient of a quadratic loss: the derivative up to O(h²) where ℒ is smooth, 0 on
    a plateau. Four renderings of ``spp`` paths per drawn pixel and entry that moves. A ``reach``
    counts here too (``Locality``).
    """

    heeds_blurs = True

    def __init__(
        self, problem: Problem, loss, batch: int, step: float, freeze: bool = True, spp: int = 1
    ):
        self.problem, self.batch, self.spp = problem, batch, spp
        self.blur = Blur(problem, "estimator=finite_differences")
        self.blur.check_single("estimator=finite_differences")
        self.step, self._moving = step, self.blur.size
        self._renderings = Renderings(problem, loss, batch, self.blur, freeze, spp)

    @property
    def nonfinite(self) -> int:
        return self._renderings.nonfinite

    @property
    def paths_per_step(self) -> int:
        """Light paths of one estimate, the latest."""
        return 4 * self.batch * self.spp * self._moving

    def estimate(self, values: dict, distribution, seed: int, iteration: int, spent: float) -> dict:
        """The difference quotients at ``values``, by key; 0 of what rests. Waits."""
        θ, moving = self.blur.vector(values), self.blur.moving(spent)
        self._moving = int(moving.sum())
        steps = self.blur.resolved(self.step * self.blur.widths(θ, 1.0), θ)
        rng = np.random.default_rng(streams.seed(seed, iteration, "offset"))
        total = np.zeros(θ.size)
        for pair in (each.spread(moving) for each in smoothing.central(steps[moving])):
            # At the end of a range a side is shorter.
            length = self.blur.ends(θ + pair.plus) - self.blur.ends(θ + pair.minus)
            weight = np.divide(1, length, out=np.zeros(θ.size), where=length > 0)
            seeds = rng.integers(1 << 32, size=2)
            sides = np.array([seeds[0], seeds[1], seeds[1]])
            total += weight * self._renderings.of_losses(θ, pair, distribution, sides)
        return self.blur.values(total)
