"""An inverse problem as one object: scene, cameras, targets, unknowns and, where known, truth."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.cache import digest
from ..scene.views import Views
from ..unknowns.parameters import own
from ..unknowns.unknowns import Unknowns
from . import lenses, weights

if TYPE_CHECKING:
    from ..rendering.integrators import Integrator


@dataclass
class Problem:
    """Everything that defines what is to be found; knows no sampler and no optimiser.

    ``targets``: ``(3 n,) float32``, linear radiance, pixel after pixel of all views;
    ``variance``: of their pixels' noise ``(n,) float32``, the channels' mean, or None where nothing
    is known of it;
    ``mask``: ``(n,) float32`` weights of the pixels, or None for all ones;
    ``share``: 1 / (3 Σ_j w_j), the factor between a pixel's ∂ℓ/∂I and ∂ℒ/∂I (opaque, one entry);
    ``film_sizes``: ``[(width, height), …]`` per view; ``content_hash``: of scene and cameras;
    ``kept``: where some views are left out (``only``), the numbers of the others;
    ``flat``: parameters that held pictures of one colour and now hold few texels;
    ``names``: of the views, where they have any; ``held_out``: the same with views of which nothing
    is learnt, or None; ``freezes``: whether Dr.Jit can record kernels that trace the scene;
    ``photographed``: of photographs, the standard deviation of a pixel's noise in units of radiance
    and how it was found, or None and why it is not known; ``part``: ``(n,) float32``, how much of
    each pixel the object fills by alpha or masks, -1 where these say nothing; None without any;
    ``edges``: distances of edges in photographs (``rendering.picture_edges``), where they count;
    ``weights``: ``(V,)``, a factor on the loss of each view, mean 1, which ``mask`` has in it.
    """

    name: str
    scene: mi.Scene
    integrator: "Integrator"
    sensors: mi.SensorPtr | lenses.Lenses
    film_sizes: list[tuple[int, int]]
    views: Views
    unknowns: Unknowns
    content_hash: str
    targets: mi.Float | None = None
    variance: np.ndarray | None = None
    mask: mi.Float | None = None
    share: mi.Float | None = None
    target_hash: str = ""
    warnings: list[str] = field(default_factory=list)
    kept: tuple[int, ...] | None = None
    flat: list[str] = field(default_factory=list)
    names: tuple[str, ...] = ()
    held_out: "Problem | None" = None
    freezes: bool = True
    photographed: tuple[float | None, str] | None = None
    part: mi.Float | None = None
    edges: mi.Float | None = None
    weights: np.ndarray | None = None

    @property
    def traced(self) -> tuple:
        """What kernels that trace paths take first."""
        return self.scene, self.sensors, self.views, self.unknowns.leaves

    @property
    def truth_known(self) -> bool:
        return all(u.truth is not None for u in self.unknowns)

    def set_targets(
        self,
        images: mi.Float,
        mask: mi.Float | None,
        digest: str,
        variance: np.ndarray | None = None,
    ) -> None:
        """Take target images over and fix the loss's normalisation."""
        self.targets, self.mask, self.target_hash = images, mask, digest
        self.variance = variance
        weight = float(self.views.total) if mask is None else float(dr.sum(mask)[0])
        self.share = dr.opaque(mi.Float, 1.0 / (3.0 * weight))

    def weigh(self, given) -> None:
        """Let views count as ``weights.of_views`` says, by their pixels' masks."""
        counts = [width * height for width, height in self.film_sizes]
        mask = np.ones(self.views.total, np.float32) if self.mask is None else np.array(self.mask)
        # What is black beside the object counts, and is none of what a view shows of it, if any.
        shown = mask if self.part is None else mask * (np.array(self.part) > 0)
        pairs = zip(*(np.split(each, np.cumsum(counts)[:-1]) for each in (shown, mask)))
        masks = [own if own.any() else whole for own, whole in pairs]
        self.weights = factors = weights.of_views(given, masks, self.names)
        mask = own(mi.Float, mask * np.repeat(factors, counts).astype(np.float32))
        weighed = digest("weights", self.target_hash, [float(each) for each in factors])
        self.set_targets(self.targets, mask, weighed, self.variance)

    def pixels(self, views: tuple[int, ...]) -> np.ndarray:
        """The pixels of some views, ``uint32``, view after view."""
        ends = np.cumsum([0, *(width * height for width, height in self.film_sizes)])
        return np.concatenate([np.arange(ends[v], ends[v + 1], dtype=np.uint32) for v in views])

    def only(self, views: tuple[int, ...]) -> "Problem":
        """The same with some of the views: losses and gradients are still those of all, to which
        the others are taken to add nothing that depends on an unknown."""
        pixels = mi.UInt32(self.pixels(views))
        sizes = [self.film_sizes[view] for view in views]
        return replace(
            self,
            sensors=lenses.only(self.sensors, mi.UInt32(views)),
            film_sizes=sizes,
            views=Views.of(sizes),
            targets=dr.ravel(dr.gather(mi.Color3f, self.targets, pixels)),
            variance=None if self.variance is None else self.variance[np.array(pixels)],
            mask=None if self.mask is None else dr.gather(mi.Float, self.mask, pixels),
            part=None if self.part is None else dr.gather(mi.Float, self.part, pixels),
            edges=None if self.edges is None else self._edges(pixels),
            weights=None if self.weights is None else self.weights[list(views)],
            kept=tuple(views),
        )

    def _edges(self, pixels: mi.UInt32) -> mi.Float:
        each = dr.width(self.edges) // self.views.total
        count = dr.width(pixels)
        index = dr.repeat(pixels * each, each) + dr.arange(mi.UInt32, count * each) % each
        return dr.gather(mi.Float, self.edges, index)

    def target_image(self, view: int) -> np.ndarray:
        """Target of one view, ``(H, W, 3) float32``, linear."""
        return self._of_view(self.targets, view, 3)

    def counting(self, view: int) -> np.ndarray:
        """Which pixels of one view count, ``(H, W) bool``."""
        width, height = self.film_sizes[view]
        if self.mask is None:
            return np.ones((height, width), bool)
        return self._of_view(self.mask, view, 1)[..., 0] > 0

    def _of_view(self, values: mi.Float, view: int, channels: int) -> np.ndarray:
        width, height = self.film_sizes[view]
        start = sum(w * h for w, h in self.film_sizes[:view]) * channels
        index = dr.arange(mi.UInt32, width * height * channels) + start
        return np.array(dr.gather(mi.Float, values, index)).reshape(height, width, channels)
