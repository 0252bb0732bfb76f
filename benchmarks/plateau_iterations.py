"""Mitsuba's derivative with as many iterations as `sampler=plateau` had, whatever they cost.

`_plateau.py` gives both the same billed time, in which Mitsuba takes fewer steps, down to a
fifteenth: at the rate that keeps it from overshooting it may not come far enough. Here it has the
median number of `plateau`'s steps (results/plateau_<task>.csv), as in the paper, at several factors
on the rates. What is left of the start's error per task, factor and start; no times. Writes
results/plateau_iterations.csv. Where an end of the factors was a start's best, farther ones were
tried as well:

    python benchmarks/plateau_iterations.py shadows caustic global_illumination --factors 0.1 0.3
    python benchmarks/plateau_iterations.py cup occlusion --factors 100 300
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

import _contest
import _plateau
import _plateau_table
import numpy as np
import pages
import pandas

OUTPUT = _plateau.RESULTS / "plateau_iterations.csv"
FACTORS = (1.0, 3.0, 10.0, 30.0)
TASKS = ("cup", "shadows", "occlusion", "global_illumination", "caustic")
METHOD = "mitsuba"


def settings(task: str, trial: int, factor: float, iterations: int):
    cfg = _plateau.configured(task, METHOD, trial, factor, 1.0)
    cfg.budget.seconds, cfg.budget.iterations = None, iterations
    return cfg


def measure(task: str, trials: range, factors: list[float], iterations: int) -> list[dict]:
    from isas_cli import records
    from isas_cli.engine import race
    from isas_cli.runtime import backend, interrupt

    backend.start()
    rows = []
    for trial in trials:
        folder = Path(tempfile.mkdtemp(prefix="isas-iterations-"))
        entries = [
            race.Entry(f"{factor:g}", settings(task, trial, factor, iterations), folder / str(i))
            for i, factor in enumerate(factors)
        ]
        # At a factor that is too large a run may fail, and is of no use.
        if (status := race.run(entries, 5.0, lambda: None)) == interrupt.STATUS:
            raise SystemExit(status)
        for i, factor in enumerate(factors):
            run = records.load(folder / str(i))
            share = _plateau_table.together(_plateau_table.shares(run.history))
            if run.summary["status"] != "done":
                share[-1] = np.inf
            row = {"task": task, "factor": factor, "trial": trial, "iterations": iterations}
            # The nearest that it came, in case it passed by.
            rows.append(row | {"share_of_start": share[-1], "least": share.min()})
        shutil.rmtree(folder)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--starts", type=int, default=2)
    parser.add_argument("--factors", type=float, nargs="+", default=FACTORS)
    chosen = _plateau_table.asked(parser, TASKS)
    for task in chosen.tasks:
        raced = pandas.read_csv(_plateau.RESULTS / f"plateau_{task}.csv").set_index("method")
        iterations = int(raced.loc["plateau", "iterations"])
        first = _plateau.TASKS[task].first
        trials = range(first, first + chosen.starts)
        rows = pandas.DataFrame(measure(task, trials, chosen.factors, iterations))
        print(rows.to_string(index=False, float_format="%.3g"), flush=True)
        _contest.write(OUTPUT, rows, ("task", "factor"))
        pages.write()


if __name__ == "__main__":
    main()
