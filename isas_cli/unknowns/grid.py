"""The grids of volumes: densities, albedos, emission."""

from __future__ import annotations

import tempfile
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.errors import InputError
from ..scene.file_checks import check_volume, write_bounds
from .kind import Kind, Loaded
from .parameters import is_differentiable, is_grid, owner
from .ranges import fed, glows

# Of a density, as paths cost by their collisions.
_DENSEST = 1e4
# Points a side of what is turned before a reader.
_SHOWN = 64
# At the ends of its range a path's weight has no derivative, or none but it.
_ALBEDO = (0.01, 0.99)


class Grid(Kind):
    """The points of a grid, ``(Z, Y, X, channels)``, between which a volume is interpolated.

    A coarser version has half as many along each side, rounded up: each the mean over its part of
    the whole. It stands for what is interpolated between them at the whole grid's points, by which
    the scene always has the whole one. Constants survive both ways, and so do means, on the way
    back where sides are multiples.
    """

    name = "grid"
    hides = True
    axes = ((0, False), (1, False), (2, False))

    @classmethod
    def matches(cls, params: mi.SceneParameters, key: str) -> bool:
        return is_grid(params, key) and is_differentiable(params, key)

    def __init__(self, key: str, loaded: Loaded):
        super().__init__(key, loaded)
        self.colours = bool(self.role)
        box = owner(loaded.params, key).bbox()
        ends = (np.array(end, float).ravel() for end in (box.min, box.max))
        self._box = tuple(np.concatenate([*ends]).tolist())
        if "albedo" in self.words:
            # Which are off the ends by themselves.
            low, high = _ALBEDO
            self.range = (0.0 if glows(loaded.params) else low, high)
            self.unit, self.bare = "albedo", (0.0, 0.0)
        elif "sigma_t" in self.words:
            ends = fed(loaded.params, key)
            factor = next(factor for _, word, factor in ends if word == "sigma_t")
            self.range = (0.0, _DENSEST / factor)
        # Down to two points along the longest side.
        self.doublings = max(0, (max(self.present.shape[:3]) - 1).bit_length() - 1)

    def shape(self, doublings: int) -> tuple[int, ...]:
        *sides, channels = self.present.shape
        return (*(-(-side >> doublings) for side in sides), channels)

    def coarse(self, array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        found = array.astype(np.float64)
        for axis, side in enumerate(shape[:3]):
            if side != array.shape[axis]:
                means = _means(array.shape[axis], side)
                found = np.moveaxis(np.tensordot(means, found, (1, axis)), 0, axis)
        return found.astype(np.float32)

    def fine(self, leaf: mi.TensorXf, shape: tuple[int, ...]) -> mi.TensorXf:
        if tuple(leaf.shape) == tuple(shape):
            return leaf
        return dr.resample(leaf, shape, filter="linear", boundary="nearest")

    def write(self, leaf: mi.TensorXf, written: dict) -> None:
        written[self.key] = self.fine(leaf, self.present.shape)

    def start(self, spec: str, where: str) -> np.ndarray:
        """A ``.npy`` or ``.vol`` file."""
        path = Path(spec)
        if path.suffix == ".vdb":
            raise InputError(
                f"{where}={spec}: OpenVDB has no package that pip installs: fill an array a by "
                "openvdb's copyToArray in Blender's Python, and write it in Mitsuba's order, z "
                "first: np.save(f, a.transpose(2, 1, 0))"
            )
        if path.suffix not in (".npy", ".vol") or not path.is_file():
            raise InputError(f"{where}={spec}: a .npy or .vol file that exists")
        try:
            if path.suffix == ".npy":
                found = np.load(path, allow_pickle=False)
            else:
                check_volume(path, f"{where}={spec}")
                found = np.array(mi.VolumeGrid(str(path)))
        except InputError:
            raise
        except Exception as error:  # whatever their readers meet
            raise InputError(f"{where}={spec}: {' '.join(str(error).split())}") from error
        found = np.asarray(found)
        found = found[..., None] if found.ndim == 3 else found
        if found.shape != self.present.shape or found.dtype.kind not in "fiu":
            raise InputError(
                f"{where}: {spec} is {found.shape} of {found.dtype}, the grid {self.present.shape}"
            )
        return found.astype(np.float32)

    def files(self, array: np.ndarray) -> dict[str, bytes]:
        """Mitsuba's own format, with the box around the grid in the world: by ``use_grid_bbox`` and
        no ``to_world`` Mitsuba puts it there, but does not turn it."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "grid.vol"
            mi.VolumeGrid(array).write(str(path))
            write_bounds(path, self._box)
            return {"vol": path.read_bytes()}

    def volume(self, array: np.ndarray) -> "np.ndarray | None":
        if array.shape[3] > 1:
            return None
        doublings = next(n for n in range(32) if max(self.shape(n)[:3]) <= _SHOWN)
        return self.coarse(array, self.shape(doublings))[..., 0]

    def pictures(self, array: np.ndarray) -> dict[str, np.ndarray]:
        """The slice through the middle, and the largest values along z; y is up."""
        if array.shape[3] not in (1, 3):
            return {}
        middle = array[array.shape[0] // 2]
        return {"slice": middle[::-1], "largest": array.max(axis=0)[::-1]}


def _means(many: int, few: int) -> np.ndarray:
    """``(few, many)``: of ``many`` equal parts of a line, the mean over each of ``few``."""
    ends = np.arange(many + 1) / many * few
    parts = np.arange(few)[:, None]
    return np.diff(np.clip(ends, parts, parts + 1), axis=1)
