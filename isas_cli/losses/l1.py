"""Absolute error."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .loss import Loss


@dataclass(frozen=True)
class L1(Loss):
    """Absolute error, ℓ = |I - T|, ∂ℓ/∂I = sign(I - T).

    Bias: the sign of a noisy radiance is not the sign of its mean. With single samples the
    estimate is the exact gradient of E|⟨I⟩ - T| where ⟨I⟩ is the one-sample radiance taken as
    fixed while its mean moves: its minimum is where T is the *median* of ⟨I⟩. Use it for outliers
    in photographs, not for measuring.
    """

    linear = False

    def value(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        return dr.abs(image - target)

    def derivative(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        difference = image - target
        # The sign of what is no number would count as one.
        sign = dr.select(dr.isfinite(difference), dr.sign(difference), dr.nan)
        return dr.select(difference == 0, 0, sign)

    def curvature(self, target: mi.Color3f) -> mi.Color3f:
        """1 everywhere. The curvature of E|⟨I⟩ - T| is twice the density of ⟨I⟩ at T, which one
        sample does not show."""
        return mi.Color3f(1)
