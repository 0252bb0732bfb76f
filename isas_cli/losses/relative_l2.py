"""Squared error relative to the target."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..runtime.errors import InputError
from .loss import Loss


@dataclass(frozen=True)
class RelativeL2(Loss):
    """Squared error relative to the target, ℓ = (I - T)² / (T² + epsilon).

    The denominator holds the target, not the rendering, so that ∂ℓ/∂I = 2 (I - T)/(T² + epsilon)
    is linear in I. Bias: none against this loss. (The variant with the rendering in the
    denominator is another objective, and biased for single samples.) ``epsilon``, radiance²,
    keeps black targets from dominating.
    """

    epsilon: float = 1e-2
    linear = True

    def __post_init__(self) -> None:
        if not self.epsilon > 0:
            raise InputError(f"loss.epsilon={self.epsilon}: must be above 0")

    def value(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        return dr.square(image - target) / (dr.square(target) + self.epsilon)

    def measured(self, a: mi.Color3f, b: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        return (a - target) * (b - target) / (dr.square(target) + self.epsilon)

    def derivative(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        return 2 * (image - target) / (dr.square(target) + self.epsilon)

    def curvature(self, target: mi.Color3f) -> mi.Color3f:
        return 2 / (dr.square(target) + self.epsilon)
