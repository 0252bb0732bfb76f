"""Learning rates over the budget."""

from __future__ import annotations

import math
from collections.abc import Callable

from .errors import InputError, nearest

_SHAPES: dict[str, Callable[[float, float], float]] = {
    "constant": lambda t, final: 1.0,
    "cosine": lambda t, final: final + (1 - final) * 0.5 * (1 + math.cos(math.pi * t)),
    "exponential": lambda t, final: final**t,
}


def factor(schedule: str, final: float, of: str = "optimizer.") -> Callable[[float], float]:
    """What the base learning rate is multiplied with at the share t in [0, 1] of the budget.

    ``schedule``: constant; cosine or exponential, both from 1 at t = 0 to ``final`` at t = 1.
    By share, not iterations: the schedule begins with the first step and ends with the budget,
    whatever the budget counts. Raises InputError for other words and numbers; ``of``: before
    the settings' names there.
    """
    if schedule not in _SHAPES:
        raise InputError(f"{of}schedule={schedule}: {nearest(schedule, _SHAPES)}")
    if not 0 < final <= 1:
        raise InputError(f"{of}final={final}: must lie in (0, 1]")
    return lambda t: _SHAPES[schedule](t, final)
