"""Camera poses: how each photograph's camera stands otherwise than its file says."""

from __future__ import annotations

import numpy as np

from .cameras import OfCameras
from .kind import Loaded

# Beyond, a pose is not refined but wrong, and another texture fits it.
_FARTHEST = 20.0


class Motion(OfCameras):
    """Turns about the world's axes and shifts along them of every camera, ``(V, 6)``.

    None of them is held: that a surface painted elsewhere, seen by cameras that all moved, looks
    the same is so of few objects, and of these nothing tells them to move together. Were one
    camera's pose to stay, or the middle of all, it would keep its error, or hand it to the others.
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

    def numbers(self, array: np.ndarray, truth: np.ndarray | None) -> dict[str, float]:
        return {"farthest": float(np.abs(array).max())}
