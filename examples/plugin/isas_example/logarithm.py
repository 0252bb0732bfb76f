"""A number that is found by its logarithm: `log:KEY` for a positive number KEY of the scene."""

from __future__ import annotations

import drjit as dr
import numpy as np

from isas_cli.unknowns.kind import Kind, Loaded
from isas_cli.unknowns.value import Value

_PREFIX = "log:"


class Logarithm(Kind):
    """log x of one number x > 0: steps are shares of x, which suits what may be 0.1 or 1000."""

    name = "logarithm"

    @classmethod
    def keys(cls, loaded: Loaded) -> list[str]:
        """Names of its own: it takes no other kind's keys away."""
        params = loaded.params
        numbers = (key for key in params.keys() if Value.matches(params, key))
        return [_PREFIX + key for key in numbers if _positive(params[key])]

    def __init__(self, key: str, loaded: Loaded):
        parameter = key.removeprefix(_PREFIX)
        super().__init__(parameter, loaded)
        self.key, self.writes = key, [parameter]
        low, high = self.range
        self.range = [float(np.log(max(low, 1e-6))), float(np.log(high))]
        self.present = np.log(self.present).astype(np.float32)
        self.unit, self.role, self.bare = "e-folds", "", (0.0, 0.0)

    def write(self, leaf, written: dict) -> None:
        """Differentiable: what is found by x flows back to log x."""
        written[self.writes[0]] = dr.exp(leaf)


def _positive(value) -> bool:
    numbers = np.array(value).reshape(-1)
    return numbers.size == 1 and numbers[0] > 0
