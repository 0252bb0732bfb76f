"""Collisions in thin smoke: how likely a path must at least meet one for the derivative by density.

A real collision's weight has the derivative dσ/σ and, drawn with probability σ/σ̄, a second moment
that grows as 1/σ. With at least ``LEAST`` of them real it is bounded, and paths scatter where there
is next to nothing. For several bounds, in turns, on smoke at the start and on the way to the truth:
the variance of the gradient, summed over the entries and in the median over them, the time of a
gradient, and what 600 iterations reach with six seeds. Writes results/volume_collisions.csv.

    .venv/bin/python benchmarks/volume_collisions.py
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
import pandas
from _child import problem_of

from isas_cli.runtime import backend

RESULTS = Path(__file__).parent / "results"
BOUNDS = (0.0, 0.01, 0.03, 0.1)
PLACES = {"start": 0.0, "half way": 0.5, "nine tenths": 0.9}
SETTINGS = ["scene=smoke", "target.spp=64", "estimator.batch=16384"]
ESTIMATES, SEEDS = 40, 6


def variances() -> list[dict]:
    from isas_cli import losses
    from isas_cli.config.compose import compose, instantiate
    from isas_cli.estimators.two_path import TwoPath
    from isas_cli.rendering import integrators
    from isas_cli.unknowns.parameters import flat

    settings = [*SETTINGS, "scene.sizes.default.levels=1"]
    problem, _ = problem_of(settings)
    sampler = instantiate(compose([*settings, "sampler=uniform"]).sampler, "sampler")
    sampler.prepare(problem, losses.L2(), 16384)
    unknowns, rows = problem.unknowns, []
    start, truth = unknowns.starts(), unknowns.truths()
    (key,) = (key for key in unknowns.keys if "sigma_t" in key)
    for place, share in PLACES.items():
        values = {k: start[k] * (1 - share) + truth[k] * share for k in start}
        pmf = sampler.distribution(sampler.look(values, 1, 0))
        estimators, found = {}, {bound: [] for bound in BOUNDS}
        spent = {bound: [] for bound in BOUNDS}
        for bound in BOUNDS:
            estimators[bound] = TwoPath(problem, losses.L2(), 16384)
        for i in range(-4, ESTIMATES):
            for bound in BOUNDS:
                integrators.LEAST = bound  # read while a kernel is recorded
                backend.sync()
                begun = time.perf_counter()
                gradient = estimators[bound].estimate(values, pmf, 3, i + 4, 0.0)[key]
                entries = np.array(flat(gradient), np.float64)
                if i >= 0:
                    spent[bound].append(time.perf_counter() - begun)
                    found[bound].append(entries)
        for bound in BOUNDS:
            each = np.var(found[bound], axis=0, ddof=1)
            row = {"what": "variance", "place": place, "bound": bound, "sum": each.sum()}
            rows.append(row | {"median": np.median(each), "seconds": np.median(spent[bound])})
    return rows


def runs() -> list[dict]:
    import isas_cli
    from isas_cli.rendering import integrators

    rows = []
    settings = [*SETTINGS, "sampler=uniform", "budget.iterations=600", "effects=full"]
    settings += ["evaluation.count=6", "frames.views=0", "report=false", "overwrite=true"]
    with tempfile.TemporaryDirectory(prefix="isas-collisions-") as folder:
        for seed in range(1, SEEDS + 1):
            for bound in BOUNDS:
                integrators.LEAST = bound
                run = isas_cli.run(*settings, f"seed={seed}", f"hydra.run.dir={folder}")
                row = {"what": "run", "bound": bound, "seed": seed}
                names = ("image_rmse", "parameter_rmse", "seconds")
                rows.append(row | {name: run.history[name].iloc[-1] for name in names})
    return rows


def main() -> None:
    backend.start()
    found = pandas.DataFrame(variances())
    usual = found[found["bound"] == 0].set_index("place")
    for name in ("sum", "median", "seconds"):
        found[name] /= found["place"].map(usual[name])  # shares: times drift, and mean nothing
    print(found.to_string(index=False), flush=True)
    each = pandas.DataFrame(runs())
    usual = each[each["bound"] == 0].set_index("seed")["seconds"]
    each["seconds"] /= each["seed"].map(usual)
    table = pandas.concat([found, each])
    table.to_csv(RESULTS / "volume_collisions.csv", index=False, float_format="%.4g")
    print(each.groupby("bound")[["image_rmse", "parameter_rmse", "seconds"]].agg(["mean", "sem"]))


if __name__ == "__main__":
    main()
