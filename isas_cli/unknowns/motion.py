"""Camera poses: how each photograph's camera stands otherwise than its file says."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .kind import Kind, Loaded
from .parameters import like

# Width of the Gaussian that the images are blurred with along each number of a pose, pixels: about
# what a reprojection error is, and wide enough that a difference is more than noise.
WIDTH = 0.5
# Of a pose: a turn about the world's axes through the camera, a shift along them.
_NUMBERS = 6
# Beyond, a pose is not refined but wrong, and another texture fits it.
_FARTHEST = 20.0


class Motion(Kind):
    """Turns and shifts of every camera but the first, ``(V - 1, 6)``, in pixels: how far what it
    looks at moves in its picture. The first one's stay: a surface that is painted elsewhere, seen
    by cameras that all moved, looks the same.

    They lie with the views and move their rays (``rendering.rays``). Paths do not carry their
    derivative, since what is seen changes: estimators add differences of renderings (``add``).
    """

    name = "camera pose"
    carried = False

    @classmethod
    def keys(cls, loaded: Loaded) -> list[str]:
        return ["cameras"] if loaded.pixel is not None else []

    def __init__(self, key: str, loaded: Loaded):
        self.key, self.writes = key, []
        self._views, sizes = loaded.views, loaded.pixel
        self._type = mi.TensorXf
        self.present = np.zeros((self._views.count - 1, _NUMBERS), np.float32)
        self.range, self.unit = (-_FARTHEST, _FARTHEST), "pixels"
        # Radians and scene units that are a pixel of each view.
        self._size = mi.Float(np.repeat(sizes, 3, axis=1).ravel().astype(np.float32))
        self._views.motion = dr.zeros(mi.Float, self._views.count * _NUMBERS)
        dr.make_opaque(self._views.motion)

    def write(self, leaf, written: dict) -> None:
        self._views.motion = self.placed(dr.detach(leaf).array)
        dr.eval(self._views.motion)

    def placed(self, pixels: mi.Float) -> mi.Float:
        """``(6 (V - 1),)`` pixels as ``Views.motion``, ``(6 V,)``. Traced."""
        entry = dr.arange(mi.UInt32, self._views.count * _NUMBERS)
        free = entry >= _NUMBERS
        return dr.gather(mi.Float, pixels, entry - _NUMBERS, free) * self._size

    def jitter(self, seed: int) -> mi.Float:
        """Random offsets of all cameras, ``(6 (V - 1),)`` pixels, Gaussian of ``WIDTH``."""
        drawn = np.random.default_rng(seed).normal(0, WIDTH, self.present.size)
        return like(mi.Float, drawn.astype(np.float32))

    def numbers(self, array: np.ndarray, truth: np.ndarray | None) -> dict[str, float]:
        return {"farthest": float(np.abs(array).max())}


def add(leaf: mi.TensorXf, view: mi.UInt32, slope: mi.Float, jitter: mi.Float) -> None:
    """Add Σ_i ``slope``_i δ/σ² to the gradient of ``leaf``, where δ, ``jitter``, is the offset of
    the i-th path's view, and ``slope (N,)`` ∂ℒ/∂I times half the difference of its radiance at +δ
    and -δ: the derivative of images blurred by a Gaussian of width σ (PRDPT Eq. 8), without bias.
    Traced."""
    free = view > 0
    first = (dr.maximum(view, 1) - 1) * _NUMBERS
    with dr.resume_grad():
        total = mi.Float(0)
        for number in range(_NUMBERS):
            offset = dr.gather(mi.Float, dr.detach(jitter), first + number, free) / WIDTH**2
            total += dr.gather(mi.Float, leaf.array, first + number, free) * (slope * offset)
        if dr.grad_enabled(total):
            dr.backward(dr.sum(total))
