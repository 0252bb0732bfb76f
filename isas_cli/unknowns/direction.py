"""Directions: of lights that have one as a parameter, such as the sun of a sky."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .kind import Kind, Loaded
from .parameters import is_differentiable, owner


class Direction(Kind):
    """Where light comes from, ``(3,)``, of unit length: the length is no unknown. What is added to
    it is in radians, nearly, and its error is the angle to the truth.

    It moves the light and all shadows, so path replay does not differentiate it.
    """

    name = "direction"
    moves_geometry = True
    all_of = -1.0, 1.0

    @classmethod
    def matches(cls, params: mi.SceneParameters, key: str) -> bool:
        if not key.endswith("direction") or not isinstance(owner(params, key), mi.Emitter):
            return False
        return is_differentiable(params, key) and dr.size_v(params[key]) == 3

    def __init__(self, key: str, loaded: Loaded):
        super().__init__(key, loaded)
        read, self.present = self.present, self.normal(self.present)
        self.rewrites |= not np.array_equal(read, self.present)
        self.range, self.unit, self.scale = (-np.inf, np.inf), "radians", 1.0

    def write(self, leaf, written: dict) -> None:
        written[self.key] = dr.normalize(leaf)

    def normal(self, array: np.ndarray) -> np.ndarray:
        return (array / np.linalg.norm(array)).astype(np.float32)

    def projected(self, leaf):
        return dr.normalize(leaf)

    def refusal(self, array: np.ndarray) -> str | None:
        return None if array.any() else "a direction of no length: give [x, y, z]"

    def error(self, array: np.ndarray, truth: np.ndarray, seen: np.ndarray) -> float:
        a, b = (each.astype(np.float64) for each in (array, truth))
        return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
