"""What a loss is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mitsuba as mi

from ..rendering.windows import Windows


@dataclass(frozen=True)
class Loss:
    """ℓ of a pixel's channels, traced; settings, which work as they are. ``linear``: whether ∂ℓ/∂I
    is linear in I, so that single samples give it without bias.

    Of a loss with ``windows``, ℓ is of the channels of a window around each pixel: images and
    targets come window by window, so does ∂ℓ/∂I, and values are one a window.
    """

    linear: ClassVar[bool]

    @property
    def windows(self) -> Windows | None:
        """What is read together; None for pixels by themselves."""
        return None

    @property
    def pixelwise(self) -> "Loss":
        """A loss of pixels by themselves that stands in for this one where samplers look."""
        return self

    def value(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        """ℓ(I, T)."""
        raise NotImplementedError

    def measured(self, a: mi.Color3f, b: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        """ℓ from two independent renderings, for evaluation: at the mean of both, whose noise it
        contains, but where the loss knows better."""
        return self.value(0.5 * (a + b), target)

    def derivative(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        """∂ℓ/∂I."""
        raise NotImplementedError

    def curvature(self, target: mi.Color3f) -> mi.Color3f:
        """∂²ℓ/∂I² at I = T, for samplers that ask how much an unknown matters; no gradient uses
        it."""
        raise NotImplementedError
