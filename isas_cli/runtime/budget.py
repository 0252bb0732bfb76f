"""How much a run may spend, and how far along it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .errors import InputError

_DEFAULT_SECONDS = 60.0


@dataclass(frozen=True)
class Budget:
    """Limits in billed ``seconds``, ``iterations`` and light ``paths``; None is no limit.

    Without any limit: 60 billed seconds. The first limit reached ends the run.
    """

    seconds: float | None = None
    iterations: int | None = None
    paths: float | None = None

    def __post_init__(self) -> None:
        for name in ("seconds", "iterations", "paths"):
            value = getattr(self, name)
            if value is not None and not (value > 0 and math.isfinite(value)):
                raise InputError(f"budget.{name}={value}: must be a finite number above 0")
        if self.seconds is None and self.iterations is None and self.paths is None:
            object.__setattr__(self, "seconds", _DEFAULT_SECONDS)

    def __str__(self) -> str:
        limits = vars(self).items()
        return ", ".join(f"{name}={value:g}" for name, value in limits if value is not None)

    def spent(self, seconds: float, iterations: int, paths: int) -> float:
        """Share of the budget spent, from 0 to 1 (1: stop)."""
        spent = ((seconds, self.seconds), (iterations, self.iterations), (paths, self.paths))
        return min(1.0, max(used / limit for used, limit in spent if limit is not None))
