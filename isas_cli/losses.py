"""Pixel losses: value and derivative with respect to the rendered radiance.

Every loss is a weighted mean over the pixels of all views and their three channels,

    ℒ(I) = Σ_j w_j Σ_c ℓ(I_jc, T_jc) / (3 Σ_j w_j),

with w_j the target mask (1 where there is none). ``derivative`` returns ∂ℓ/∂I only; the
estimator multiplies by w_j / (3 Σ w). The image-space estimators feed a *single-sample* radiance
into it: that is unbiased for ∂ℒ/∂I exactly when ∂ℓ/∂I is linear in I (ISAS §4.1), which
``linear`` says.

``curvature`` is ∂²ℓ/∂I², for samplers that ask how much an unknown matters; no gradient uses it.
``measured`` is ℓ from two independent renderings of a pixel, for evaluation: without the noise of
the renderings where the loss is quadratic in I.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .errors import InputError


@dataclass
class L2:
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


@dataclass
class RelativeL2:
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


@dataclass
class L1:
    """Absolute error, ℓ = |I - T|, ∂ℓ/∂I = sign(I - T).

    Bias: the sign of a noisy radiance is not the sign of its mean. With single samples the
    estimate is the exact gradient of E|⟨I⟩ - T| where ⟨I⟩ is the one-sample radiance taken as
    fixed while its mean moves: its minimum is where T is the *median* of ⟨I⟩. Use it for outliers
    in photographs, not for measuring.
    """

    linear = False

    def value(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        return dr.abs(image - target)

    def measured(self, a: mi.Color3f, b: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        """At the mean of both, whose noise it contains."""
        return self.value(0.5 * (a + b), target)

    def derivative(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        difference = image - target
        return dr.select(difference == 0, 0, dr.sign(difference))

    def curvature(self, target: mi.Color3f) -> mi.Color3f:
        """1 everywhere. The curvature of E|⟨I⟩ - T| is twice the density of ⟨I⟩ at T, which one
        sample does not show."""
        return mi.Color3f(1)
