"""Solid noise: a smooth random value at each point of space, the same on every machine."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

_LATTICE = 32


def solid_noise(points: np.ndarray, frequency: float, seed: int) -> np.ndarray:
    """Value noise in [0, 1] at `points` (N, 3); about `frequency` blobs per unit of length.

    Returns (N,) float32. Random values on a lattice, which repeats after 32 cells, are
    interpolated with weights that are flat at the lattice points.
    """
    lattice = np.random.default_rng(seed).random((_LATTICE,) * 3, dtype=np.float32)
    scaled = points.T.astype(np.float32) * np.float32(frequency) + np.float32(0.37)
    cell = np.floor(scaled)
    inside = scaled - cell
    eased = cell + inside * inside * (3 - 2 * inside)
    return ndimage.map_coordinates(lattice, eased, order=1, mode="grid-wrap")


def fractal_noise(points: np.ndarray, frequency: float, octaves: int, seed: int) -> np.ndarray:
    """Sum of `octaves` noises, each twice as fine and half as strong; (N,) float32 in [0, 1]."""
    total = np.zeros(len(points), dtype=np.float32)
    for octave in range(octaves):
        total += 0.5**octave * solid_noise(points, frequency * 2**octave, seed + octave)
    return total / (2 - 0.5 ** (octaves - 1))
