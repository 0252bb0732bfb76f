"""The loss along one unknown number, or over two, hard and blurred (as PRDPT's Fig. 2)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..rendering.renderer import Renderer
from ..runtime import streams
from ..runtime.errors import InputError
from ..scene.problem import Problem
from ..unknowns.blur import Blur

# Pixels of all points together: 24 bytes each, and as much again while they are blurred.
_MOST = 1 << 25
_USUAL = {1: 321, 2: 49}  # points of an axis, by the number of axes
_LEAST = 17  # of these a quarter is shown at least


@dataclass(frozen=True)
class Landscape:
    """``axes``: one or two increasing arrays of values; ``hard``: ℒ there, of their lengths;
    ``blurred``: the same after the blur of each of ``widths`` (σ of each axis)."""

    names: list[str]
    axes: list[np.ndarray]
    hard: np.ndarray
    widths: list[tuple[float, ...]]
    blurred: list[np.ndarray]

    def within(self, bounds: list[tuple[float, float]]) -> "Landscape":
        """The part between ``bounds``, (low, high) of each axis."""
        kept = [np.flatnonzero((a >= b[0]) & (a <= b[1])) for a, b in zip(self.axes, bounds)]
        axes = [axis[k] for axis, k in zip(self.axes, kept)]
        hard, *blurred = (values[np.ix_(*kept)] for values in (self.hard, *self.blurred))
        return Landscape(self.names, axes, hard, self.widths, blurred)


def points(problem: Problem, axes: int) -> int:
    """How many points of each of ``axes`` axes there are to be: all images are held at once.
    Raises InputError where only few would fit memory."""
    found = min(_USUAL[axes], math.floor((_MOST / problem.views.total) ** (1 / axes)))
    if found < _LEAST:
        raise InputError(
            f"{problem.views.total} pixels of all views are too many to hold the images of "
            f"{_LEAST**axes} points in memory: take a run of a smaller size"
        )
    return found


def measure(
    problem: Problem,
    loss,
    at: np.ndarray,
    entries: list[int],
    names: list[str],
    axes: list[np.ndarray],
    widths: list[tuple[float, ...]],
    smooth: str,
    spp: int,
    seed: int,
    done: Callable[[int, int], None] = lambda finished, total: None,
) -> Landscape:
    """Render all pixels at every point of the grid and blur what comes out.

    ``at (D,)``: where the other unknowns stay; ``entries``: which of the D the axes are; ``spp``
    paths a pixel in each of two independent halves, the same random numbers at every point, from
    the seed ``seed``.
    ``smooth``: "image", ℒ(κ ⋆ P), or "loss", κ ⋆ ℒ(P), as ``estimators.plateau`` has it, but over
    the given axes alone. κ is cut off at the ends of the axes and scaled to 1 again there: what is
    shown should end three σ before them (``Landscape.within``).
    """
    blur, renderer = Blur(problem, "isas landscape"), Renderer(problem)
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    halves = np.empty((2, len(places), problem.views.total, 3), np.float32)
    first: dict[bytes, int] = {}  # beyond an unknown's range all images are those of its end
    for number, place in enumerate(places):
        θ = at.copy()
        θ[entries] = place
        same = first.setdefault(blur.ends(θ).tobytes(), number)
        if same == number:
            blur.write(θ)
            for half in (0, 1):
                seeds = lambda part: streams.seed(seed, 2 * part + half, "evaluation")
                halves[half, number] = renderer.range(0, problem.views.total, spp, seeds)
        else:
            halves[:, number] = halves[:, same]
        done(number + 1, len(places))
    shape = tuple(len(axis) for axis in axes)
    hard = _losses(problem, loss, *halves).reshape(shape)
    blurred = []
    for σ in widths:
        kernels = [_kernel(axis, width) for axis, width in zip(axes, σ)]
        if smooth == "loss":
            blurred.append(_along(hard, kernels))
            continue
        images = (_along(half.reshape(*shape, -1), kernels) for half in halves)
        smoothed = [image.reshape(halves.shape[1:]) for image in images]
        blurred.append(_losses(problem, loss, *smoothed).reshape(shape))
    return Landscape(names, axes, hard, widths, blurred)


def _losses(problem: Problem, loss, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """ℒ of every point from two halves, ``(points,)``."""
    target = mi.Color3f(dr.unravel(mi.Color3f, problem.targets))
    weight = mi.Float(1) if problem.mask is None else problem.mask
    found = []
    for pair in zip(a, b):
        first, second = (mi.Color3f(np.ascontiguousarray(image.T)) for image in pair)
        values = dr.sum(loss.measured(first, second, target)) * weight * problem.share
        found.append(float(dr.sum(values)[0]))
    return np.array(found)


def _kernel(axis: np.ndarray, σ: float) -> np.ndarray:
    """Gaussian weights of all points for each point of ``axis``, ``(n, n)``, rows sum to 1."""
    weights = np.exp(-0.5 * ((axis[:, None] - axis) / σ) ** 2)
    return weights / weights.sum(axis=1, keepdims=True)


def _along(values: np.ndarray, kernels: list[np.ndarray]) -> np.ndarray:
    for number, kernel in enumerate(kernels):
        kernel = kernel.astype(values.dtype)  # images in half the memory
        values = np.moveaxis(np.tensordot(kernel, values, axes=(1, number)), 0, number)
    return values
