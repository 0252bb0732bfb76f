"""Two kinds of unknown that the program does not have, as somebody else would add them."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from isas_cli.unknowns.kind import Kind, Loaded
from isas_cli.unknowns.parameters import as_numpy, is_grid, like

DECIBELS = 10 / np.log(10)


class LogGrid(Kind):
    """The logarithm of a volume's grid, ``(Z, Y, X, channels)``, which can be no negative value."""

    name = "logarithm of a grid"
    axes = ((0, False), (1, False), (2, False))

    @classmethod
    def keys(cls, loaded: Loaded) -> list[str]:
        grids = (key for key in loaded.params.keys() if is_grid(loaded.params, key))
        return [f"{key.removesuffix('.data')}.log" for key in grids]

    def __init__(self, key: str, loaded: Loaded):
        self.key, self.writes = key, [f"{key.removesuffix('.log')}.data"]
        self.present = np.log(as_numpy(loaded.params[self.writes[0]]))
        self.range, self.unit = (-np.inf, 0.0), "dB"

    def value(self, array: np.ndarray) -> mi.TensorXf:
        return like(mi.TensorXf, array)

    def write(self, leaf: mi.TensorXf, written: dict) -> None:
        written[self.writes[0]] = dr.exp(leaf)

    def refusal(self, array: np.ndarray) -> str | None:
        return "spans more than 20 dB" if DECIBELS * np.ptp(array) > 20 else None

    def error(self, array: np.ndarray, truth: np.ndarray, seen: np.ndarray) -> float:
        return DECIBELS * super().error(array, truth, seen)

    def pictures(self, array: np.ndarray) -> dict[str, np.ndarray]:
        return {f"slice{z}": np.exp(layer) for z, layer in enumerate(array)}


class Swelling(Kind):
    """How far each vertex of a mesh stands out along its normal, ``(V,)``."""

    name = "swelling"
    moves_geometry = True
    unit = "scene units"
    range = -np.inf, np.inf

    @classmethod
    def keys(cls, loaded: Loaded) -> list[str]:
        ends = ".vertex_normals"
        return [
            f"{key.removesuffix(ends)}.swelling"
            for key in loaded.params.keys()
            if key.endswith(ends) and dr.width(loaded.params[key])
        ]

    def __init__(self, key: str, loaded: Loaded):
        mesh = key.removesuffix(".swelling")
        self.key, self.writes = key, [f"{mesh}.vertex_positions"]
        values = (loaded.params[f"{mesh}.vertex_{name}"] for name in ("positions", "normals"))
        self._rest, self._normals = (mi.Float(as_numpy(value)) for value in values)
        self.present = np.zeros(dr.width(self._rest) // 3, np.float32)

    def value(self, array: np.ndarray) -> mi.Float:
        return like(mi.Float, array)

    def write(self, leaf: mi.Float, written: dict) -> None:
        written[self.writes[0]] = self._rest + self._normals * dr.repeat(leaf, 3)

    def pictures(self, array: np.ndarray) -> dict[str, np.ndarray]:
        return {"": array.reshape(1, -1, 1)}
