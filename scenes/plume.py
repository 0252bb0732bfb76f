"""A plume of smoke: simulated once, kept as a file of 8-bit densities.

Stable fluids (Stam 1999) in a box of n³ cells without walls, periodic, with buoyancy and vorticity
confinement (Fedkiw et al. 2001): heat and smoke enter at the bottom and rise. Rounding differs
between machines and grows, so the scene reads what one of them found:

    .venv/bin/python -m isas_cli.scenes.plume
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from . import library

FILE = "volumes/plume.npz"
_SIDE, _STEPS, _SEED = 64, 80, 0
_BUOYANCY, _CONFINEMENT, _WIND = 0.12, 0.25, 0.15
_COOLING, _THINNING = 0.985, 0.995
_LEAST = 1e-3  # of the largest density: thinner smoke is none


def density(side: int) -> np.ndarray:
    """``(side, side, side) float32`` as z, y, x with y up, at most 1; ``side`` divides 64."""
    if _SIDE % side:
        raise ValueError(f"the plume has {_SIDE}³ cells, and {side} does not divide that")
    whole = np.load(library.asset(FILE))["density"].astype(np.float32) / 255
    step = _SIDE // side
    return whole.reshape(side, step, side, step, side, step).mean(axis=(1, 3, 5))


def simulate(n: int, steps: int, seed: int) -> np.ndarray:
    """Densities after so many steps, ``(n, n, n)``, at most 1."""
    rng = np.random.default_rng(seed)
    place = np.meshgrid(*[np.arange(n, dtype=float)] * 3, indexing="ij")
    z, y, x = place
    frequencies = [np.fft.fftfreq(n) * 2 * np.pi] * 2 + [np.fft.rfftfreq(n) * 2 * np.pi]
    waves = np.meshgrid(*frequencies, indexing="ij")
    square = sum(each**2 for each in waves)
    square[0, 0, 0] = 1
    spread = ((x - n / 2) / (0.06 * n)) ** 2 + ((z - n / 2) / (0.06 * n)) ** 2
    source = np.exp(-(spread + ((y - 0.1 * n) / (0.04 * n)) ** 2))
    velocity = np.zeros((3, n, n, n))
    smoke, heat = np.zeros((n, n, n)), np.zeros((n, n, n))
    for _ in range(steps):
        angle, strength = rng.uniform(0, 2 * np.pi), 1 + 0.3 * rng.standard_normal()
        smoke += 0.5 * max(strength, 0) * source
        heat += source
        velocity[1] += _BUOYANCY * heat
        velocity[2] += _WIND * np.cos(angle) * source
        velocity[0] += _WIND * np.sin(angle) * source
        velocity += _CONFINEMENT * _confined(velocity)
        velocity = _without_divergence(velocity, waves, square)
        back = [at - by for at, by in zip(place, velocity)]
        *velocity, smoke, heat = (_interpolated(each, back) for each in (*velocity, smoke, heat))
        # Nothing flows through the top.
        velocity = np.stack(velocity) * np.clip((n - 2 - y) / (0.1 * n), 0, 1)
        smoke, heat = smoke * _THINNING, heat * _COOLING
    smoke[smoke < _LEAST * smoke.max()] = 0
    return smoke / smoke.max()


def _slope(field: np.ndarray, axis: int) -> np.ndarray:
    return (np.roll(field, -1, axis) - np.roll(field, 1, axis)) / 2


def _confined(velocity: np.ndarray) -> np.ndarray:
    """Along z, y, x: what gives eddies back that the grid has smoothed away."""
    w, v, u = velocity
    curl = np.stack(
        [_slope(v, 2) - _slope(u, 1), _slope(u, 0) - _slope(w, 2), _slope(w, 1) - _slope(v, 0)]
    )
    size = np.sqrt((curl**2).sum(axis=0))
    towards = np.stack([_slope(size, axis) for axis in range(3)])
    towards /= np.sqrt((towards**2).sum(axis=0)) + 1e-6
    # A cross product, of vectors whose components run backwards.
    return -np.cross(towards, curl, axis=0)


def _without_divergence(velocity: np.ndarray, waves: list, square: np.ndarray) -> np.ndarray:
    spectra = [np.fft.rfftn(each) for each in velocity]
    divergence = sum(k * each for k, each in zip(waves, spectra)) / square
    kept = [a - k * divergence for k, a in zip(waves, spectra)]
    return np.stack([np.fft.irfftn(each, velocity[0].shape, (0, 1, 2)) for each in kept])


def _interpolated(field: np.ndarray, place: list) -> np.ndarray:
    from scipy.ndimage import map_coordinates

    return map_coordinates(field, place, order=1, mode="nearest")


def main() -> None:
    found = np.round(255 * simulate(_SIDE, _STEPS, _SEED)).astype(np.uint8)
    path = Path(library.ASSETS / FILE)
    path.parent.mkdir(exist_ok=True)
    np.savez_compressed(path, density=found)


if __name__ == "__main__":
    main()
