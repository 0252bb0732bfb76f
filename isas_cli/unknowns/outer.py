"""Parameters of a renderer that isas knows nothing of (``scene.outside``)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .kind import Kind, Loaded
from .parameters import as_numpy


class Outer(Kind):
    """Numbers that its pictures are called for with. Nothing differentiates by them."""

    name = "parameter of another renderer"
    carried = False

    @classmethod
    def keys(cls, loaded: Loaded) -> list[str]:
        return [] if loaded.outside is None else list(loaded.outside.values)

    def __init__(self, key: str, loaded: Loaded):
        self.key, self.writes = key, []
        self._outside, self._type = loaded.outside, mi.TensorXf
        self.present = np.atleast_1d(loaded.outside.values[key]).astype(np.float32)
        # Nobody knows which parameters are alike.
        self.range, self.unit = (-1e6, 1e6), f"unit of {key}"
        self.scale = min(1.0, float(np.abs(self.present).max(initial=0.0))) or 1.0

    def write(self, leaf, written: dict) -> None:
        outside = self._outside
        found = as_numpy(dr.detach(leaf)).reshape(outside.values[self.key].shape)
        outside.values[self.key] = found
