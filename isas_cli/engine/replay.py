"""One iteration again: which unknowns get a gradient that is not finite, and from which pixels.

Random numbers are functions of the base seed and the iteration, so any iteration can be had again;
values are those of the checkpoint.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..estimators.estimator import Gradients
from ..estimators.staged import Staged
from ..estimators.two_path import TwoPath
from ..runtime import streams
from ..unknowns.parameters import as_numpy, flat, unflat
from .loop import Loop

# Pixels that are told apart, of as many as there are.
_MOST = 5


@dataclass(frozen=True)
class Place:
    """A path whose part in the gradient is not finite: where it begins, and what of it is not: the
    residual, or its product with the derivative by a key."""

    view: int
    column: int
    row: int
    what: str

    def __str__(self) -> str:
        return f"view {self.view}, column {self.column}, row {self.row}: {self.what}"


@dataclass(frozen=True)
class Replay:
    """``entries``: by key, how many of the gradient's are not finite, and of how many; ``paths``:
    how many paths are to blame; ``places``: some of them."""

    iteration: int
    entries: dict[str, tuple[int, int]]
    paths: int
    places: list[Place]

    def __str__(self) -> str:
        keys = [
            f"{bad} of {all_} entries of '{key}'"
            for key, (bad, all_) in self.entries.items()
            if bad
        ]
        told = f"iteration {self.iteration} again: {', '.join(keys) or 'all entries are finite'}"
        return f"{told}; first {self.places[0]}" if self.places else told


def again(loop: Loop, iteration: int) -> Replay:
    """The iteration's estimate at the loop's present values; changes nothing of the loop."""
    entries = {}
    for key, gradient in loop.gradient(iteration).items():
        found = as_numpy(gradient)
        entries[key] = int(np.sum(~np.isfinite(found))), found.size
    paths, places = 0, []
    # What compares renderings has no path of its own for each entry.
    estimator = _of_paths(loop.estimator)
    if estimator is not None:
        lanes = {}
        for what, bad in _bad_paths(loop, estimator, iteration):
            for lane in np.flatnonzero(bad):
                lanes.setdefault(int(lane), what)
        paths = len(lanes)
        chosen = sorted(lanes)[:_MOST]
        where = _drawn(loop, estimator, iteration)
        places = [Place(*(int(each[lane]) for each in where), lanes[lane]) for lane in chosen]
    return Replay(iteration, entries, paths, places)


def _of_paths(estimator: Gradients) -> TwoPath | None:
    """``estimator``, if it differentiates paths of drawn pixels at the values themselves."""
    if isinstance(estimator, Staged):
        estimator = estimator.present
    own = isinstance(estimator, TwoPath) and estimator.blur is None
    return estimator if own else None


def _drawn(loop: Loop, of: TwoPath, iteration: int) -> list[np.ndarray]:
    """View, column and row of every pixel that the iteration draws, or of those of its windows."""
    windows, batch = of.loss.windows, of.batch
    drawn = batch if windows is None else batch // windows.count
    seed = mi.UInt32(streams.seed(loop.seed, iteration, "draw"))
    view, column, row, _ = loop.distribution.draw(drawn, seed)
    view = dr.zeros(mi.UInt32, drawn) + view  # of a single view its number is one entry
    if windows is not None:
        dr.eval(view, column, row)
        view, column, row, _ = windows.spread(of.problem.views, view, column, row, drawn)
    view, column, row = (np.array(each) for each in (view, column, row))
    kept = loop.problem.kept
    return [view if kept is None else np.array(kept)[view], column, row]


def _bad_paths(loop: Loop, of: TwoPath, iteration: int) -> Iterator[tuple[str, np.ndarray]]:
    """What is not finite, and along which paths, ``(N,) bool``."""
    problem, values = of.problem, loop.stepper.values
    for key in [None, *problem.unknowns.keys]:
        found: list[np.ndarray] = []

        def look(integrator, scene, streams, rays, adjoints, key=key, found=found):
            again = [stream.clone() for stream in streams]
            radiances = integrator.radiances(scene, streams, rays)
            dr.eval(radiances)
            parts = adjoints(radiances, finite=False)
            if key is not None:
                paths = zip(reversed(again), reversed(rays))
                parts = [a * integrator.forward(scene, *path) for a, path in zip(parts, paths)]
            with np.errstate(invalid="ignore"):  # what is looked for
                sums = [sum(np.array(part) for part in each) for each in (parts, radiances)]
            found.extend(~np.all(np.isfinite(each), axis=0) for each in sums)

        estimator = TwoPath(problem, of.loss, of.batch, False, look)
        if key is None:
            problem.unknowns.attach(values)
        elif problem.integrator.has_forward:
            tangents = {
                other: unflat(value, dr.full(mi.Float, float(other == key), dr.width(flat(value))))
                for other, value in values.items()
            }
            problem.unknowns.push_tangent(values, tangents)
        else:
            continue
        estimator.accumulate(loop.distribution, loop.seed, iteration)
        what = "residual" if key is None else f"gradient by {key}"
        bad, own = found
        if (windows := of.loss.windows) is not None:
            # One path spoils all of its window: it alone is to blame, where there is one.
            own = np.broadcast_to(own, bad.shape).reshape(-1, windows.count)
            bad = np.where(own.any(axis=1, keepdims=True), own, bad.reshape(own.shape)).ravel()
        yield what, bad
    problem.unknowns.write(values)
