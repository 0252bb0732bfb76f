"""What unknown numbers of cameras share, whichever they are: poses (``motion``), lenses
(``optics``)."""

from __future__ import annotations

from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene.views import Views
from .kind import Kind
from .parameters import like, own

# Width of the Gaussian that the images are blurred with along each number, pixels: about what a
# reprojection error is, and wide enough that a difference is more than noise.
WIDTH = 0.5


class OfCameras(Kind):
    """Numbers of the views' cameras, in pixels: how far what a camera looks at moves in its
    picture.

    They lie with the views and change their rays (``rendering.rays``). Paths do not carry their
    derivative, since what is seen changes: estimators add differences of renderings (``add``).
    What the outline of moving meshes says of them, ``rendering.border`` adds (``attached``).

    ``field``: of ``Views``, where they lie; ``each``: how many a view has.
    """

    field: ClassVar[str]
    each: ClassVar[int]
    carried = False

    def _lie(self, views: Views, table: np.ndarray, sizes: np.ndarray) -> None:
        """``table (V, each)``: which entry of the unknown each number of a view is, -1 for none;
        ``sizes (V, each)``: what a pixel is of it."""
        self._views, self._type, self.unit = views, mi.TensorXf, "pixels"
        self._table, self._sizes = self._of_views(table, sizes)
        setattr(views, self.field, dr.zeros(mi.Float, table.size))
        dr.make_opaque(getattr(views, self.field))

    @staticmethod
    def _of_views(table: np.ndarray, sizes: np.ndarray) -> tuple[mi.Int, mi.Float]:
        entries = own(mi.Int, np.ascontiguousarray(table, np.int32).ravel())
        return entries, own(mi.Float, np.ascontiguousarray(sizes, np.float32).ravel())

    def write(self, leaf, written: dict) -> None:
        self._put(self._views, self._table, self._sizes, dr.detach(leaf).array)

    def _put(self, views: Views, table: mi.Int, sizes: mi.Float, pixels: mi.Float) -> None:
        found = _placed(table, sizes, pixels)
        dr.eval(found)
        setattr(views, self.field, found)

    def attached(self, leaf: mi.TensorXf) -> mi.Float:
        """What ``views`` has of it, with derivatives by ``leaf``, for what knows how a camera
        projects."""
        return _placed(self._table, self._sizes, leaf.array)

    def jitter(self, seed: list[int]) -> mi.Float:
        """Random offsets of each view's numbers, ``(V each,)`` pixels, Gaussian of ``WIDTH``."""
        drawn = np.random.default_rng(seed).normal(0, WIDTH, dr.width(self._table))
        return dr.select(self._table >= 0, like(mi.Float, drawn.astype(np.float32)), 0)

    def offsets(self, seed: list[int]) -> "tuple[mi.Float, mi.Float, mi.Int]":
        """``jitter``, the same as ``Views`` has it, and which entry each is of. Evaluates."""
        found = self.jitter(seed)
        placed = found * self._sizes
        dr.eval(found, placed)
        return found, placed, self._table


def _placed(table: mi.Int, sizes: mi.Float, pixels: mi.Float) -> mi.Float:
    return dr.gather(mi.Float, pixels, mi.UInt32(dr.maximum(table, 0)), table >= 0) * sizes


def unknown(unknowns) -> list:
    """Those of ``unknowns`` that are numbers of cameras, in their order."""
    return [each for each in unknowns if isinstance(each.kind, OfCameras)]


def add(leaf: mi.TensorXf, view: mi.UInt32, each: int, slope: mi.Float, offset, table) -> None:
    """Add Σ_i ``slope``_i δ/σ² to the gradient of ``leaf``, where δ is the offset (``jitter``) of
    the i-th path's view, ``each`` numbers, and ``slope (N,)`` ∂ℒ/∂I times half the difference of
    its radiance at +δ and -δ: the derivative of images blurred by a Gaussian of width σ (PRDPT
    Eq. 8), without bias. ``table``: see ``OfCameras``. Traced."""
    with dr.resume_grad():
        total = mi.Float(0)
        for number in range(each):
            entry = dr.gather(mi.Int, table, view * each + number)
            δ = dr.gather(mi.Float, dr.detach(offset), view * each + number) / WIDTH**2
            free = entry >= 0
            at = dr.gather(mi.Float, leaf.array, mi.UInt32(dr.maximum(entry, 0)), free)
            total += at * (slope * δ)
        if dr.grad_enabled(total):
            dr.backward(dr.sum(total))
