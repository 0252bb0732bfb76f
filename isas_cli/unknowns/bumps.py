"""Normal maps: directions laid out on surfaces as colours."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .kind import Loaded
from .parameters import owner
from .ranges import fed
from .texture import Texture

# Of a normal of unit length, its part along the surface's own: a step may not turn it under.
_UP = 1e-2
# What is shorter is no direction.
_SHORT = 1e-3


class Bumps(Texture):
    """The texels of a normal map, ``(H, W, 3)``, each (n + 1) / 2 of a normal n of unit length: the
    length, which changes no image, is no unknown. After a step n is brought back to it, and kept
    above the surface. What the scene was loaded with, the truth, stays as it is but for the length.
    """

    name = "normal map"
    all_of = 0.0, 1.0

    @classmethod
    def matches(cls, params: mi.SceneParameters, key: str) -> bool:
        if not isinstance(owner(params, key), mi.Texture) or not super().matches(params, key):
            return False
        ends = [word for _, word, _ in fed(params, key)]
        return params[key].shape[2] == 3 and bool(ends) and set(ends) == {"normalmap"}

    def __init__(self, key: str, loaded: Loaded):
        super().__init__(key, loaded)
        read, self.present = self.present, self.normal(self.present)
        self.rewrites |= not np.array_equal(read, self.present)

    def normal(self, array: np.ndarray) -> np.ndarray:
        directions = 2 * array.astype(np.float64) - 1
        length = np.linalg.norm(directions, axis=2, keepdims=True)
        unit = np.divide(directions, length, out=np.zeros_like(directions), where=length > 0)
        return ((unit + 1) / 2).astype(np.float32)

    def refusal(self, array: np.ndarray) -> str | None:
        lengths = np.linalg.norm(2 * array.astype(np.float64) - 1, axis=2)
        # Files have such texels where nothing shows them.
        if np.mean(lengths < _SHORT) <= 0.5:
            return None
        return "a normal of no length: give [0.5, 0.5, 1], which is flat"

    def projected(self, leaf):
        normal = 2 * dr.unravel(mi.Vector3f, leaf.array) - 1
        normal.z = dr.maximum(normal.z, _UP)
        return type(leaf)(dr.ravel((dr.normalize(normal) + 1) / 2), leaf.shape)
