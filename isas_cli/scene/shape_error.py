"""How far one surface is from another."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

# Points on each surface; by so many of the other's and of its triangles' middles a point's nearest
# triangle is looked for: of more triangles than points most have no point, and of fewer the points
# nearest may all lie on one.
_POINTS, _NEAR = 20_000, 3
# Points of the box around both that tell how much of their insides they share.
_WITHIN = 5_000
MEASURES = ("chamfer", "normals", "hausdorff", "volume", "overlap")


@dataclass(frozen=True)
class Sampled:
    """A surface: ``corners (F, 3, 3)`` of its triangles, and points spread evenly over it,
    ``points (N, 3)`` on the triangles ``on (N,)``."""

    corners: np.ndarray
    points: np.ndarray
    on: np.ndarray

    @staticmethod
    def of(positions: np.ndarray, faces: np.ndarray, seed: int = 1) -> "Sampled":
        """``positions (V, 3)``, finite; ``faces (F, 3)``."""
        rng = np.random.default_rng(seed)
        corners = positions.astype(np.float64)[faces]
        steps = np.cumsum(np.linalg.norm(_across(corners), axis=1))
        goals = (np.arange(_POINTS) + rng.random(_POINTS)) / _POINTS * steps[-1]
        on = np.minimum(np.searchsorted(steps, goals), len(faces) - 1)
        root, other = np.sqrt(rng.random(_POINTS))[:, None], rng.random(_POINTS)[:, None]
        a, b, c = np.moveaxis(corners[on], 1, 0)
        return Sampled(corners, (1 - root) * a + root * (1 - other) * b + root * other * c, on)

    @cached_property
    def normals(self) -> np.ndarray:
        """Of the triangles, ``(F, 3)``; 0 for one without area."""
        across = _across(self.corners)
        return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)

    @cached_property
    def _trees(self) -> tuple[cKDTree, cKDTree]:
        return cKDTree(self.points), cKDTree(self.corners.mean(axis=1))

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Which ``points (N, 3)`` lie behind the triangle next to them, bool: within, where the
        surface is closed and not folded."""
        _, faces = self.nearest(points)
        offset = points - self.corners[faces, 0]
        return np.einsum("ij,ij->i", offset, self.normals[faces]) < 0

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances of ``points (N, 3)`` from the surface and the triangle next to each, of those
        that the nearest few of its sampled points and of its triangles' middles lie on."""
        from trimesh.triangles import closest_point

        on, middles = (tree.query(points, k=[*range(1, _NEAR + 1)])[1] for tree in self._trees)
        middles = np.minimum(middles, len(self.corners) - 1)  # fewer triangles than asked for
        faces = np.concatenate([self.on[on], middles], axis=1)
        repeated = np.repeat(points, faces.shape[1], axis=0)
        closest = closest_point(self.corners[faces.ravel()], repeated)
        distances = np.linalg.norm(closest - repeated, axis=1).reshape(faces.shape)
        best = distances.argmin(axis=1)[:, None]
        return (np.take_along_axis(each, best, axis=1)[:, 0] for each in (distances, faces))


def enclosed(corners: np.ndarray) -> float:
    """The volume within triangles ``(F, 3, 3)``, where they close; negative where inside out."""
    # Around their middle: far from it the rounding of the sum is more than the volume.
    corners = corners.astype(np.float64)
    a, b, c = np.moveaxis(corners - corners.mean(axis=(0, 1)), 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _across(corners: np.ndarray) -> np.ndarray:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def apart(surface: Sampled, truth: Sampled) -> dict[str, float]:
    """``chamfer``: the mean of both mean distances, of each surface's points from the other, in
    scene units; ``normals``: the mean angle between normals there, in degrees; ``hausdorff``: the
    largest of the distances; ``volume``: over the truth's; ``overlap``: what both enclose over what
    any of them does, to a few hundredths."""
    there, on_truth = truth.nearest(surface.points)
    back, on_surface = surface.nearest(truth.points)
    cosines = [
        np.einsum("ij,ij->i", surface.normals[surface.on], truth.normals[on_truth]),
        np.einsum("ij,ij->i", truth.normals[truth.on], surface.normals[on_surface]),
    ]
    angles = [np.degrees(np.arccos(np.clip(each, -1, 1))).mean() for each in cosines]
    chamfer, farthest = (there.mean() + back.mean()) / 2, max(there.max(), back.max())
    volume, true = enclosed(surface.corners), enclosed(truth.corners)
    volume = volume / true if true else float("nan")
    corners = np.concatenate([surface.corners, truth.corners]).reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    points = low + (high - low) * np.random.default_rng(3).random((_WITHIN, 3))
    one, other = surface.inside(points), truth.inside(points)
    overlap = np.sum(one & other) / max(1, np.sum(one | other))
    found = chamfer, np.mean(angles), farthest, volume, overlap
    return dict(zip(MEASURES, map(float, found)))
