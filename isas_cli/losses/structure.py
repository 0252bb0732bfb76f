"""Structural similarity, with the target's own mean and variance below."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi

from ..rendering.windows import Windows
from ..runtime.errors import InputError
from .l2 import L2
from .loss import Loss


@dataclass(frozen=True)
class Structure(Loss):
    """Structural dissimilarity of windows of ``side`` × ``side`` pixels. With d = I - T over a
    window,

        ℓ = mean(d)² / (2 mean(T)² + (range/100)²) + var(d) / (2 var(T) + (3 range/100)²).

    1 - SSIM is 1 - (1 - a)(1 - b), where a and b have those numerators exactly and mean(I)² +
    mean(T)², var(I) + var(T) in their denominators (Brunet et al., *On the Mathematical Properties
    of the Structural Similarity Index*, 2012). Here both are the target's alone, as in
    ``RelativeL2``: so ∂ℓ/∂I is linear in I, and where I comes near T, ℓ is 1 - SSIM but for terms
    of third order. Bias: none against ℓ. SSIM itself would take a single sample's noise for
    structure, and its derivative is biased.

    ``range``: of the radiances, above 0. Raises InputError for what is no such setting.
    """

    side: int = 7
    range: float = 1.0
    linear = True

    def __post_init__(self) -> None:
        if not 2 <= self.side <= 64:
            raise InputError(f"loss.side={self.side}: pixels along a window, from 2 to 64")
        if not 0 < self.range < float("inf"):
            raise InputError(f"loss.range={self.range}: must be a finite number above 0")

    @property
    def windows(self) -> Windows:
        return Windows(self.side)

    @property
    def pixelwise(self) -> Loss:
        return L2()

    def value(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        return self.measured(image, image, target)

    def measured(self, a: mi.Color3f, b: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        windows, both = self.windows, (a - target, b - target)
        first, second = (windows.mean(each) for each in both)
        # About the means, as below: a difference of squares has no digits left.
        apart = [each - windows.each(mean) for each, mean in zip(both, (first, second))]
        below, beneath = self._below(target)
        return first * second / below + windows.mean(apart[0] * apart[1]) / beneath

    def derivative(self, image: mi.Color3f, target: mi.Color3f) -> mi.Color3f:
        windows, difference = self.windows, image - target
        mean = windows.mean(difference)
        below, beneath = self._below(target)
        found = windows.each(mean / below) + (difference - windows.each(mean)) / windows.each(
            beneath
        )
        return found * (2 / windows.count)

    def _below(self, target: mi.Color3f) -> tuple[mi.Color3f, mi.Color3f]:
        mean = self.windows.mean(target)
        # About the mean: a bright window's squares would leave nothing of its variance.
        apart = target - self.windows.each(mean)
        variance = self.windows.mean(apart * apart)
        return 2 * mean * mean + (0.01 * self.range) ** 2, 2 * variance + (0.03 * self.range) ** 2
