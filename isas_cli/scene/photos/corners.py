"""Corners of a chessboard, found in a photograph near where they should be."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates, sobel

_ROUNDS = 20
_CLOSE = 0.01  # pixels
_WIDEST = 8  # pixels from a corner
# A window whose gradients all point one way has no corner.
_FLATTEST = 1e-3


def found(image: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of guesses ``near (P, 2)``, pixels from the corner of ``image (H, W)``: the numbers of those
    at which there is a corner, and where, ``(K,)`` and ``(K, 2)``.

    A corner q is where all gradients nearby are at right angles to the way there: it solves
    Σ w ∇I ∇Iᵀ (q - p) = 0 over the pixels p of a window, again and again as the window moves there
    (Förstner & Gülch 1987). Guesses that move out of their window have no corner.
    """
    down, right = (sobel(image.astype(np.float64), axis=axis) for axis in (0, 1))
    apart = np.linalg.norm(near[:, None] - near[None], axis=2) + 1e9 * np.eye(len(near))
    numbers, places = [], []
    for number, guess in enumerate(near):
        radius = int(np.clip(0.35 * apart[number].min(), 2, _WIDEST))
        place = _moved(right, down, guess, radius)
        if place is not None:
            numbers.append(number)
            places.append(place)
    return np.array(numbers, int), np.array(places).reshape(-1, 2)


def _moved(right: np.ndarray, down: np.ndarray, guess: np.ndarray, radius: int):
    """Where the corner is, or None."""
    offset = np.arange(-radius, radius + 1, dtype=np.float64)
    weight = np.exp(-((offset / radius) ** 2))
    weight = np.outer(weight, weight)
    place = guess.astype(np.float64)
    height, width = right.shape
    for _ in range(_ROUNDS):
        if not (radius < place[0] < width - radius and radius < place[1] < height - radius):
            return None
        x, y = np.meshgrid(place[0] + offset, place[1] + offset)
        at = [y - 0.5, x - 0.5]  # from the picture's corner to middles of pixels
        gx, gy = (map_coordinates(slope, at, order=1) for slope in (right, down))
        a, b, c = ((weight * u * v).sum() for u, v in ((gx, gx), (gx, gy), (gy, gy)))
        gram = np.array([[a, b], [b, c]])
        if not np.linalg.det(gram) > _FLATTEST * np.trace(gram) ** 2:
            return None
        pull = [
            (weight * gx * (gx * x + gy * y)).sum(),
            (weight * gy * (gx * x + gy * y)).sum(),
        ]
        before, place = place, np.linalg.solve(gram, pull)
        if np.abs(place - guess).max() > radius:
            return None
        if np.abs(place - before).max() < _CLOSE:
            return place
    return place
