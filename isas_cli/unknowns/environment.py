"""Environment maps: light from all directions as a picture."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .kind import Kind, Loaded, picture
from .parameters import is_differentiable, owner


class Environment(Kind):
    """The texels of an environment map, ``(H, W, 3)``, linear radiance.

    Mitsuba keeps them as (H, W + 2, 3): its last column stands before the first once more, and its
    first behind the last. Only the W in between are unknown, and the others follow them.
    """

    name = "environment map"
    axes = ((0, False), (1, True))  # from pole to pole, and around

    @classmethod
    def matches(cls, params: mi.SceneParameters, key: str) -> bool:
        if not (isinstance(owner(params, key), mi.Emitter) and dr.is_tensor_v(params[key])):
            return False
        return is_differentiable(params, key)

    def __init__(self, key: str, loaded: Loaded):
        super().__init__(key, loaded)
        self.unit = "radiance"
        self.turned = 'filename = "' not in str(owner(loaded.params, key))
        self._whole = self.present.shape
        self.present = self.present[:, 1:-1].copy()
        # For each entry of the map: which of the texels stands there.
        texels = np.arange(self.present.size, dtype=np.uint32).reshape(self.present.shape)
        self._texel = mi.UInt32(np.pad(texels, ((0, 0), (1, 1), (0, 0)), mode="wrap").ravel())

    def write(self, leaf, written: dict) -> None:
        entries = dr.gather(mi.Float, leaf.array, self._texel)
        written[self.key] = type(leaf)(entries, self._whole)

    def refusal(self, array: np.ndarray) -> str | None:
        if array.any():
            return None
        return "a map that is zero everywhere cannot be sampled; it must be above 0 somewhere"

    def pictures(self, array: np.ndarray) -> dict[str, np.ndarray]:
        return picture(array)
