"""Learning rates over a run."""

from __future__ import annotations

import math
from collections.abc import Callable

from .errors import InputError, nearest

_BY_SHARE: dict[str, Callable[[float, float], float]] = {
    "constant": lambda t, final: 1.0,
    "cosine": lambda t, final: final + (1 - final) * 0.5 * (1 + math.cos(math.pi * t)),
    "exponential": lambda t, final: final**t,
}
TO_FINAL = ("cosine", "exponential")  # those that end where it is said
_BY_STEPS: dict[str, Callable[[float], float]] = {"inverse": lambda n: 1 / (1 + n)}


def factor(
    schedule: str, final: float, half: float, of: str = "optimizer."
) -> Callable[[float, int], float]:
    """What the base learning rate is multiplied with at the share t in [0, 1] of the budget and
    after n steps.

    ``schedule``: constant; cosine or exponential, both from 1 at t = 0 to ``final`` at t = 1: by
    share, not steps, they begin with the first step and end with the budget, whatever it counts.
    Or inverse, 1 / (1 + n / ``half``), by steps alone, as stochastic approximation has it (Robbins
    and Monro 1951). Raises InputError for other words and numbers; ``of``: before the settings'
    names there.
    """
    if schedule not in (known := [*_BY_SHARE, *_BY_STEPS]):
        raise InputError(f"{of}schedule={schedule}: {nearest(schedule, known)}")
    if not 0 < final <= 1:
        raise InputError(f"{of}final={final}: must lie in (0, 1]")
    if not half > 0:
        raise InputError(f"{of}half={half}: must be above 0, in steps")
    if schedule in _BY_STEPS:
        return lambda t, n: _BY_STEPS[schedule](n / half)
    return lambda t, n: _BY_SHARE[schedule](t, final)
