"""Where a run fits the noise of its targets: the errors that a perfect fit would be left with.

A fit of p numbers to targets with noise takes a part of the noise for truth. To first order it is
the noise's projection on what the numbers can do to the images: of N pixel channels, p σ² / N of
the images' mean squared error, σ² the targets' variance where the numbers show, and no more than
there is of it in those pixels. Of the numbers themselves it is what that error comes to by the
images' sensitivity, which is measured: all numbers of an unknown are moved a little from the truth,
each up or down at random, and the images' error is set against theirs. Neighbours that the images
hardly tell apart have more.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import mitsuba as mi
import numpy as np

from ..rendering.stratified import noise
from ..runtime import streams
from ..runtime.errors import InputError

if TYPE_CHECKING:
    from ..scene.problem import Problem

STOPS = "budget.converged=true stops a run at its targets' noise"
# How far numbers are moved, of their own size, at most of their range.
_MOVED = 0.05
# A pixel shows an unknown by this share of a usual one's product, at least.
_FAINT = 0.05


@dataclass(frozen=True)
class Floor:
    """``noise``: the targets' (``rendering.stratified.noise``); ``pixel_rms``: the same in units of
    radiance, all pixels together; what a perfect fit is left with: ``image_rmse``, and by unknown
    ``parameter_rmse``, in its own unit."""

    noise: float
    pixel_rms: float
    image_rmse: float
    parameter_rmse: dict[str, float]

    @property
    def record(self) -> dict:
        return asdict(self)


def check(problem: "Problem", weights) -> None:
    """Raises InputError where the targets' noise, at which ``budget.converged`` stops, will not be
    known, as far as that can be told before there are targets. ``weights``: ``scene.weights``."""
    moving = [u.key for u in problem.unknowns if u.kind.moves_geometry]
    if not problem.truth_known:
        raise InputError(f"{STOPS}, and how noisy given images are is not known: leave it out")
    if moving:
        raise InputError(
            f"{STOPS}, and what that leaves of '{moving[0]}', which moves objects, is not known: "
            "leave it out"
        )
    if weights is not None:
        raise InputError(
            f"{STOPS}, and what that leaves is not known where views have weights: leave out "
            "scene.weights, or this"
        )


def measure(problem: "Problem", pixels: mi.UInt32, products: Callable, seed: int) -> Floor | None:
    """Of a problem, by an evaluator's ``pixels`` and ``products``; None where the targets' noise or
    the truth is not known, where something moves, where pixels have weights, or where no image
    shows the unknowns. Renders."""
    variance, unknowns = problem.variance, problem.unknowns
    if variance is None or not np.all(np.isfinite(variance)) or not problem.truth_known:
        return None
    if problem.mask is not None:
        return None
    if any(u.kind.moves_geometry for u in unknowns):
        return None
    truths = {u.key: u.truth for u in unknowns}
    here, squares, errors = variance[np.array(pixels)], {}, {}
    channels = 3 * problem.views.total
    for number, u in enumerate(unknowns):
        rng = np.random.default_rng(streams.seed(seed, 1 + number, "evaluation_place"))
        moved = _moved(u, rng)
        shown = products(unknowns.values_of(truths | {u.key: moved}))
        image, error = float(shown.mean()), u.error(moved)
        if not (image > 0 and error > 0):
            continue
        # The part of the variance where the unknown shows; single products are noisy.
        weights = np.maximum(shown, 0)
        local = float((weights * here).sum() / weights.sum())
        size = np.abs(shown)
        usual = np.median(size[size > 0])  # a single bright path is no measure
        shows = float(np.mean(size > _FAINT * usual))
        squares[u.key] = local * min(int(np.sum(u.seen)) / channels, shows)
        errors[u.key] = error * math.sqrt(squares[u.key] / image)
    if not squares:
        return None
    whole = float(np.mean(variance, dtype=np.float64))
    images = np.array(problem.targets).reshape(-1, 3)
    taken = min(sum(squares.values()), whole)
    return Floor(noise(images, variance), math.sqrt(whole), math.sqrt(taken), errors)


def told(problem: "Problem", floor: Floor | None) -> dict | None:
    """What a record says of the targets' noise, and of the ``floor`` that it makes where that is
    known; None where nothing tells it."""
    if floor is not None:
        return floor.record
    if problem.photographed is None:
        if problem.variance is None or not np.all(np.isfinite(problem.variance)):
            return None
        images = np.array(problem.targets).reshape(-1, 3)
        whole = math.sqrt(float(np.mean(problem.variance, dtype=np.float64)))
        return {"noise": noise(images, problem.variance), "pixel_rms": whole}
    deviation, how = problem.photographed
    if deviation is None:
        return {"unknown": how}
    counts = np.array(problem.targets).reshape(-1, 3)
    if problem.mask is not None:
        counts = counts[np.array(problem.mask) > 0]
    mean = float(np.mean(counts, dtype=np.float64)) if counts.size else 0.0
    share = deviation / mean if mean > 0 else 0.0
    return {"noise": share, "pixel_rms": deviation, "how": how}


def _moved(unknown, rng: np.random.Generator) -> np.ndarray:
    """The truth with each entry that is seen a little up or down, within its range: no farther than
    both ways are free, one at an end as far as usual ones, lest most of them move the same way."""
    truth = unknown.truth
    # Ranges may be wide: of densities, and of parameters whose meaning only others know.
    sizes = [
        np.sqrt(np.mean(np.square(x, dtype=np.float64))) for x in (truth, unknown.start - truth)
    ]
    step = _MOVED * min(max(sizes), unknown.high - unknown.low)
    signs = rng.choice([-1.0, 1.0], truth.shape) * unknown.seen
    room = np.minimum(truth - unknown.low, unknown.high - truth)
    free = room[unknown.seen & (room > 0)]
    usual = np.median(free) if free.size else step
    step = np.minimum(step, np.where(room > 0, room, usual)) * signs
    there = truth + step
    there = np.where((there < unknown.low) | (there > unknown.high), truth - step, there)
    return np.clip(there, unknown.low, unknown.high).astype(truth.dtype)
