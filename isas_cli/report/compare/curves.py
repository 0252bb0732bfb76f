"""Error against cost, the runs of a method on one grid."""

from __future__ import annotations

import numpy as np
import pandas

from . import bootstrap
from .gather import Method, by_measure
from .series import AXES, Series

_POINTS = 120
COLUMNS = ["scene", "method", "measure", "axis", "x", "median", "low", "high", "runs"]


def table(methods: list[Method]) -> pandas.DataFrame:
    """One row per scene, method, measure, axis and grid point.

    ``x``: billed seconds or light paths, evenly spaced in the logarithm, from the first evaluation
    of any run of the scene after the start to the end of its longest. ``median`` of the errors at x
    of the runs that went that far, ``runs`` of them, with the 95 % band ``low`` to
    ``high`` (NaN for one run). A curve ends with its last run and is not extrapolated; where
    ``runs`` drops on the way, the median may jump.
    """
    parts = [pandas.DataFrame(columns=COLUMNS)]
    for scene, measure, found in by_measure(methods):
        for axis in AXES:
            x = _grid([s for each in found.values() for s in each], axis)
            for label, own in found.items():
                part = _curve(own, x, axis)
                part = part.assign(scene=scene, method=label, measure=measure, axis=axis)
                parts.append(part[COLUMNS])
    parts = [part for part in parts if len(part)] or parts[:1]
    return pandas.concat(parts, ignore_index=True)


def _grid(series: list[Series], axis: str) -> np.ndarray:
    positive = [s.cost[axis][s.cost[axis] > 0] for s in series]
    positive = [cost for cost in positive if cost.size]
    if not positive:
        return np.empty(0)
    return np.geomspace(min(c[0] for c in positive), max(c[-1] for c in positive), _POINTS)


def _curve(series: list[Series], x: np.ndarray, axis: str) -> pandas.DataFrame:
    """Columns x, median, low, high, runs; grid points that no run has reached are left out."""
    parts = []
    if series and x.size:
        errors = np.stack([s.at(x, axis) for s in series], axis=1)
        present = np.isfinite(errors)
        # Runs end one by one: between two ends the same ones are present, and are resampled whole.
        for pattern in np.unique(present, axis=0):
            rows = (present == pattern).all(axis=1)
            if pattern.any():
                estimate = bootstrap.median(errors[rows][:, pattern])
                parts.append(
                    pandas.DataFrame({"x": x[rows], **_named(estimate), "runs": pattern.sum()})
                )
    if not parts:
        return pandas.DataFrame(columns=["x", "median", "low", "high", "runs"])
    return pandas.concat(parts).sort_values("x", ignore_index=True)


def _named(estimate: bootstrap.Estimate) -> dict[str, np.ndarray]:
    return {"median": estimate.value, "low": estimate.low, "high": estimate.high}
