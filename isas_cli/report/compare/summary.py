"""One row per method: where its runs ended, how soon they got as far as the baseline, and PBDR's
measures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas

from ...records import Run
from . import bootstrap, metrics
from .accuracy import named, speed_up
from .gather import Method, by_scene
from .series import MEASURES, Series, known, same_seeds, seed

# As near to the baseline's final error as counts as having got there. Curves are flat at their
# ends: without a margin, a method that ends a thousandth above the baseline would never get there.
_NEAR = 1.05
# Of the start's error: a baseline that ends above sets no goal, as the start itself would meet it.
_HIGHEST = 0.99


def table(methods: list[Method], baseline: dict[str, str]) -> pandas.DataFrame:
    """One row per scene and method; medians over seeds, ``…_low`` and ``…_high`` their
    95 % interval (NaN for one run). NaN: not known (no truth, not recorded).

    ``seeds``: their list, as text. ``iterations, paths, seconds`` (billed): at the last evaluation.
    ``<measure>``: final error; ``<measure>_share``: of the start's.
    ``<measure>_seconds_to_baseline``: until the error stays within 5 % of (or below) the final
    error of the baseline's run of the same seed (where seeds differ, of the median share of the
    start's that its runs end at), or below 0.99 of the start's where that is less, +inf: never;
    ``<measure>_speed_up``: what the baseline needed until then, divided by that, see
    `accuracy.table` for its infinities.
    ``RE, MPEA, CS, GN``: see `metrics`; CS +inf: not converged.
    ``nonfinite``: gradient entries that were not finite, of all runs together.
    ``<phase>_seconds``: billed seconds of stage1 and step, the plan's probe in neither;
    ``unbilled_seconds``: all others;
    ``stage1_share``: of the billed seconds.
    """
    rows = []
    for scene, group in by_scene(methods).items():
        base = next(m for m in group if m.label == baseline[scene])
        rows += [_row(method, base) for method in group]
    return pandas.DataFrame(rows)


def _row(method: Method, base: Method) -> dict:
    runs = method.runs
    row = {
        "scene": method.scene,
        "method": method.label,
        "baseline": method is base,
        "runs": len(runs),
        "seeds": " ".join(str(seed(run)) for run in runs),
    }
    for name, column in (("iterations", "iteration"), ("paths", "paths"), ("seconds", "seconds")):
        row[name] = _median(runs, lambda run: float(run.history[column].iloc[-1]))
    for measure in MEASURES:
        row |= _errors(method, base, measure)
    row |= {
        "RE": _median(runs, metrics.reconstruction_error),
        "MPEA": _median(runs, metrics.material_error),
        "CS": _median(runs, metrics.convergence_speed),
        "GN": _median(runs, metrics.gradient_noise),
        "nonfinite": sum(int(run.history["nonfinite"].iloc[-1]) for run in runs),
    }
    return row | _phases(runs)


def _errors(method: Method, base: Method, measure: str) -> dict:
    """A measure's final error, its share of the start's, and how it compares with the baseline."""
    own, reference = (known(m.runs, measure) for m in (method, base))
    cost, gain = _to_baseline(own, reference, method is base)
    columns = named(measure, _estimate([metrics.last(r, measure) for r in method.runs]))
    columns |= {f"{measure}_share": _median(method.runs, lambda r: metrics.share(r, measure))}
    columns |= named(f"{measure}_seconds_to_baseline", cost)
    columns |= named(f"{measure}_speed_up", gain)
    return {name: float(value) for name, value in columns.items()}


def _to_baseline(
    own: list[Series], base: list[Series], itself: bool
) -> tuple[bootstrap.Estimate, bootstrap.Estimate]:
    """Seconds to the baseline's final error, and by what factor that is sooner than it was."""
    finals = np.array([min(s.error[-1] * _NEAR, s.error[0] * _HIGHEST) for s in base])
    starts = np.array([s.error[0] for s in base])
    paired = same_seeds(own, base)
    judged = own if base else []
    goals = finals if paired else [np.median(finals / starts) * s.error[0] for s in judged]
    seconds = np.array([s.reached(goal, "seconds") for s, goal in zip(judged, goals)])
    needed = np.array([s.reached(goal, "seconds") for s, goal in zip(base, finals)])
    return bootstrap.median(seconds), speed_up(needed, seconds, paired, itself)


def _phases(runs: list[Run]) -> dict[str, float]:
    rows = []
    for run in runs:
        seconds = run.history["seconds"]
        stage1, billed = run.history["stage1_seconds"].iloc[-1], seconds.iloc[-1]
        phases = (run.summary or {}).get("seconds_unbilled")
        rows.append(
            {
                "stage1_seconds": stage1,
                # The first: all that is billed before a run's start.
                "step_seconds": billed - stage1 - seconds.iloc[0],
                "unbilled_seconds": sum(phases.values()) if phases else np.nan,
                "stage1_share": stage1 / billed if billed > 0 else np.nan,
            }
        )
    return {name: _median(rows, lambda row: row[name]) for name in rows[0]}


def _median(runs: list, of: Callable[..., float]) -> float:
    return float(_estimate([of(run) for run in runs]).value)


def _estimate(values: list[float]) -> bootstrap.Estimate:
    """Over the runs whose value is known."""
    every = np.array(values, dtype=float)
    return bootstrap.median(every[~np.isnan(every)])
