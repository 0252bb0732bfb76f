"""Lenses: in what the cameras of photographs are otherwise than their file says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene.views import CENTRE_X, CENTRE_Y, FOCAL, RADIAL, Glass, Views
from .cameras import OfCameras
from .kind import Loaded
from .parameters import own

# The farthest that one moves the picture's margin, as a share of the picture's half width.
_FARTHEST = 0.5


class Lens(OfCameras):
    """Focal length, principal point and radial distortion of each lens, as far as they are unknown,
    ``(lenses, 1 to 4)``, in pixels by which they move the middle of a picture's side.

    With the file's focal length f (pixels) and principal point c, a point at p on the plane at
    distance 1 before the camera is seen at c + f m + f (1 + a) p (1 + k |p|²): a, m and k are what
    is unknown. Distortion comes on top of what the file says, which import has taken out.
    """

    name = "camera lens"
    field, each = "lens", 4
    outlined = True

    @classmethod
    def keys(cls, loaded: Loaded) -> list[str]:
        return ["lens"] if loaded.glass is not None else []

    def __init__(self, key: str, loaded: Loaded):
        self.key, self.writes = key, []
        self.glass = loaded.glass.of_views(0, loaded.views.count)
        self._held: list[tuple] = []
        self.present = np.zeros((len(self.glass.names), len(self.glass.columns)), np.float32)
        most = _FARTHEST * float(self.glass.width.min()) / 2
        self.range = (-most, most)
        self._lie(loaded.views, self.glass.table, self.glass.sizes)
        loaded.views.look(self.glass.axes)

    def follow(self, views: Views, glass: Glass) -> None:
        """Let other views through the same lenses follow, those that are held out."""
        views.look(glass.axes)
        views.lens = dr.opaque(mi.Float, 0, glass.table.size)
        self._held.append((views, *self._of_views(glass.table, glass.sizes)))

    def write(self, leaf, written: dict) -> None:
        super().write(leaf, written)
        for held in self._held:
            self._put(*held, dr.detach(leaf).array)

    def told(self, array: np.ndarray) -> dict[str, dict[str, float]]:
        """By lens, what of it is unknown, in units of its file: pixels, and k."""
        found: dict[str, dict[str, float]] = {}
        for number, name in enumerate(self.glass.names):
            view = int(np.argmax(self.glass.of == number))
            values = np.zeros(4)
            values[self.glass.columns] = array[number] * self.glass.sizes[view, self.glass.columns]
            focal = float(self.glass.focal[view])
            said = {"focal": focal * (1 + values[FOCAL])} if "focal" in self.glass.parts else {}
            if "centre" in self.glass.parts:
                said |= {"centre_x": focal * values[CENTRE_X], "centre_y": focal * values[CENTRE_Y]}
            if "radial" in self.glass.parts:
                said["radial"] = values[RADIAL]
            found[name] = {key: float(value) for key, value in said.items()}
        return found

    def numbers(self, array: np.ndarray, truth: np.ndarray | None) -> dict[str, float]:
        if len(self.glass.names) > 1:
            return {"farthest": float(np.abs(array).max())}
        (said,) = self.told(array).values()
        return said


@dataclass(frozen=True)
class Together:
    """That an object's ``size``, in doublings, is stepped with the focal lengths of ``lens``: as
    much larger as these are shorter, so that it stays as large in the pictures.

    Size and focal length do nearly the same to pictures, and only perspective tells them apart.
    Along each by itself, steps would hardly get on along that valley. With s = s' - log₂ f, f the
    mean of focal lengths over those of the file, f alone is what perspective tells:

        dℒ/df = ∂ℒ/∂f - ∂ℒ/∂s / (f ln 2),    Δs = Δs' - Δ log₂ f.
    """

    lens: str
    size: str
    glass: Glass

    @cached_property
    def _shares(self) -> mi.Float:
        """What a unit of each entry of the lens adds to f: 0 but for focal lengths."""
        count, columns = len(self.glass.names), self.glass.columns
        first = [int(np.argmax(self.glass.of == number)) for number in range(count)]
        found = np.zeros((count, len(columns)), np.float32)
        found[:, columns.index(FOCAL)] = self.glass.sizes[first, FOCAL] / count
        return own(mi.Float, found.ravel())

    def _longer(self, lens: mi.TensorXf) -> mi.Float:
        """f."""
        return 1 + dr.sum(dr.detach(lens).array * self._shares)

    def directed(self, gradients: dict, values: dict) -> dict:
        """``gradients`` by these, where the lens takes the size with it. Traced."""
        lens, along = gradients[self.lens], self._shares / self._longer(values[self.lens])
        found = lens.array - along * gradients[self.size] / math.log(2)
        return gradients | {self.lens: mi.TensorXf(found, lens.shape)}

    def follow(self, before: mi.TensorXf, after: mi.TensorXf, size: mi.Float) -> mi.Float:
        """``size`` after a step of the lens from ``before`` to ``after``. Traced."""
        return size - dr.log2(self._longer(after) / self._longer(before))
