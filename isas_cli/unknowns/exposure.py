"""Exposures: by how much each photograph is brighter than the scene says."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .kind import Kind, Loaded
from .parameters import like


class Exposure(Kind):
    """A factor on the radiance of every view, ``(V, 1)``, or on each of its channels, ``(V, 3)``,
    beside what files say (``Views.given``). The first view's stays 1: a factor on all of them is
    one on the light.

    'All others brighter, colours darker' changes the first view's picture alone. Steps along
    ∂ℒ/∂e_v would drift that way while colours are still wrong, and hardly come back. So estimators
    tell the first view's derivative as well, as if it were free, and steps go along

        h_v = ∂ℒ/∂e_v - e_v (N_v / N_0) ∂ℒ/∂e_0,

    N the pixels of a view that count: as if the mean of all exposures were fixed, and all were
    divided by the first after each step. Where a picture is c times what its view should show,
    ∂ℒ/∂e_v is 2 N_v (c e_v - t_v) c for a truth t and views whose scene is as bright: c drops out
    of h, which is 0 at e_v = t_v whatever the colours are. Where colours or light fit, ∂ℒ/∂e_0 is
    0, and h the derivative.

    Where places of the object told what they are (``Loaded.told``), they stay within what that may
    be off: exposures would make up for a surface that glosses otherwise than its model.

    No parameter of the scene: it lies with the views, and every ray's weight holds it
    (``rendering.rays``). Paths do not carry its derivative, so estimators add it (``add``).
    """

    name = "exposure"
    carried = False
    nested = True
    listed = "a list for every view, such as [[1], [1.2]]"

    @classmethod
    def keys(cls, loaded: Loaded) -> list[str]:
        return ["exposure"] if loaded.channels is not None else []

    usual = 0.01, 100.0  # its range: below, a view would tell nothing

    def __init__(self, key: str, loaded: Loaded):
        self.key, self.writes = key, []
        self._views, self._channels = loaded.views, loaded.channels
        self._type = mi.TensorXf
        self.present = np.ones((self._views.count, self._channels), np.float32)
        self._ends = None
        if loaded.told is not None:
            told, near = loaded.told
            self._ends = [self.value(told * factor) for factor in (1 - near, 1 + near)]
        self.range, self.unit = self.usual, "exposure"
        entry = np.arange(self.present.size, dtype=np.uint32).reshape(self.present.shape)
        table = np.broadcast_to(entry, (self._views.count, 3))
        self._entry = mi.UInt32(table.ravel())
        self._views.exposure = dr.opaque(mi.Float, 1, table.size)
        self.compare(np.ones(self._views.count))

    def compare(self, counts: np.ndarray) -> None:
        # Where the first view has none it tells nothing, and all others are as they are told.
        first = float(counts[0])
        share = np.asarray(counts, np.float64) / first if first > 0 else np.zeros(len(counts))
        self._share = like(mi.Float, np.repeat(share, self._channels).astype(np.float32))
        dr.make_opaque(self._share)

    def normal(self, array: np.ndarray) -> np.ndarray:
        return array / array[:1]

    def write(self, leaf, written: dict) -> None:
        self._views.exposure = dr.gather(mi.Float, dr.detach(leaf).array, self._entry)
        dr.eval(self._views.exposure)

    def directed(self, gradient, value):
        g, channels = gradient.array, self._channels
        entry = dr.arange(mi.UInt32, len(g))
        first = dr.gather(mi.Float, g, entry % channels)
        found = g - self._share * first * dr.detach(value).array
        return mi.TensorXf(dr.select(entry < channels, 0, found), gradient.shape)

    def projected(self, leaf):
        return leaf if self._ends is None else dr.clip(leaf, *self._ends)

    def numbers(self, array: np.ndarray, truth: np.ndarray | None) -> dict[str, float]:
        return {"least": float(array.min()), "most": float(array.max())}


def add(leaf: mi.TensorXf, view: mi.UInt32, slope: mi.Color3f) -> None:
    """Add Σ_i ``slope``_i = Σ_i ∂ℒ/∂e of the view that the i-th path belongs to, to the gradient of
    ``leaf``, the exposures e. Traced; ``slope (3, N)``: ∂ℒ/∂I times the radiance before exposure.
    """
    channels = leaf.shape[1]
    first = view * channels
    with dr.resume_grad():
        total = mi.Float(0)
        for channel in range(3):
            entry = first + (channel if channels == 3 else 0)
            total += dr.gather(mi.Float, leaf.array, entry) * slope[channel]
        if dr.grad_enabled(total):
            dr.backward(dr.sum(total))
