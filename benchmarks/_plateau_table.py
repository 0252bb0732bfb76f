"""Tables and curves of PRDPT's six tasks, from the records of `_plateau.py`'s races.

Per task results/plateau_<task>.csv (a row per method: medians and quartiles over the starts),
plateau_<task>_runs.csv (a row per run) and plateau_<task>_curves.csv (error against billed time);
of all tasks measured so far plateau_errors.png. The page of these is `_page_plateau.py`'s.

    python benchmarks/_plateau_table.py FOLDER TASK…    (anew, from the races in FOLDER)
"""

from __future__ import annotations

import argparse
from collections.abc import Collection
from pathlib import Path

import numpy as np
import pandas
from scipy.optimize import linear_sum_assignment

RESULTS = Path(__file__).parent / "results"
TASKS = ("cup", "shadows", "occlusion", "global_illumination", "sort", "caustic")
ORDER = ("plateau", "plateau_drawn", "plateau_joint", "plateau_loss", "plateau_renderer", "mitsuba")
ORDER += ("finite_differences", "finite_differences_wide")
QUARTILES = {"_low": 0.25, "": 0.5, "_high": 0.75}
GRID = np.linspace(0, 1, 26)  # of the budget
# Of a run that failed: what it left is of no use.
LOST = ("image_mse", "parameter_mse", "share_of_start", "together", "sorted_mse")
WORST = dict.fromkeys(LOST, np.inf) | {"filled": 0, "unfilled": 75}


def sorted_cubes(run) -> dict:
    """Of a run of sort, ``in_place`` at its end and at its start."""
    from isas_cli import records

    spec = run.config["scene"]["unknowns"]["cubes.place"]["start"]
    arrays, _ = records.load_checkpoint(run.folder)
    # As `isas_cli.unknowns.specs` draws it.
    start = np.random.default_rng(spec["seed"]).uniform(*spec["uniform"], 150)
    first, last = in_place(start), in_place(arrays["value/cubes.place"])
    at_start = {f"{name}_at_start": first[name] for name in ("filled", "sorted_mse")}
    return last | at_start


def in_place(offsets: np.ndarray) -> dict:
    """Of 75 cubes at ``offsets (150,)`` from their own places: how many places hold a cube of their
    colour (at most half a side away, each cube at one place only), and the squared distance to a
    place, per coordinate, when every cube has that place of its colour which makes it least in
    all."""
    from isas_cli.scenes import sort

    places = sort.places().reshape(3, 25, 2)
    cubes = places + np.reshape(offsets, (3, 25, 2))
    apart = np.linalg.norm(places[:, :, None] - cubes[:, None], axis=-1)
    near = apart < sort.SIDE / 2
    squares = [group[linear_sum_assignment(group)] for group in apart**2]
    return {
        "filled": (filled := sum(int(g[linear_sum_assignment(~g)].sum()) for g in near)),
        "unfilled": len(places) * 25 - filled,
        "sorted_mse": float(np.mean(squares)) / 2,
    }


def shares(history: pandas.DataFrame) -> pandas.DataFrame:
    """Errors over those at the start, of every unknown by itself: units do not mix."""
    columns = [name for name in history if name.startswith("parameter_rmse/")]
    found = history[columns] / history[columns].iloc[0]
    return found.rename(columns=lambda name: name.partition("/")[2])


def together(found: pandas.DataFrame) -> np.ndarray:
    """One number for all unknowns: the root mean square of their shares."""
    return np.sqrt(np.square(found).mean(axis=1)).to_numpy()


def finished(folder: Path) -> tuple[pandas.DataFrame, np.ndarray]:
    """A row per run: method, trial, errors at start and end, iterations, billed seconds; and the
    shares of the start's error on ``GRID``, ``(runs, 26)``: of the parameters', and for sort, whose
    cubes may be at each other's places, of the image's."""
    from isas_cli import records

    rows, curves = [], []
    # What an interrupted race began is raced anew.
    begun = sorted(path.relative_to(folder) for path in folder.rglob("summary.json"))
    folders = [folder / path.parent for path in begun if ".unfinished/" not in path.as_posix()]
    for path in sorted(folders, key=lambda p: ORDER.index(p.name.rsplit("_", 2)[0])):
        run = records.load(path)
        if run.summary["status"] not in ("done", "numerical failure"):
            raise SystemExit(f"{path}: {run.summary['status']}; see its summary.json")
        history, (first, last) = run.history, run.history.iloc[[0, -1]].to_dict("records")
        method, factor, trial = path.name.rsplit("_", 2)
        each = shares(history)
        is_sort = run.config["scene"]["name"] == "sort"
        own = sorted_cubes(run) if is_sort else {}
        share = together(each)
        failed = run.summary["status"] != "done"
        # An evaluation stands until the next; the last is due at the end of the budget.
        budget = run.config["budget"]["seconds"]
        last_before = np.searchsorted(history["seconds"] / budget, GRID, side="right") - 1
        last_before[-1] = len(history) - 1
        image = history["image_rmse"].to_numpy()
        curves.append((image / image[0] if is_sort else share)[last_before])
        row = {"method": method, "factor": float(factor), "trial": int(trial), "budget": budget}
        row |= {"iterations": int(last["iteration"]), "seconds": last["seconds"]}
        row |= {"start_mse": first["parameter_rmse"] ** 2, "image_mse": last["image_rmse"] ** 2}
        row |= {"parameter_mse": last["parameter_rmse"] ** 2}
        row |= {"share_of_start": share[-1]}
        # All numbers as they are, whatever their units.
        row |= {"together": last["parameter_rmse"] / first["parameter_rmse"]}
        row |= {f"share/{key}": value for key, value in each.iloc[-1].items()}
        rows.append(row | own)
        if failed:
            rows[-1] |= {name: WORST[name] for name in WORST if name in rows[-1]}
            curves[-1][-1] = np.inf
    return pandas.DataFrame(rows), np.array(curves)


def times(found: pandas.DataFrame, curves: np.ndarray) -> np.ndarray:
    """Of every run, the share of the budget from which on it stays at or below what `plateau` has
    at the end from the same start; infinite where it does not, NaN where that end is no nearer
    than the start."""
    final = {
        t: curve[-1]
        for m, t, curve in zip(found["method"], found["trial"], curves)
        if m == "plateau"
    }
    reached = np.full(len(found), np.inf)
    for i, trial in enumerate(found["trial"]):
        above = np.flatnonzero(curves[i] > final[trial])
        first = above[-1] + 1 if len(above) else 0
        reached[i] = GRID[first] if first < len(GRID) else np.inf
    gone = np.array([not final[trial] < 1 for trial in found["trial"]])
    return np.where(gone, np.nan, reached)


def paces(found: pandas.DataFrame) -> pandas.Series:
    """Of every run, billed time an iteration over that of `plateau` from the same start."""
    pace = found["seconds"] / found["iterations"]
    own = found["method"] == "plateau"
    base = dict(zip(found["trial"][own], pace[own]))
    return pace / found["trial"].map(base)


def table(task: str, found: pandas.DataFrame) -> pandas.DataFrame:
    """A row per method: medians and quartiles over the starts."""
    rows = []
    measures = ["image_mse", "parameter_mse", "share_of_start", "time", "pace"]
    measures += ["filled", "filled_at_start", "sorted_mse", "sorted_mse_at_start", "start_mse"]
    measures += ["together"]
    for method, own in found.groupby("method", sort=False):
        row = {"task": task, "method": method, "budget": own["budget"].iloc[0]}
        row |= {"factor": own["factor"].iloc[0], "starts": len(own)}
        for name in (name for name in measures if name in own):
            known = own[name].dropna()
            for suffix, level in QUARTILES.items():
                # An order statistic: a time may be infinite.
                value = np.quantile(known, level, method="nearest") if len(known) else np.nan
                row[name + suffix] = value
        row["within_1_percent"] = int((own["share_of_start"] < 0.01).sum())
        row["together_within_1_percent"] = int((own["together"] < 0.01).sum())
        row["within_5_percent"] = int((own["share_of_start"] < 0.05).sum())
        row["iterations"] = own["iterations"].median()
        row["seconds_per_iteration"] = (own["seconds"] / own["iterations"]).median()
        row["seconds"] = own["seconds"].median()
        row["failed"] = int(np.isinf(own["share_of_start"]).sum())
        rows.append(row)
    return pandas.DataFrame(rows)


def save(task: str, what: str, rows: pandas.DataFrame, added: str | None) -> None:
    """Writes plateau_<task>_<what>.csv, or, of the method ``added``, its rows into it."""
    path = RESULTS / f"plateau_{task}{what and f'_{what}'}.csv"
    if added is not None:
        before = pandas.read_csv(path)
        rows = rows[rows["method"] == added]
        rows = pandas.concat([before[before["method"] != added], rows])
        rows = rows.sort_values("method", key=lambda own: own.map(ORDER.index), kind="stable")
    rows.to_csv(path, index=False, float_format="%.4g")


def write(task: str, folder: Path, added: str | None = None) -> pandas.DataFrame:
    """The task's three files, and those of all tasks; see ``save``. Returns the row per method of
    the races in ``folder``."""
    found, curves = finished(folder)
    found["time"], found["pace"] = times(found, curves), paces(found)
    if added is not None:
        before = pandas.read_csv(RESULTS / f"plateau_{task}_runs.csv")
        both = before.merge(found, on=["method", "trial"])
        if not np.allclose(both["start_mse_x"], both["start_mse_y"], rtol=0.05):
            raise SystemExit(
                f"{task}: errors at the start are others than in its table, whose rows were raced "
                "before their unit changed: race the whole task, without --add"
            )
    save(task, "runs", found, added)
    wide = pandas.DataFrame(curves, columns=[f"{share:.2f}" for share in GRID])
    wide.insert(0, "method", found["method"])
    rows = []
    for level in QUARTILES.values():
        middle = wide.groupby("method", sort=False).quantile(level).reset_index()
        middle.insert(1, "quartile", level)
        rows.append(middle)
    save(task, "curves", pandas.concat(rows), added)
    made = table(task, found)
    save(task, "", made, added)
    draw([t for t in TASKS if (RESULTS / f"plateau_{t}.csv").exists()])
    return made


def draw(tasks: list[str]) -> None:
    """results/plateau_errors.png: the share of the start's error against the share of the budget,
    median and quartiles over the starts."""
    from isas_cli.report.figures import COLOURS, figure, save, styled

    with styled():
        canvas = figure(11, 3.2 * ((len(tasks) + 2) // 3))
        panels = canvas.subplots((len(tasks) + 2) // 3, 3, squeeze=False).ravel()
        # More methods than colours: the last are dashed.
        looks = {
            method: {"color": COLOURS[i % len(COLOURS)], "ls": "--" if i >= len(COLOURS) else "-"}
            for i, method in enumerate(ORDER)
        }
        shown = {}
        for axes, task in zip(panels, tasks):
            curves = pandas.read_csv(RESULTS / f"plateau_{task}_curves.csv")
            for method, own in curves.groupby("method", sort=False):
                low, middle, high = (
                    own[own["quartile"] == level].iloc[0, 2:].to_numpy(float)
                    for level in QUARTILES.values()
                )
                (shown[method],) = axes.plot(GRID, middle, **looks[method])
                axes.fill_between(GRID, low, high, color=looks[method]["color"], alpha=0.15, lw=0)
            title = "sort (image)" if task == "sort" else task
            axes.set(yscale="log", title=title, xlabel="share of the budget")
            if task != "sort":
                axes.axhline(0.01, color="grey", lw=0.8, ls=":")
        panels[0].set_ylabel("error / error at the start")
        names = [method for method in ORDER if method in shown]
        lines = [shown[method] for method in names]
        canvas.legend(lines, names, loc="outside lower center", ncols=4, fontsize=8)
        for axes in panels[len(tasks) :]:
            axes.set_axis_off()
        save(canvas, RESULTS / "plateau_errors.png")


def asked(parser: argparse.ArgumentParser, tasks: Collection[str] = TASKS) -> argparse.Namespace:
    """What was typed, with the ``tasks`` that it names, or all."""
    parser.add_argument("tasks", nargs="*", metavar="TASK", help=f"of {', '.join(tasks)}")
    chosen = parser.parse_args()
    if strange := [task for task in chosen.tasks if task not in tasks]:
        parser.error(f"{strange[0]}: no such task; valid: {', '.join(tasks)}")
    chosen.tasks = chosen.tasks or list(tasks)
    return chosen


def main() -> None:
    import pages  # knows this module

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of the races")
    parser.add_argument("tasks", nargs="+", choices=TASKS)
    chosen = parser.parse_args()
    for task in chosen.tasks:
        print(write(task, chosen.folder / task / "starts").to_string(index=False))
    pages.write()


if __name__ == "__main__":
    main()
