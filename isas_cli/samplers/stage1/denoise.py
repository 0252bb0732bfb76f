"""Denoising of per-cell images with Intel Open Image Denoise."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi

from .cells import Cells


class Denoiser:
    """Puts the grids of all views side by side in one atlas and denoises it at once.

    One call for all views: the filter's cost is mostly per call at these sizes. Neighbouring
    views bleed into each other by a few cells, which can cost efficiency but never correctness:
    the distribution is only where we look. The filter wants both sides to be at least 16.
    """

    def __init__(self, cells: Cells, quality: str):
        import mitsuba_oidn

        self._oidn, self.cells = mitsuba_oidn, cells
        self._quality = {
            "fast": mitsuba_oidn.Quality.Fast,
            "balanced": mitsuba_oidn.Quality.Balanced,
            "high": mitsuba_oidn.Quality.High,
        }[quality]
        across = math.ceil(math.sqrt(len(cells.sizes)))
        self._tile_w = max(c for c, _ in cells.sizes)
        self._tile_h = max(r for _, r in cells.sizes)
        self._width = max(16, across * self._tile_w)
        self._height = max(16, math.ceil(len(cells.sizes) / across) * self._tile_h)
        view, column, row = cells.views.locate(dr.arange(mi.UInt32, cells.count))
        x = (view % across) * self._tile_w + column
        y = (view // across) * self._tile_h + row
        self._slot = y * self._width + x
        dr.eval(self._slot)

    def __call__(self, values: mi.Color3f) -> mi.Color3f:
        """Denoised, non-negative values. The unused part of the atlas holds zeros. Evaluates.

        The largest value is brought to one before and back after: the filter's own exposure gives
        up on images below about 1e-8, which squared derivatives of dark scenes are.
        """
        values = dr.select(dr.isfinite(values), dr.maximum(values, 0), 0)
        top = dr.max(dr.max(values))
        scale = dr.select(top > 0, dr.rcp(top), 1)
        flat = dr.zeros(mi.Float, self._width * self._height * 3)
        for channel in range(3):
            dr.scatter(flat, values[channel] * scale, self._slot * 3 + channel)
        atlas = mi.TensorXf(flat, (self._height, self._width, 3))
        clean = self._oidn.denoise(atlas, hdr=True, quality=self._quality).array
        channels = [dr.gather(mi.Float, clean, self._slot * 3 + c) for c in range(3)]
        return dr.maximum(mi.Color3f(*channels), 0) / scale
