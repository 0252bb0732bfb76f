"""The decoration of the pottery jar, as a function of position: clay, slip, glaze, friezes.

Written for the jar as the pottery scene places it: height 1, standing on y = 0, its handle on
the -x side and its spout on the +x side.
"""

from __future__ import annotations

import numpy as np

from .library import BRIGHTEST, DARKEST
from .noise import fractal_noise, solid_noise

# Handle and spout put the axis of the turned body off the centre of the bounding box.
AXIS_X = 0.094
# Outer radius of the turned body at some heights; what reaches beyond it at the back is handle.
_HEIGHTS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.9, 1.0)
_RADII = (0.300, 0.320, 0.332, 0.361, 0.382, 0.394, 0.384, 0.374, 0.353, 0.330, 0.313, 0.307) + (
    0.315,
    0.337,
    0.345,
)

# Linear albedo.
TERRACOTTA = np.array([0.50, 0.19, 0.085], dtype=np.float32)
UMBER = np.array([0.095, 0.045, 0.03], dtype=np.float32)
CREAM = np.array([0.78, 0.66, 0.46], dtype=np.float32)
INDIGO = np.array([0.035, 0.06, 0.22], dtype=np.float32)
OCHRE = np.array([0.65, 0.36, 0.07], dtype=np.float32)
TEAL = np.array([0.05, 0.30, 0.28], dtype=np.float32)

# One period of the meander; 1 is painted. Rows run from top to bottom.
MEANDER = np.array(
    [
        [1, 1, 1, 1, 1, 1, 1, 1],
        [1, 0, 0, 0, 0, 0, 0, 0],
        [1, 0, 1, 1, 1, 1, 1, 0],
        [1, 0, 1, 0, 0, 0, 1, 0],
        [1, 0, 1, 1, 1, 0, 1, 0],
        [1, 0, 0, 0, 0, 0, 1, 0],
        [1, 1, 1, 1, 1, 1, 1, 0],
    ],
    dtype=np.float32,
)


def paint(positions: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Linear albedo (N, 3) float32 at `positions` (N, 3) with outward `normals` (N, 3)."""
    x, height, z = positions[:, 0] - AXIS_X, positions[:, 1], positions[:, 2]
    radius = np.hypot(x, z)
    around = np.arctan2(z, x) / (2 * np.pi)
    # The brush wanders: the whole decoration is displaced by a slow noise.
    height = height + 0.012 * (fractal_noise(positions, 5, 2, seed=11) - 0.5)
    around = around + 0.006 * (fractal_noise(positions, 6, 2, seed=21) - 0.5)

    colour = _clay(positions, height)
    colour = _friezes(colour, around, height)
    colour = _glaze(colour, positions, around, height)

    body = np.interp(positions[:, 1], _HEIGHTS, _RADII)
    handle = (x < 0) & (np.abs(z) < 0.2) & (radius > body + 0.012) & (positions[:, 1] > 0.3)
    colour[handle] = _striped(height[handle])
    outwards = (normals[:, 0] * x + normals[:, 2] * z) / np.maximum(radius, 1e-6)
    # The rim's upper face belongs to the lining; the foot's underside stays bare clay.
    inwards = (outwards < 0) | (normals[:, 1] > 0.6)
    inside = ~handle & inwards & (positions[:, 1] > 0.02) & ((x > 0) | (radius < body))
    colour[inside] = _lining(positions[inside])

    grain = 0.82 + 0.36 * fractal_noise(positions, 40, 4, seed=31)
    return np.clip(colour * grain[:, None], DARKEST, BRIGHTEST)


def _mix(below: np.ndarray, above: np.ndarray, amount: np.ndarray) -> np.ndarray:
    return below + np.clip(amount, 0, 1)[:, None] * (above - below)


def _step(value: np.ndarray, edge: float | np.ndarray, width: float = 0.004) -> np.ndarray:
    """0 below the edge and 1 above it, with a soft border of `width`."""
    return np.clip((value - edge) / width + 0.5, 0, 1)


def _band(height: np.ndarray, low: float, high: float) -> np.ndarray:
    return _step(height, low) * (1 - _step(height, high))


def _clay(positions: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Fired clay: fire clouds, the throwing rings of the wheel, dark grit."""
    colour = np.broadcast_to(TERRACOTTA, positions.shape).copy()
    colour = _mix(colour, UMBER, 0.7 * _step(fractal_noise(positions, 3, 4, seed=41), 0.58, 0.3))
    colour *= (1 + 0.10 * np.sin(2 * np.pi * height * 55))[:, None]
    return _mix(colour, UMBER, 0.8 * _step(solid_noise(positions, 90, seed=51), 0.86, 0.08))


def _friezes(colour: np.ndarray, around: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Bands around the body: tongues, the meander on cream slip, zigzags."""
    # Tongues that rise from the foot.
    along = np.abs((around * 28) % 1 - 0.5) * 2
    tongue = 0.075 + 0.125 * np.sqrt(np.clip(1 - (along / 0.78) ** 2, 0, 1))
    colour = _mix(colour, CREAM, _band(height, 0.075, 0.235))
    colour = _mix(colour, INDIGO, _band(height, 0.075, 1.0) * (1 - _step(height, tongue)))
    colour = _mix(colour, OCHRE, _band(height, 0.09, 1.0) * (1 - _step(height, tongue - 0.035)))
    # The main frieze.
    colour = _mix(colour, CREAM, _band(height, 0.30, 0.53))
    colour = _mix(colour, INDIGO, _meander(around * 14, (height - 0.335) / 0.16))
    # Zigzags.
    colour = _mix(colour, TEAL, _band(height, 0.585, 0.685))
    wave = 0.635 + 0.034 * (np.abs((around * 36) % 1 - 0.5) * 4 - 1)
    colour = _mix(colour, CREAM, 1 - _step(np.abs(height - wave), 0.010))
    for low, high, line in (
        (0.055, 0.075, UMBER),
        (0.235, 0.250, INDIGO),
        (0.268, 0.276, CREAM),
        (0.290, 0.305, UMBER),
        (0.525, 0.540, UMBER),
        (0.553, 0.561, CREAM),
        (0.575, 0.588, INDIGO),
        (0.682, 0.695, INDIGO),
    ):
        colour = _mix(colour, line, _band(height, low, high))
    return colour


def _meander(column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Coverage by the meander; `column` counts periods, `row` runs from 0 (foot) to 1 (top)."""
    rows, columns = MEANDER.shape
    # Four sub-cells a cell, blended: straight strokes with slightly soft borders.
    fine = np.kron(MEANDER, np.ones((4, 4), dtype=np.float32))
    fine = np.pad(fine, ((1, 1), (0, 0)))
    i = np.clip((1 - row) * rows * 4 + 0.5, 0, rows * 4 + 1)
    j = (column % 1) * columns * 4 - 0.5
    i0, j0 = np.floor(i).astype(int), np.floor(j).astype(int)
    a, b = i - i0, j - j0
    i1, j1 = np.minimum(i0 + 1, rows * 4 + 1), (j0 + 1) % (columns * 4)
    upper = fine[i0, j0] * (1 - b) + fine[i0, j1] * b
    lower = fine[i1, j0] * (1 - b) + fine[i1, j1] * b
    return upper * (1 - a) + lower * a


def _glaze(
    colour: np.ndarray, positions: np.ndarray, around: np.ndarray, height: np.ndarray
) -> np.ndarray:
    """Dark glaze over neck and rim, run down in drips, with a row of dots."""
    drip = 0.5 + 0.5 * np.cos(2 * np.pi * around * 17 + 5 * solid_noise(positions, 3, seed=61))
    edge = 0.80 - 0.075 * drip**3
    shade = INDIGO * (0.8 + 1.6 * fractal_noise(positions, 7, 3, seed=71)[:, None])
    colour = _mix(colour, OCHRE, _step(height, edge - 0.012))
    colour = _mix(colour, shade, _step(height, edge))
    dots = np.hypot(((around * 40) % 1 - 0.5) / 40 * 2 * np.pi * 0.345, height - 0.865)
    colour = _mix(colour, CREAM, 1 - _step(dots, 0.014))
    return _mix(colour, OCHRE, _band(height, 0.905, 0.92))


def _striped(height: np.ndarray) -> np.ndarray:
    """The handle: cream stripes on indigo."""
    stripe = np.abs((height * 22) % 1 - 0.5) * 2
    base = np.broadcast_to(INDIGO, (len(height), 3))
    return _mix(base, CREAM, _step(stripe, 0.55, 0.15))


def _lining(positions: np.ndarray) -> np.ndarray:
    """The inside: a pale teal glaze that pooled unevenly."""
    pooled = _step(fractal_noise(positions, 5, 4, seed=81), 0.5, 0.4)
    base = np.broadcast_to(TEAL, positions.shape)
    return _mix(base, CREAM, 0.35 + 0.4 * pooled)
