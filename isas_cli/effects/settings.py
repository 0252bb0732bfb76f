"""What is asked for: how much of a scene's light transport a run simulates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional

from ..runtime.errors import InputError

_MOST_LIGHTS = 64


@dataclass
class Effects:
    """``probe``: measure what structure cannot tell. ``max_depth``: edges of the longest path.
    ``light_samples``: of emitters at the first hit, for the residual and for the derivative. None:
    as the probe finds best, else all that the scene has and one sample. ``tolerance``: share of an
    unknown's gradient, see ``plan``. ``finish``: the last share of the budget with all effects."""

    probe: bool = True
    max_depth: Optional[int] = None
    light_samples: Optional[List[int]] = None
    tolerance: float = 0.005
    finish: float = 0.0

    def __post_init__(self) -> None:
        if self.max_depth is not None and self.max_depth < 1:
            raise InputError(f"effects.max_depth={self.max_depth}: at least 1, edges of a path")
        lights = self.light_samples
        if lights is not None and not (
            len(lights) == 2 and all(1 <= n <= _MOST_LIGHTS for n in lights)
        ):
            text = ",".join(map(str, lights))
            raise InputError(
                f"effects.light_samples=[{text}]: two numbers from 1 to {_MOST_LIGHTS}, for the "
                "residual and for the derivative, such as [4,4]"
            )
        if not 0 <= self.tolerance < 1:
            raise InputError(f"effects.tolerance={self.tolerance}: a share, in [0, 1)")
        if not 0 <= self.finish <= 1:
            raise InputError(f"effects.finish={self.finish}: a share of the budget, in [0, 1]")
