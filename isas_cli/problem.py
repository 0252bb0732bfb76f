"""An inverse problem as one object: scene, cameras, targets, unknowns and, where known, truth."""

from __future__ import annotations

from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi
import numpy as np

from .pixels import Views
from .unknowns import Unknowns


@dataclass
class TargetHalves:
    """A rendered target T as the mean of two independent renderings T1 and T2.

    ``difference``: T1 - T2, ``(n, 3) float16`` on the host; ``share``: weight of T2 in the mean.
    An error measured against both halves, (I - T1)(I - T2), does not contain the target's noise.
    """

    difference: np.ndarray
    share: float

    def at(self, target: mi.Color3f, pixel: np.ndarray) -> tuple[mi.Color3f, mi.Color3f]:
        """T1 and T2 of the given pixels, of which ``target`` holds T."""
        difference = mi.Color3f(self.difference[pixel].astype(np.float32).T)
        return target + self.share * difference, target - (1 - self.share) * difference


@dataclass
class Problem:
    """Everything that defines what is to be found; knows no sampler and no optimiser.

    ``targets``: ``(3 n,) float32``, linear radiance, pixel after pixel of all views;
    ``mask``: ``(n,) float32`` weights of the pixels, or None for all ones;
    ``share``: 1 / (3 Σ_j w_j), the factor between a pixel's ∂ℓ/∂I and ∂ℒ/∂I (opaque, one entry);
    ``target_halves``: what a rendered target's noise is known by, None for photographs;
    ``film_sizes``: ``[(width, height), …]`` per view; ``content_hash``: of scene and cameras.
    """

    name: str
    scene: mi.Scene
    integrator: mi.Integrator
    sensors: mi.SensorPtr
    film_sizes: list[tuple[int, int]]
    views: Views
    unknowns: Unknowns
    content_hash: str
    targets: mi.Float | None = None
    mask: mi.Float | None = None
    share: mi.Float | None = None
    target_hash: str = ""
    target_halves: TargetHalves | None = None
    warnings: list[str] = field(default_factory=list)

    @property
    def truth_known(self) -> bool:
        return all(u.truth is not None for u in self.unknowns)

    def set_targets(self, images: mi.Float, mask: mi.Float | None, digest: str) -> None:
        """Take target images over and fix the loss's normalisation."""
        self.targets, self.mask, self.target_hash = images, mask, digest
        weight = float(self.views.total) if mask is None else float(dr.sum(mask)[0])
        self.share = dr.opaque(mi.Float, 1.0 / (3.0 * weight))

    def target_image(self, view: int) -> np.ndarray:
        """Target of one view, ``(H, W, 3) float32``, linear."""
        width, height = self.film_sizes[view]
        start = sum(w * h for w, h in self.film_sizes[:view]) * 3
        index = dr.arange(mi.UInt32, width * height * 3) + start
        return np.array(dr.gather(mi.Float, self.targets, index)).reshape(height, width, 3)
