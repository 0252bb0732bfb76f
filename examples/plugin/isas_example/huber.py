"""Huber's loss (1964)."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from isas_cli.losses import Loss
from isas_cli.runtime.errors import InputError


@dataclass(frozen=True)
class Huber(Loss):
    """ℓ = d² where |d| ≤ ``width``, else ``width`` (2 |d| - ``width``), with d = I - T.

    Bias: the derivative is not linear in I, so that with one noisy sample of a pixel the minimum
    lies between its mean and its median. For outliers, not for measuring.
    """

    width: float = 0.1
    linear = False

    def __post_init__(self) -> None:
        if not self.width > 0:
            raise InputError(f"loss.width={self.width}: must be above 0")

    def value(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        apart = dr.abs(image - target)
        return dr.select(apart <= self.width, apart**2, self.width * (2 * apart - self.width))

    def derivative(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        return 2 * dr.clip(image - target, -self.width, self.width)

    def curvature(self, target: mi.Color3f) -> mi.Color3f:
        return mi.Color3f(2)
