"""The loss along one unknown number, or over two, hard and blurred (as PRDPT's Fig. 2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from . import streams
from .errors import InputError
from .estimators.blur import Blur
from .problem import Problem
from .render import Renderer

# Pixels of all points together: 24 bytes each, and as much again while they are blurred.
_MOST = 1 << 26


@dataclass(frozen=True)
class Landscape:
    """``axes``: one or two increasing arrays of values; ``hard``: ℒ there, of their lengths;
    ``blurred``: the same after the blur of each of ``widths`` (σ of each axis)."""

    names: list[str]
    axes: list[np.ndarray]
    hard: np.ndarray
    widths: list[tuple[float, ...]]
    blurred: list[np.ndarray]


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
    base: int,
    done: Callable[[int, int], None] = lambda finished, total: None,
) -> Landscape:
    """Render all pixels at every point of the grid and blur what comes out.

    ``at (D,)``: where the other unknowns stay; ``entries``: which of the D the axes are; ``spp``
    paths a pixel in each of two independent halves, the same random numbers at every point, from
    the seed ``base``.
    ``smooth``: "image", ℒ(κ ⋆ P), or "loss", κ ⋆ ℒ(P), as ``estimators.plateau`` has it, but over
    the given axes alone. κ is cut off at the ends of the axes and scaled to 1 again there.
    """
    blur, renderer = Blur(problem, "isas landscape"), Renderer(problem)
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    if len(points) * problem.views.total > _MOST:
        raise InputError(
            f"{len(points)} points of {problem.views.total} pixels each are more than fit memory: "
            "take a run of a smaller size"
        )
    halves = np.empty((2, len(points), problem.views.total, 3), np.float32)
    for number, point in enumerate(points):
        θ = at.copy()
        θ[entries] = point
        blur.write(θ)
        for half in (0, 1):
            halves[half, number] = renderer.range(
                0,
                problem.views.total,
                spp,
                lambda s, half=half: streams.seed(base, 2 * s + half, "evaluation"),
            )
        done(number + 1, len(points))
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
        values = np.moveaxis(np.tensordot(kernel, values, axes=(1, number)), 0, number)
    return values
