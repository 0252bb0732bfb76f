"""Exposures: by how much each photograph is brighter than the scene says."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .kind import Kind, Loaded


class Exposure(Kind):
    """A factor on the radiance of every view but the first, ``(V - 1, 1)``, or of each of its
    channels, ``(V - 1, 3)``, beside what files say (``Views.given``). The first view's is 1: a
    factor on all of them is one on the light.

    No parameter of the scene: it lies with the views, and every ray's weight holds it
    (``rendering.rays``). Paths do not carry its derivative, so estimators add it (``add``).
    """

    name = "exposure"
    carried = False

    @classmethod
    def keys(cls, loaded: Loaded) -> list[str]:
        return ["exposure"] if loaded.channels is not None else []

    def __init__(self, key: str, loaded: Loaded):
        self.key, self.writes = key, []
        self._views, channels = loaded.views, loaded.channels
        self._type = mi.TensorXf
        self.present = np.ones((self._views.count - 1, channels), np.float32)
        # Below, a view would tell nothing.
        self.range, self.unit = (0.01, 100.0), "exposure"
        entry = np.arange(self.present.size, dtype=np.uint32).reshape(self.present.shape)
        first = np.zeros((1, channels), np.uint32)
        table = np.broadcast_to(np.concatenate([first, entry]), (self._views.count, 3))
        self._entry, self._free = mi.UInt32(table.ravel()), mi.Bool(np.arange(table.size) >= 3)
        self._views.exposure = dr.opaque(mi.Float, 1, table.size)

    def write(self, leaf, written: dict) -> None:
        found = dr.gather(mi.Float, dr.detach(leaf).array, self._entry, self._free)
        self._views.exposure = dr.select(self._free, found, 1)
        dr.eval(self._views.exposure)

    def numbers(self, array: np.ndarray, truth: np.ndarray | None) -> dict[str, float]:
        return {"least": float(array.min()), "most": float(array.max())}


def add(leaf: mi.TensorXf, view: mi.UInt32, slope: mi.Color3f) -> None:
    """Add Σ_i ``slope``_i = Σ_i ∂ℒ/∂e of the view that the i-th path belongs to, to the gradient of
    ``leaf``, the exposures e. Traced; ``slope (3, N)``: ∂ℒ/∂I times the radiance before exposure.
    """
    channels = leaf.shape[1]
    free = view > 0
    first = (dr.maximum(view, 1) - 1) * channels
    with dr.resume_grad():
        total = mi.Float(0)
        for channel in range(3):
            entry = first + (channel if channels == 3 else 0)
            total += dr.gather(mi.Float, leaf.array, entry, free) * slope[channel]
        if dr.grad_enabled(total):
            dr.backward(dr.sum(total))
