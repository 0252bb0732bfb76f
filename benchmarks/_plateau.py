"""PRDPT's six tasks: every method from many starts, at equal billed time.

Per task: a search for each method's rate (a factor on all of the task's learning rates) with a few
starts of their own, then all starts at the best. Runs of one task take turns. A method's iterations
differ, as the budget is billed time: both are in the table. The paper gives all methods the same
number of iterations.

Writes results/plateau_<task>.csv (a row per method) and plateau_<task>_runs.csv (a row per run).

    make reproduce SCENES=plateau
    python benchmarks/_plateau.py cup shadows --starts 20
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas
from scipy.optimize import linear_sum_assignment

RESULTS = Path(__file__).parent / "results"
COMMON = ["estimator.batch=16384", "target.spp=512", "evaluation.count=20", "report=false"]
COMMON += ["evaluation.pixels=4096", "evaluation.spp=16", "frames.views=0", "frames.snapshots=0"]
METHODS = {
    "plateau": ["sampler=plateau"],
    "plateau_loss": ["sampler=plateau", "sampler.smooth=loss"],
    "plateau_drawn": ["sampler=plateau", "sampler.base=differences"],
    "plateau_renderer": ["sampler=plateau", "sampler.gradient=renderer"],
    "mitsuba": ["sampler=mitsuba"],
    "finite_differences": ["sampler=finite_differences"],
}
FACTORS = (0.3, 1.0, 3.0)


@dataclass(frozen=True)
class Task:
    """``seconds``: the budget of a run; ``spread``: key → half the width of the interval around
    the configured start that starts are drawn from, per entry; None: the scene's own random start,
    with another seed."""

    seconds: float
    spread: dict[str, float] | None


TASKS = {
    "cup": Task(15, {"cup.angle": 9.0}),
    "shadows": Task(15, {"ball.place": 0.15}),
    "occlusion": Task(15, {"red.depth": 0.5}),
    "global_illumination": Task(
        20, {"lamp.place": 0.1, "box.angle": 5.0, "left.bsdf.base_color.value": 0.1}
    ),
    "sort": Task(60, None),
    "caustic": Task(20, {"lamp.place": 0.4}),
}


def configured(task: str, method: str, trial: int, factor: float, seconds: float):
    """The configuration of one run: its start drawn by ``trial``, all rates times ``factor``."""
    from isas_cli.compose import compose, translate

    settings = [f"scene={task}", f"budget.seconds={seconds}", f"seed={trial}", *COMMON]
    cfg = compose(translate([*settings, *METHODS[method], f"name=trial{trial}"]))
    rng = np.random.default_rng(1000 + trial)
    for key, unknown in cfg.scene.unknowns.items():
        unknown.lr = float(unknown.lr * factor)
        if TASKS[task].spread is None:
            unknown.start.seed = trial
            continue
        start = np.atleast_1d(np.asarray(unknown.start, float))
        start = start + TASKS[task].spread[key] * rng.uniform(-1, 1, start.size)
        unknown.start = float(start[0]) if start.size == 1 else start.tolist()
    return cfg


def race(folder: Path, runs: list, slice_seconds: float = 1.0) -> None:
    """``runs``: (label, configuration) each."""
    from isas_cli import race as racing

    entries = [racing.Entry(label, cfg, folder / label) for label, cfg in runs]
    racing.run(entries, slice_seconds, lambda: None)


def filled(folder: Path) -> int:
    """How many of sort's places hold a cube of their colour: at most half a side away, each cube at
    one place only."""
    from isas_cli.scenes import sort

    from isas_cli import records

    arrays, _ = records.load_checkpoint(folder)
    places = sort.places().reshape(3, 25, 2)
    cubes = places + arrays["value/cubes.place"].reshape(3, 25, 2)
    apart = np.linalg.norm(places[:, :, None] - cubes[:, None], axis=-1)
    near = apart < sort.SIDE / 2
    return sum(int(group[linear_sum_assignment(~group)].sum()) for group in near)


def finished(folder: Path) -> pandas.DataFrame:
    """A row per run: label, trial, errors at start and end, iterations, billed seconds."""
    from isas_cli import records

    rows = []
    for path in sorted(folder.rglob("summary.json")):
        run = records.load(path.parent)
        first, last = run.history.iloc[0], run.history.iloc[-1]
        method, factor, trial = path.parent.name.rsplit("_", 2)
        rows.append(
            {
                "method": method,
                "factor": float(factor),
                "trial": int(trial),
                "iterations": int(last["iteration"]),
                "seconds": last["seconds"],
                "image_mse": last["image_rmse"] ** 2,
                "parameter_mse": last["parameter_rmse"] ** 2,
                "share_of_start": last["parameter_rmse"] / first["parameter_rmse"],
                "filled": filled(path.parent) if run.config["scene"]["name"] == "sort" else None,
            }
        )
    return pandas.DataFrame(rows)


def table(task: str, found: pandas.DataFrame) -> pandas.DataFrame:
    """A row per method: medians and quartiles over the starts."""
    rows = []
    for method, own in found.groupby("method", sort=False):
        row = {"task": task, "method": method, "factor": own["factor"].iloc[0], "starts": len(own)}
        for name in ("image_mse", "parameter_mse", "share_of_start"):
            quartiles = own[name].quantile([0.25, 0.5, 0.75])
            row |= {f"{name}_low": quartiles[0.25], name: quartiles[0.5]}
            row |= {f"{name}_high": quartiles[0.75]}
        row["within_1_percent"] = int((own["share_of_start"] < 0.01).sum())
        row["within_5_percent"] = int((own["share_of_start"] < 0.05).sum())
        row["filled"] = own["filled"].median()
        row["iterations"] = own["iterations"].median()
        row["seconds_per_iteration"] = (own["seconds"] / own["iterations"]).median()
        row["seconds"] = own["seconds"].median()
        rows.append(row)
    return pandas.DataFrame(rows)


def compared(task: str, root: Path, chosen: argparse.Namespace) -> pandas.DataFrame:
    """Both races of a task and what is kept of them."""
    seconds = chosen.seconds or TASKS[task].seconds
    methods = [m for m in METHODS if not (task == "sort" and m == "finite_differences")]
    starts = min(chosen.starts, 5) if task == "sort" else chosen.starts

    def run(folder: Path, factors: Callable[[str], tuple], trials: range) -> pandas.DataFrame:
        race(
            folder,
            [
                (f"{m}_{f:g}_{t}", configured(task, m, t, f, seconds))
                for t in trials
                for m in methods
                for f in factors(m)
            ],
        )
        return finished(folder)

    search = run(root / task / "rates", lambda m: FACTORS, range(101, 101 + chosen.search))
    medians = search.groupby(["method", "factor"])["parameter_mse"].median().reset_index()
    best = medians.loc[medians.groupby("method")["parameter_mse"].idxmin()]
    rate = dict(zip(best["method"], best["factor"]))
    found = run(root / task / "starts", lambda m: (rate[m],), range(1, 1 + starts))
    found.to_csv(RESULTS / f"plateau_{task}_runs.csv", index=False, float_format="%.4g")
    made = table(task, found)
    made.to_csv(RESULTS / f"plateau_{task}.csv", index=False, float_format="%.4g")
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", metavar="TASK", help=f"of {', '.join(TASKS)}")
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--search", type=int, default=3, help="starts of the search for rates")
    parser.add_argument("--seconds", type=float, help="budget of each run, instead of the task's")
    parser.add_argument("--folder", type=Path, help="where the runs go (default: a new folder)")
    chosen = parser.parse_args()
    strange = [task for task in chosen.tasks if task not in TASKS]
    if strange:
        parser.error(f"{strange[0]}: no such task; valid: {', '.join(TASKS)}")
    from isas_cli import backend

    backend.start()
    root = chosen.folder or Path(tempfile.mkdtemp(prefix="isas-plateau-"))
    RESULTS.mkdir(exist_ok=True)
    for task in chosen.tasks or TASKS:
        print(compared(task, root, chosen).to_string(index=False), flush=True)


if __name__ == "__main__":
    main()
