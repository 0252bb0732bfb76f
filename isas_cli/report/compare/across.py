"""All scenes together: how much sooner a method is, how often it arrives, and how sure that is.

Levels are what the baseline has after an eighth, a quarter, half and three quarters of its budget,
on each scene by itself: halvings of the start's error often lie beyond what anyone reaches. What it
has at the very end half of its own seeds would reach by definition, and another method that is as
good by luck alone: it would look slower. A *problem* is a scene and a level.
"""

from __future__ import annotations

import itertools

import numpy as np
import pandas
from scipy import stats

from .gather import Method, Problems, by_scene, names
from .series import MEASURES, Series, known

# Of the baseline's budget.
SHARES = (0.125, 0.25, 0.5, 0.75)
# Of the start's error: where the baseline is above, as some runs are at first, there is no level to
# reach, and a ratio of times would be of nothing over nothing.
_HIGHEST = 0.99
_RESAMPLES = 999
_SEED = 20260102


def problems(methods: list[Method], baseline: dict[str, str]) -> list[Problems]:
    """For each measure that all runs know, what methods that are there on all scenes reached.
    Empty for one scene, and where the scenes' baselines are not one method (``untold``)."""
    grouped, named, shared, bases = _common(methods, baseline)
    if len(bases) != 1 or len(shared) < 2 or not bases <= set(shared):
        return []
    (base,) = bases
    made = []
    for measure in MEASURES:
        found = {
            name: {
                scene: known(m.runs, measure)
                for scene, group in grouped.items()
                for m in group
                if named[scene][m.label] == name
            }
            for name in [base, *(n for n in shared if n != base)]
        }
        if all(runs for of in found.values() for runs in of.values()):
            made.append(_reached(measure, base, found))
    return made


def untold(methods: list[Method], baseline: dict[str, str]) -> list[str]:
    """What is not said of all scenes together, where methods could be compared over them."""
    grouped, named, shared, bases = _common(methods, baseline)
    if len(grouped) < 2:
        return []
    if len(shared) < 2:
        alike = set.intersection(*({m.sampler for m in own} for own in grouped.values()))
        told = (
            "nothing is said of all scenes together: on some, settings tell "
            f"{', '.join(sorted(alike))} apart: compare folders that hold the same methods"
        )
        return [told] if len(alike) > 1 else []
    if len(bases) == 1 and bases <= set(shared):
        partly = sorted({name for own in named.values() for name in own.values()} - set(shared))
        told = f"not on all scenes, so not in the table of these: {', '.join(partly)}"
        return [told] if partly else []
    given = "; ".join(f"{scene}: {label}" for scene, label in baseline.items())
    return [
        f"nothing is said of all scenes together, whose baselines differ ({given}): --baseline "
        f"METHOD names one of {', '.join(shared)}"
    ]


def _common(methods: list[Method], baseline: dict[str, str]) -> tuple:
    """Methods by scene, their names by scene and label, the names that all of several scenes have,
    and those of the baselines."""
    grouped = by_scene(methods)
    named = {scene: names(group) for scene, group in grouped.items()}
    bases = {named[scene][label] for scene, label in baseline.items()}
    first, *others = [list(of.values()) for of in named.values()] or [[]]
    shared = [name for name in first if others and all(name in other for other in others)]
    return grouped, named, shared, bases


def _reached(measure: str, base: str, found: dict[str, dict[str, list[Series]]]) -> Problems:
    budgets, goals = {}, {}
    for scene, runs in found[base].items():
        budgets[scene] = float(np.median([s.cost["seconds"][-1] for s in runs]))
        at = np.array(SHARES) * budgets[scene]
        # A run that ended before, by a kill or by a hair, stays where it ended.
        ended = [np.minimum(at, s.cost["seconds"][-1]) for s in runs]
        shares = np.median(
            [s.at(each, "seconds") / s.error[0] for s, each in zip(runs, ended)], axis=0
        )
        # A hair more: the run that gives a level is to reach it, whatever its digits round to.
        goals[scene] = np.minimum(shares * (1 + 1e-9), _HIGHEST)

    def each(of) -> dict[str, dict[str, np.ndarray]]:
        return {
            name: {scene: of(scene, runs) for scene, runs in by.items()}
            for name, by in found.items()
        }

    return Problems(
        measure,
        base,
        each(
            lambda scene, runs: np.array(
                [[s.reached(g * s.error[0], "seconds") for s in runs] for g in goals[scene]]
            )
        ),
        each(lambda scene, runs: np.array([s.cost["seconds"][-1] for s in runs])),
        each(lambda scene, runs: np.array([s.error[-1] / s.error[0] for s in runs])),
        budgets,
    )


def expected(times: np.ndarray, spent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Expected running time to each level, ``(levels,)``, and whether any run reached it: what all
    seeds spent together, each until it arrived or to its end, over the number that arrived (Hansen
    et al. 2021, COCO). Where none did, as if the next moment had been the first arrival: a bound
    from below."""
    arrived = np.isfinite(times)
    total = np.where(arrived, times, spent).sum(axis=-1)
    return total / np.maximum(arrived.sum(axis=-1), 1), arrived.any(axis=-1)


def table(found: list[Problems]) -> pandas.DataFrame:
    """One row per measure and method.

    ``reached``: share of (scene, seed, level) that it reached; ``time_<share>``: expected running
    time to what the baseline has after that share of its budget, over the baseline's own, the
    geometric mean over scenes, and ``bound_<share>``, of that ratio: ``at least`` where this method
    never reached it on some scene, ``at most`` where the baseline did not, ``about`` where neither
    did; ``speed_up``: geometric mean over all problems of the baseline's expected running time over
    this one's, ``_low`` and ``_high`` its 95 % interval (scenes, then seeds within each scene and
    method, are resampled), and ``bound``, likewise; ``p``: see ``pairs``, against the baseline.
    """
    rows = []
    for each in found:
        compared = pairs(each)
        for name in each.times:
            times, solved = _ratios(each, name)
            low, high = _interval(each, name)
            row = {"measure": each.measure, "method": name, "scenes": len(each.budgets)}
            arrived = [np.isfinite(t).ravel() for t in each.times[name].values()]
            row["reached"] = float(np.concatenate(arrived).mean())
            for share, ratio, sure in zip(SHARES, np.exp(np.log(times).mean(axis=0)), solved.T):
                row[f"time_{share:g}"] = float(ratio)
                row[f"bound_{share:g}"] = _BOUNDS[tuple(sure[::-1])]
            row["speed_up"] = float(np.exp(-np.log(times).mean()))
            row |= {
                "speed_up_low": low,
                "speed_up_high": high,
                "bound": _BOUNDS[tuple(solved.all(axis=1))],
            }
            row["p"] = compared.get(frozenset((name, each.baseline)), float("nan"))
            rows.append(row)
    return pandas.DataFrame(rows)


# By whether the method and whether the baseline solved every problem.
_BOUNDS = {
    (True, True): "",
    (False, True): "at most",
    (True, False): "at least",
    (False, False): "about",
}


def _ratios(of: Problems, name: str, rng=None) -> tuple[np.ndarray, np.ndarray]:
    """Expected running times over the baseline's, ``(scenes, levels)``, and whether it and the
    baseline reached each level on all scenes, ``(2, levels)``. ``rng``: scenes and seeds are
    resampled."""
    levels = len(next(iter(of.times[name].values())))
    certain = np.ones((2, levels), bool)
    if name == of.baseline:
        return np.ones((len(of.budgets), levels)), certain
    rows, scenes = [], list(of.budgets)
    if rng is not None:
        scenes = [scenes[k] for k in rng.integers(len(scenes), size=len(scenes))]
    for scene in scenes:
        sides = []
        for side, method in enumerate((name, of.baseline)):
            times, spent = of.times[method][scene], of.spent[method][scene]
            if rng is not None:
                drawn = rng.integers(times.shape[1], size=times.shape[1])
                times, spent = times[:, drawn], spent[drawn]
            value, solved = expected(times, spent)
            certain[side] &= solved
            sides.append(value)
        rows.append(sides[0] / sides[1])
    return np.array(rows), certain


def _interval(of: Problems, name: str) -> tuple[float, float]:
    """Of the speed-up; (1, 1) of the baseline over itself, NaN where a seed is alone."""
    if name == of.baseline:
        return 1.0, 1.0
    if min(spent.size for spent in (*of.spent[name].values(), *of.spent[of.baseline].values())) < 2:
        return float("nan"), float("nan")
    rng = np.random.default_rng(_SEED)
    drawn = [np.exp(-np.log(_ratios(of, name, rng)[0]).mean()) for _ in range(_RESAMPLES)]
    low, high = np.quantile(drawn, (0.025, 0.975))
    return float(low), float(high)


def pairs(of: Problems) -> dict[frozenset, float]:
    """For each pair of methods the p-value of the signed-rank test (Wilcoxon) of their final
    errors, of each scene the medians over its seeds; by Holm. Scenes are what a method is judged
    by: seeds of one are alike, and a hundred of them tell nothing of another scene."""
    medians = {
        name: np.log([np.median(by[scene]) for scene in of.budgets])
        for name, by in of.finals.items()
    }
    raw = {}
    for both in itertools.combinations(medians, 2):
        apart = medians[both[0]] - medians[both[1]]
        raw[frozenset(both)] = float(stats.wilcoxon(apart).pvalue) if apart.any() else 1.0
    corrected, largest = {}, 0.0
    for number, (both, p) in enumerate(sorted(raw.items(), key=lambda item: item[1])):
        largest = max(largest, min(1.0, p * (len(raw) - number)))
        corrected[both] = largest
    return corrected


def arrivals(of: Problems) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Method → shares of the budget, rising, and the share of (scene, seed, level) reached by then:
    the empirical distribution of running times."""
    return {
        name: _distribution(
            np.concatenate([by[scene].ravel() / of.budgets[scene] for scene in of.budgets])
        )
        for name, by in of.times.items()
    }


def profiles(of: Problems) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Method → factors, from 1 on, and the share of problems that it solves within that factor of
    the soonest method's expected running time (Dolan and Moré 2002)."""
    costs = {}
    for name, by in of.times.items():
        values = []
        for scene in of.budgets:
            value, solved = expected(by[scene], of.spent[name][scene])
            values.append(np.where(solved, value, np.inf))
        costs[name] = np.concatenate(values)
    soonest = np.min(list(costs.values()), axis=0)
    with np.errstate(invalid="ignore"):
        return {name: _distribution(cost / soonest) for name, cost in costs.items()}


def _distribution(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Finite values, rising, and the share of all that is no larger. SciPy's takes no infinity."""
    ordered = np.sort(values[np.isfinite(values)])
    return ordered, np.arange(1, ordered.size + 1) / values.size
