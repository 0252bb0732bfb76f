"""What is asked for: how much of a scene's light transport a run simulates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional

from ..runtime.errors import InputError

# Each is unrolled in the kernel.
_MOST_LIGHTS, _MOST_DIRECTIONS = 64, 256


@dataclass(frozen=True)
class Effects:
    """As its YAML says. None without a probe: all that the scene has, and one light sample, picked
    but where renderings are compared (``plan.decide``).

    What residuals lack, the result lacks: at the truth they are not zero on average. A derivative
    that lacks something only takes another way to where the residuals are zero. Hence two
    tolerances. Of images from elsewhere, with a prior, or where an unknown rests at the end,
    residuals stay, and the derivative's tolerance, where none is set, is that of residuals, but
    before a ``finish``.
    """

    probe: bool = True
    max_depth: Optional[int] = None
    derivative_depth: Optional[int] = None
    light_samples: Optional[List[int]] = None
    directions: Optional[int] = None
    roulette: Optional[int] = None
    caustics: Optional[bool] = None
    tolerance: float = 0.005
    derivative_tolerance: Optional[float] = None
    finish: float = 0.0

    @property
    def cuts(self) -> bool:
        """Whether paths are set to be others than the scene's."""
        own = self.max_depth, self.derivative_depth, self.light_samples, self.roulette
        picks = self.directions not in (None, 1)
        return picks or self.caustics is False or any(each is not None for each in own)

    def __post_init__(self) -> None:
        for name in ("max_depth", "derivative_depth"):
            edges = getattr(self, name)
            if edges is not None and edges < 1:
                raise InputError(f"effects.{name}={edges}: at least 1, edges of a path")
        if self.roulette is not None and self.roulette < 1:
            raise InputError(f"effects.roulette={self.roulette}: at least 1, vertices of a path")
        lights = self.light_samples
        if lights is not None and not (
            len(lights) == 2 and all(1 <= n <= _MOST_LIGHTS for n in lights)
        ):
            text = ",".join(map(str, lights))
            raise InputError(
                f"effects.light_samples=[{text}]: two numbers from 1 to {_MOST_LIGHTS}, for the "
                "residual and for the derivative, such as [4,4]"
            )
        most = _MOST_DIRECTIONS // max(lights or [1])
        if self.directions is not None and not 1 <= self.directions <= most:
            raise InputError(
                f"effects.directions={self.directions}: from 1 to {most}, that each light sample "
                f"is picked from, {_MOST_DIRECTIONS} in all"
            )
        for name in ("tolerance", "derivative_tolerance"):
            share = getattr(self, name)
            if share is not None and not 0 <= share < 1:
                raise InputError(f"effects.{name}={share}: a share, in [0, 1)")
        if not 0 <= self.finish <= 1:
            raise InputError(f"effects.finish={self.finish}: a share of the budget, in [0, 1]")
