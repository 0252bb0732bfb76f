"""PRDPT's six tasks: every method from many starts, at equal billed time.

Per task: a search for each method's rate (a factor on all of the task's learning rates) from a
start of its own, then all starts at the best; the runs from one start take turns. A method's
iterations differ, as the budget is billed time: both are in the table. The paper gives all methods
the same number of iterations. Variants of the plateau-reduced gradient have five starts, all others
twenty, sort five of each.

Writes results/plateau_<task>_rates.csv, the search, and the tables (`_plateau_table.py`).

    make reproduce SCENES=plateau
    python benchmarks/_plateau.py cup shadows --starts 20
"""

from __future__ import annotations

import argparse
import copy
import functools
import multiprocessing
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import _plateau_table
import numpy as np
import pandas

RESULTS = _plateau_table.RESULTS
COMMON = ["evaluation.count=12", "report=false", "frames.views=0", "frames.snapshots=0"]
COMMON += ["evaluation.pixels=4096", "evaluation.spp=16"]
METHODS = {
    "plateau": ["sampler=plateau"],
    "plateau_loss": ["sampler=plateau", "sampler.smooth=loss"],
    "plateau_drawn": ["sampler=plateau", "sampler.base=differences"],
    "plateau_renderer": ["sampler=plateau", "sampler.gradient=renderer"],
    "mitsuba": ["sampler=mitsuba"],
    "finite_differences": ["sampler=finite_differences"],
}
FACTORS = (0.3, 1.0, 3.0)
VARIANTS = ("plateau_loss", "plateau_renderer")
FEW = 5  # starts of variants, and of sort
SEARCH = 101  # the trial that rates are chosen on, none of the starts


@dataclass(frozen=True)
class Task:
    """``seconds``: the budget of a run; ``spread``: key → half the width of the interval around
    the configured start that starts are drawn from, per entry; None: the scene's own random start,
    with another seed; ``batch``: pixels of one rendering; ``spp``: of the targets."""

    seconds: float
    spread: dict[str, float] | None
    batch: int = 16384
    spp: int = 1024
    methods: tuple[str, ...] = tuple(METHODS)


TASKS = {
    "occlusion": Task(3, {"red.depth": 0.5}),
    "shadows": Task(5, {"ball.place": 0.15}),
    "cup": Task(6, {"cup.angle": 9.0}),
    "global_illumination": Task(
        15, {"lamp.place": 0.1, "box.angle": 5.0, "left.bsdf.base_color.value": 0.1}, batch=8192
    ),
    # No finite differences: 150 unknowns, 300 renderings a step.
    "sort": Task(30, None, batch=8192, methods=("plateau", "plateau_drawn", "mitsuba")),
    "caustic": Task(15, {"lamp.place": 0.4}, spp=8192),
}


@functools.cache
def composed(task: str, method: str, seconds: float):
    """The configuration of a method's runs, as it is before rates and starts."""
    from isas_cli.compose import compose, translate

    own = TASKS[task]
    settings = [f"scene={task}", f"budget.seconds={seconds}", *COMMON]
    settings += [f"estimator.batch={own.batch}", f"target.spp={own.spp}"]
    return compose(translate([*settings, *METHODS[method]]))


def configured(task: str, method: str, trial: int, factor: float, seconds: float):
    """The configuration of one run: its start drawn by ``trial``, all rates times ``factor``."""
    own, cfg = TASKS[task], copy.deepcopy(composed(task, method, seconds))
    cfg.name, cfg.seed = f"trial{trial}", trial
    rng = np.random.default_rng(1000 + trial)
    for key, unknown in cfg.scene.unknowns.items():
        unknown.lr = float(unknown.lr * factor)
        if own.spread is None:
            unknown.start.seed = trial
            continue
        start = np.atleast_1d(np.asarray(unknown.start, float))
        start = start + own.spread[key] * rng.uniform(-1, 1, start.size)
        unknown.start = float(start[0]) if start.size == 1 else start.tolist()
    return cfg


def _lanes(folder: Path, task: str, wanted: list[tuple[str, float, int]], seconds: float) -> None:
    """``wanted``: method, factor on the rates, trial."""
    from isas_cli import backend, interrupt, race

    backend.start()
    entries = []
    for method, factor, trial in wanted:
        label = f"{method}_{factor:g}_{trial}"
        cfg = configured(task, method, trial, factor, seconds)
        entries.append(race.Entry(label, cfg, folder / label))
    status = race.run(entries, 1.0, lambda: None)
    if status == interrupt.STATUS:
        raise SystemExit(status)


def race(folder: Path, *arguments) -> None:
    """``_lanes`` in a process of its own; not again where ``folder`` has what an earlier call
    finished, to which the same must have been given. All runs of one race begin at the same place,
    so that they share one scene: several in a process slow down each other's kernels, those that
    are not frozen most."""
    if folder.exists():
        return
    unfinished = folder.with_name(f"{folder.name}.unfinished")
    shutil.rmtree(unfinished, ignore_errors=True)
    child = multiprocessing.get_context("spawn").Process(
        target=_lanes, args=(unfinished, *arguments)
    )
    child.start()
    child.join()
    if child.exitcode:
        raise SystemExit(child.exitcode)
    unfinished.rename(folder)


def compared(task: str, root: Path, chosen: argparse.Namespace) -> pandas.DataFrame:
    """Both races of a task and what is kept of them."""
    seconds = chosen.seconds or TASKS[task].seconds
    methods = TASKS[task].methods
    few = min(chosen.starts, FEW)
    starts = {m: few if task == "sort" or m in VARIANTS else chosen.starts for m in methods}

    rates = root / task / "rates"
    race(rates, task, [(m, f, SEARCH) for m in methods for f in FACTORS], seconds)
    search, _ = _plateau_table.finished(rates)
    search.to_csv(RESULTS / f"plateau_{task}_rates.csv", index=False, float_format="%.4g")
    judged = "sorted_mse" if task == "sort" else "share_of_start"
    best = search.loc[search.groupby("method")[judged].idxmin()]
    rate = dict(zip(best["method"], best["factor"]))
    for trial in range(1, 1 + chosen.starts):
        wanted = [(m, rate[m], trial) for m in methods if trial <= starts[m]]
        if wanted:
            race(root / task / "starts" / str(trial), task, wanted, seconds)
    return _plateau_table.write(task, root / task / "starts")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", metavar="TASK", help=f"of {', '.join(TASKS)}")
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--seconds", type=float, help="budget of each run, instead of the task's")
    parser.add_argument("--folder", type=Path, help="where the runs go (default: a new folder)")
    chosen = parser.parse_args()
    strange = [task for task in chosen.tasks if task not in TASKS]
    if strange:
        parser.error(f"{strange[0]}: no such task; valid: {', '.join(TASKS)}")
    root = chosen.folder or Path(tempfile.mkdtemp(prefix="isas-plateau-"))
    RESULTS.mkdir(exist_ok=True)
    for task in chosen.tasks or TASKS:
        print(compared(task, root, chosen).to_string(index=False), flush=True)


if __name__ == "__main__":
    main()
