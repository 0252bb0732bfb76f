"""Squared error."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .loss import Loss


@dataclass(frozen=True)
class L2(Loss):
    """Squared error, ℓ = (I - T)², ∂ℓ/∂I = 2 (I - T) (ISAS Eq. 17).

    Bias: none. The derivative is linear in I, so an unbiased radiance gives an unbiased gradient.
    """

    linear = True

    def value(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        return dr.square(image - target)

    def measured(self, a: mi.Color3f, b: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        return (a - target) * (b - target)

    def derivative(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        return 2 * (image - target)

    def curvature(self, target: mi.Color3f) -> mi.Color3f:
        return mi.Color3f(2)
