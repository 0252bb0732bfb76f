"""An inverse problem as one object: scene, cameras, targets, unknowns and, where known, truth."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene.views import Views
from ..unknowns.unknowns import Unknowns

if TYPE_CHECKING:
    from ..rendering.integrators import Integrator


@dataclass
class Problem:
    """Everything that defines what is to be found; knows no sampler and no optimiser.

    ``targets``: ``(3 n,) float32``, linear radiance, pixel after pixel of all views;
    ``mask``: ``(n,) float32`` weights of the pixels, or None for all ones;
    ``share``: 1 / (3 Σ_j w_j), the factor between a pixel's ∂ℓ/∂I and ∂ℒ/∂I (opaque, one entry);
    ``film_sizes``: ``[(width, height), …]`` per view; ``content_hash``: of scene and cameras.
    """

    name: str
    scene: mi.Scene
    integrator: "Integrator"
    sensors: mi.SensorPtr
    film_sizes: list[tuple[int, int]]
    views: Views
    unknowns: Unknowns
    content_hash: str
    targets: mi.Float | None = None
    mask: mi.Float | None = None
    share: mi.Float | None = None
    target_hash: str = ""
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
