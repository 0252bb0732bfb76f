"""Plain renderings of many pixels at many samples, in passes that fit memory."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene.problem import Problem
from . import rays
from .kernels import recorded

# Lanes per pass: large enough to fill the cores, small enough for a few hundred MB.
_LANES = 1 << 20


class Renderer:
    """Means over independent paths for given pixels, at the scene's present values.

    One seed per sample and chunk of pixels, from ``seed(i)``. Paths that come out non-finite are
    left out of the mean and counted in ``nonfinite``.
    """

    def __init__(self, problem: Problem, like: "Renderer | None" = None):
        """``like``: a renderer of the same problem, whose recorded kernel is used again."""
        self.problem = problem
        self.nonfinite = 0
        if like is not None:
            self._kernel = like._kernel
            return
        integrator = problem.integrator

        def kernel(scene, sensors, views, leaves, pixel, total, bad, seed):
            with dr.suspend_grad():
                place, stream = views.locate(pixel), rays.stream(seed, dr.width(pixel))
                radiance = rays.radiance(integrator, scene, sensors, views, place, stream)
                finite = dr.all(dr.isfinite(radiance))
                total = total + dr.select(finite, radiance, 0)
                bad = bad + dr.select(finite, mi.UInt32(0), 1)
                dr.eval(total, bad)
            return total, bad

        self._kernel = recorded(kernel, problem)

    def pixels(
        self, pixel: mi.UInt32, spp: int, seed: Callable[[int], int], done=lambda paths: None
    ) -> mi.Color3f:
        """Mean radiance of ``spp`` paths through each pixel. Evaluates after every pass."""
        p = self.problem
        count = dr.width(pixel)
        total, bad = dr.zeros(mi.Color3f, count), dr.zeros(mi.UInt32, count)
        dr.make_opaque(total, bad, pixel)
        for sample in range(spp):
            own = dr.opaque(mi.UInt32, seed(sample))
            total, bad = self._kernel(*p.traced, pixel, total, bad, own)
            # Keeps Ctrl-C prompt and the progress honest: launches are asynchronous.
            dr.sync_thread()
            done(count)
        self.nonfinite += int(dr.sum(bad)[0])
        valid = mi.Float(spp) - mi.Float(bad)
        return total / dr.maximum(valid, 1)

    def range(
        self, start: int, stop: int, spp: int, seed: Callable[[int], int], done=lambda paths: None
    ) -> np.ndarray:
        """Mean radiance of pixels start … stop - 1, ``(stop - start, 3) float32`` on the host."""
        result = np.empty((stop - start, 3), np.float32)
        for chunk, first in enumerate(range(start, stop, _LANES)):
            size = min(_LANES, stop - first)
            pixel = dr.arange(mi.UInt32, size) + first
            mean = self.pixels(pixel, spp, lambda s, c=chunk: seed(c * spp + s), done)
            result[first - start : first - start + size] = np.array(mean).T
        return result

    def view(self, view: int, spp: int, seed: Callable[[int], int]) -> np.ndarray:
        """One view, ``(H, W, 3) float32``, linear."""
        width, height = self.problem.film_sizes[view]
        start = sum(w * h for w, h in self.problem.film_sizes[:view])
        flat = self.range(start, start + width * height, spp, seed)
        return flat.reshape(height, width, 3)
