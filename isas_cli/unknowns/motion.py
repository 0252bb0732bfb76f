"""Camera poses: how each photograph's camera stands otherwise than its file says."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .cameras import OfCameras
from .kind import Loaded

# Beyond, a pose is not refined but wrong, and another texture fits it.
_FARTHEST = 20.0


class Motion(OfCameras):
    """Turns about the world's axes and shifts along them of every camera, ``(V, 6)``.

    A surface that is painted elsewhere, seen by cameras that all moved, looks the same. So the
    median over the views of each turn and shift stays 0: views that are held out keep the poses of
    their file, and fit the others where most of these stand as well as they did. Were one camera's
    pose to stay, all others would take over its error.
    """

    name = "camera pose"
    field, each = "motion", 6

    @classmethod
    def keys(cls, loaded: Loaded) -> list[str]:
        return ["cameras"] if loaded.pixel is not None else []

    def __init__(self, key: str, loaded: Loaded):
        self.key, self.writes = key, []
        self.present = np.zeros((loaded.views.count, self.each), np.float32)
        self.range = (-_FARTHEST, _FARTHEST)
        table = np.arange(self.present.size).reshape(self.present.shape)
        self._lie(loaded.views, table, np.repeat(loaded.pixel, 3, axis=1))

    def projected(self, leaf):
        views, world = self._views.count, leaf.array * self._sizes
        pair = dr.arange(mi.UInt32, views * len(self._sizes))
        entry, other = pair % len(self._sizes), pair // len(self._sizes)
        number, view = entry % self.each, entry // self.each
        a, b = (dr.gather(mi.Float, world, v * self.each + number) for v in (view, other))
        before = (b < a) | ((b == a) & (other < view))
        rank = dr.zeros(mi.UInt32, len(self._sizes))
        dr.scatter_add(rank, mi.UInt32(1), entry, before)
        middle = (rank == (views - 1) // 2) | (rank == views // 2)
        entry = dr.arange(mi.UInt32, len(self._sizes))
        total = dr.zeros(mi.Float, self.each)
        dr.scatter_add(total, world / (1 + (views % 2 == 0)), entry % self.each, middle)
        apart = dr.gather(mi.Float, total, entry % self.each) / self._sizes
        return mi.TensorXf(leaf.array - apart, leaf.shape)

    def numbers(self, array: np.ndarray, truth: np.ndarray | None) -> dict[str, float]:
        return {"farthest": float(np.abs(array).max())}
