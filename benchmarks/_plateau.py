"""PRDPT's six tasks: every method from many starts, at equal billed time.

Per task a search for each method's rate, a factor on all of the task's rates: three factors (four
where few steps fit the budget) from three more starts (six of global_illumination; the same for all
methods), and where the smallest or the largest of them is best, two farther ones beside it, once.
Best is what gets within 1 % of the start's error from most starts, then the least median: single
runs differ by more than neighbouring factors do. Then all starts at the best. Runs from one start
take turns in one process. Where a method finds no slope, the factor that moves least may look best;
the tables of the search are kept.

The budget is billed time, so that methods differ in iterations: both are in the table. The paper
gives all the same number of iterations. Variants have five starts, the others twenty, sort five of
each. Widths, pixels, paths and the schedule of the rates were chosen for the plateau-reduced
gradient, on other starts; of global_illumination the schedule with its first twenty starts in view
too, so that it is judged on twenty others. All methods that draw pixels have the same of them and
as many paths of each (3 times as many in all, by separate pairs 3 per entry of the unknowns, 4 with
smooth=loss, 4 per entry by finite differences); Mitsuba's render whole images, at least one path a
pixel.

Writes results/plateau_<task>_rates.csv, the search, the tables (`_plateau_table.py`) and
their page.

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
import pages
import pandas

RESULTS = _plateau_table.RESULTS
COMMON = ["evaluation.count=20", "report=false", "frames.views=0", "frames.snapshots=0"]
COMMON += ["evaluation.pixels=4096", "evaluation.spp=16", "~scene.method"]
METHODS = {
    "plateau": ["sampler=plateau"],
    "plateau_loss": ["sampler=plateau", "sampler.smooth=loss"],
    "plateau_drawn": ["sampler=plateau", "sampler.base=differences"],
    "plateau_renderer": ["sampler=plateau", "sampler.gradient=renderer"],
    "mitsuba": ["sampler=mitsuba"],
    "finite_differences": ["sampler=finite_differences"],
    # Steps between the first and the last width, for whom those are no use.
    "finite_differences_wide": ["sampler=finite_differences"],
    # Where the others' scheme is another.
    "plateau_joint": ["sampler=plateau"],
}
RENDERED = ("mitsuba", "plateau_renderer")  # whole images, by Mitsuba
FACTORS = (0.3, 1.0, 3.0)
FEW_STEPS = (*FACTORS, 10.0)  # of those
BEYOND = {0.3: (0.03, 0.1), 3.0: (10.0, 30.0), 10.0: (30.0, 100.0)}  # where an end is best
VARIANTS = ("plateau_joint", "plateau_loss", "plateau_renderer", "finite_differences_wide")
FEW = 5  # starts of variants, and of sort
SEARCH = (101, 102, 103)  # trials that rates are chosen on, none of the starts
MORE_SEARCH = (*SEARCH, 104, 105, 106)


@dataclass(frozen=True)
class Task:
    """``seconds``: the budget of a run.

    ``spread``: key → half the width of the interval around the configured start that starts are
    drawn from, per entry; None: the scene's own random start, with another seed.
    ``pixels`` drawn a step, ``spp`` paths of each in one rendering; ``target_spp``: of the targets.
    ``schedule`` of the rates, and the share ``final`` of them that is left.
    ``step`` of `finite_differences_wide`, in last widths.
    ``scheme`` of the plateau-reduced gradients by plain renderings.
    ``search``: the trials that rates are chosen on; ``first`` of those that methods are judged on.
    ``whole``: variants that are judged on all of these.
    """

    seconds: float
    spread: dict[str, float] | None
    pixels: int = 2048
    spp: int = 4
    target_spp: int = 8192
    schedule: str = "cosine"
    final: float = 0.01
    step: float = 10
    scheme: str = "joint"
    search: tuple[int, ...] = SEARCH
    first: int = 1
    whole: tuple[str, ...] = ()
    methods: tuple[str, ...] = tuple(method for method in METHODS if method != "plateau_joint")


TASKS = {
    "occlusion": Task(4, {"red.depth": 0.5}),
    "shadows": Task(8, {"ball.place": 0.15}, pixels=1024, spp=8, step=7),
    "cup": Task(7, {"cup.angle": 9.0}, step=17),
    "caustic": Task(
        20,
        {"lamp.place": 0.4},
        pixels=1024,
        spp=32,
        step=3,
        scheme="separate",
        # The scheme was thought over with the first twenty in view.
        first=21,
        whole=("plateau_joint",),
        methods=tuple(METHODS),
    ),
    "sort": Task(
        30,
        None,
        pixels=4096,
        spp=2,
        target_spp=1024,
        schedule="exponential",
        final=0.02,
        # No finite differences: 150 unknowns, 300 renderings a step.
        methods=("plateau", "plateau_drawn", "plateau_renderer", "mitsuba"),
    ),
    "global_illumination": Task(
        20,
        {"lamp.place": 0.1, "box.angle": 5.0, "left.bsdf.base_color.value": 0.1},
        pixels=1024,
        spp=8,
        scheme="separate",
        # Lamp and wall trade with each other: a rate that falls by a cosine is too slow along that
        # valley from some starts, or too fast at its end.
        schedule="exponential",
        search=MORE_SEARCH,
        # Rates and schedule were thought over with the first twenty in view.
        first=21,
        methods=(
            *("plateau", "plateau_drawn", "plateau_joint", "plateau_renderer"),
            *("mitsuba", "finite_differences"),
        ),
    ),
}


@functools.cache
def composed(task: str, method: str, seconds: float):
    """The configuration of a method's runs, as it is before rates and starts."""
    from isas_cli.config.compose import compose, translate

    own = TASKS[task]
    settings = [f"scene={task}", f"budget.seconds={seconds}", *COMMON]
    settings += [f"optimizer.schedule={own.schedule}", f"optimizer.final={own.final}"]
    settings += [f"target.spp={own.target_spp}"]
    if method in RENDERED:
        settings += [f"estimator.batch={own.pixels * own.spp}"]
    else:
        settings += [f"estimator.batch={own.pixels}", f"sampler.spp={own.spp}"]
    if method == "finite_differences_wide":
        settings += [f"sampler.step={own.step}"]
    settings += METHODS[method]
    if method in ("plateau", "plateau_drawn", "plateau_loss"):
        settings += [f"sampler.scheme={own.scheme}"]
    return compose(translate(settings))


def configured(task: str, method: str, trial: int, factor: float, seconds: float):
    """The configuration of one run: its start drawn by ``trial``, all rates times ``factor``."""
    own, cfg = TASKS[task], copy.deepcopy(composed(task, method, seconds))
    cfg.name, cfg.seed = f"trial{trial}", trial
    # Not the unknowns' own rates: they are the scene's, and another scene would be built.
    cfg.optimizer.factor = float(factor)
    rng = np.random.default_rng(2000 + trial)  # tuned on others
    for key, unknown in cfg.scene.unknowns.items():
        if own.spread is None:
            unknown.start.seed = 1000 + trial  # tuned on smaller ones
            continue
        start = np.atleast_1d(np.asarray(unknown.start, float))
        start = start + own.spread[key] * rng.uniform(-1, 1, start.size)
        unknown.start = float(start[0]) if start.size == 1 else start.tolist()
    return cfg


def _lanes(folder: Path, task: str, wanted: list[tuple[str, float, int]], seconds: float) -> None:
    """``wanted``: method, factor on the rates, trial."""
    from isas_cli.engine import race
    from isas_cli.runtime import backend, interrupt

    backend.start()
    entries = []
    for method, factor, trial in wanted:
        label = f"{method}_{factor:g}_{trial}"
        cfg = configured(task, method, trial, factor, seconds)
        entries.append(race.Entry(label, cfg, folder / label))
    status = race.run(entries, 1.0, lambda: None)
    if status == interrupt.STATUS:
        raise SystemExit(status)


def race(folder: Path, task: str, wanted: list[tuple[str, float, int]], seconds: float) -> None:
    """``_lanes`` in a process of its own; not again where ``folder`` has what an earlier call
    finished. All runs of one race begin at the same place, so that they share one scene: several in
    a process slow down each other's kernels, those that are not frozen most."""
    from omegaconf import OmegaConf

    settings = "\n".join(
        OmegaConf.to_yaml(configured(task, method, trial, factor, seconds))
        for method, factor, trial in wanted
    )
    kept = folder / "settings.yaml"
    if folder.exists():
        if not kept.exists() or kept.read_text() != settings:
            raise SystemExit(f"{folder}: of other settings; move it away to race anew")
        return
    unfinished = folder.with_name(f"{folder.name}.unfinished")
    shutil.rmtree(unfinished, ignore_errors=True)
    child = multiprocessing.get_context("spawn").Process(
        target=_lanes, args=(unfinished, task, wanted, seconds)
    )
    child.start()
    child.join()
    if child.exitcode:
        raise SystemExit(child.exitcode)
    (unfinished / kept.name).write_text(settings)
    unfinished.rename(folder)


def best(found: pandas.DataFrame) -> dict[str, float]:
    """Each method's best factor: from most starts within 1 % of the start's error, where these are
    as many the least median of it; of sort the least median of the places not filled, where these
    are as many of the distances."""
    # A cube that never moves is not far from a place of its colour: places filled come first.
    if "unfilled" in found:
        judged = found.groupby(["method", "factor"])[["unfilled", "sorted_mse"]].median()
    else:
        # By the median alone, a rate may win at which some starts do not arrive.
        rows = found.assign(far=found["share_of_start"] >= 0.01).groupby(["method", "factor"])
        judged = rows.agg(far=("far", "mean"), share=("share_of_start", "median"))
    judged = judged.sort_values(list(judged)).reset_index()
    return dict(judged.groupby("method")["factor"].first())


def searched(
    task: str, root: Path, seconds: float, methods: tuple[str, ...]
) -> tuple[dict[str, float], pandas.DataFrame]:
    """Each method's best factor, and the runs that say so."""
    factors = {m: FEW_STEPS if m in RENDERED else FACTORS for m in methods}

    def raced(name: str, wanted: list) -> pandas.DataFrame:
        for trial in TASKS[task].search:
            runs = [(method, factor, trial) for method, factor in wanted]
            race(root / task / name / str(trial), task, runs, seconds)
        return _plateau_table.finished(root / task / name)[0]

    found = raced("rates", [(m, f) for m in methods for f in factors[m]])
    chosen = best(found)
    # With the end itself once more: what fewer runs side by side get done differs.
    if ends := [m for m in methods if chosen[m] in (factors[m][0], factors[m][-1])]:
        more = raced(
            "rates_beyond", [(m, f) for m in ends for f in (chosen[m], *BEYOND[chosen[m]])]
        )
        chosen |= best(more)
        found = pandas.concat([found, more], ignore_index=True)
    return chosen, found


def compared(task: str, root: Path, chosen: argparse.Namespace) -> pandas.DataFrame:
    """Both races of a task and what is kept of them."""
    seconds = chosen.seconds or TASKS[task].seconds
    methods, added = TASKS[task].methods, chosen.add
    few, variants = min(chosen.starts, FEW), set(VARIANTS) - set(TASKS[task].whole)
    starts = {m: few if task == "sort" or m in variants else chosen.starts for m in methods}
    rate = {}
    if chosen.again or added:
        table = pandas.read_csv(RESULTS / f"plateau_{task}.csv")
        rate = dict(table.set_index("method")["factor"])
    if added or not chosen.again:
        best_of, found = searched(task, root, seconds, (added,) if added else methods)
        rate |= best_of
        _plateau_table.save(task, "rates", found, added)
    if added:
        # Beside one that the tables have: whether the machine is as it was is printed.
        methods = "plateau", added
        starts = dict.fromkeys(methods, starts[added])
    for nth in range(chosen.starts):
        trial = TASKS[task].first + nth
        wanted = [(m, rate[m], trial) for m in methods if nth < starts[m]]
        if wanted:
            race(root / task / "starts" / str(trial), task, wanted, seconds)
    return _plateau_table.write(task, root / task / "starts", added)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--seconds", type=float, help="budget of each run, instead of the task's")
    parser.add_argument("--again", action="store_true", help="at the rates of the table, no search")
    parser.add_argument("--add", choices=VARIANTS, help="this alone, to the tables as they are")
    parser.add_argument("--folder", type=Path, help="where the runs go (default: a new folder)")
    chosen = _plateau_table.asked(parser, TASKS)
    if chosen.add and chosen.again:
        parser.error("--add searches the method's rate, and --again none: one of them")
    if strange := [t for t in chosen.tasks if chosen.add and chosen.add not in TASKS[t].methods]:
        parser.error(f"--add {chosen.add}: not raced on {', '.join(strange)}: name tasks")
    root = chosen.folder or Path(tempfile.mkdtemp(prefix="isas-plateau-"))
    for task in chosen.tasks:
        print(compared(task, root, chosen).to_string(index=False), flush=True)
        pages.write()


if __name__ == "__main__":
    main()
