"""Gradients smoothed over neighbouring entries: PBDR's gradient smoothing, for maps and grids.

The paper names it and prints no formula. Ours is a Gaussian along each axis on which neighbours are
alike, reflected at open ends, around where the map closes on itself. It is symmetric, so what it
makes of a gradient still points downhill, and it changes no place where the gradient is zero. Not
to be confused with blurred parameters (`sampler=plateau`), which change the objective.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi

# Narrower than this many entries, neighbours have no weight to speak of.
_NARROW = 0.25


def smoothed(
    gradient: mi.TensorXf, axes: tuple[tuple[int, bool], ...], widest: float, share: float
) -> mi.TensorXf:
    """``gradient`` convolved along ``axes`` (``Kind.axes``) with a standard deviation of
    ``widest * share`` sides of the array; below 0.25. Traced: one kernel for all shares."""
    for axis, wraps in axes:
        entries = widest * gradient.shape[axis]
        if entries < _NARROW:
            continue
        radius, σ = math.ceil(3 * entries), max(entries * share, 1e-3)
        weights = [math.exp(-0.5 * (k / σ) ** 2) for k in range(-radius, radius + 1)]
        total = math.fsum(weights)
        weights = [weight / total for weight in weights]
        boundary = "wrap" if wraps else "reflect"
        # Symbolic: unrolled, the weights would be part of the kernel, and compile at every step.
        gradient = dr.convolve(gradient, weights, axis=axis, boundary=boundary, mode="symbolic")
    return gradient
