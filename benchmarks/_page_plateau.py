"""What plateau.md says, from the tables of the races on PRDPT's tasks and of what they rest on."""

from __future__ import annotations

from pathlib import Path

import _plateau_paper
import _ranges
import numpy as np
import pandas
from _plateau_table import GRID, TASKS

RENDERER = "plateau_renderer"
SHOWN = ("plateau", "plateau_drawn", "mitsuba", "finite_differences")
ARRIVED = 0.01  # share of the start's error that is left
EIGHT = 8  # what the paper says that the baseline's iteration costs, in its own
# Where the paper shows a task, and what is known of κ∂P where our tables have none.
SHOWN_IN = {"cup": "fig. 1, 4", "shadows": "fig. 4", "global_illumination": "fig. 4"}
UNRACED = {
    "global_illumination": "not kept: once, in errors of another unit, it left more (five starts)"
}


def facts(results: Path) -> dict:
    tables = {task: _table(results, task) for task in TASKS}
    by = {
        task: {row["method"]: row for row in rows.to_dict("records")}
        for task, rows in tables.items()
    }
    paces = {task: rows["mitsuba"]["pace"] for task, rows in by.items()}
    drawn, cost = offsets(results / "plateau_offsets.csv"), costs(results)
    iterations = as_many_iterations(results)
    paired = {task: beside_renderer(results, task) for task in TASKS if RENDERER in by[task]}
    compared = dict.fromkeys(row["task"] for row in drawn)
    return {
        "claims": claims(by, drawn, cost["uniform"], paired, iterations),
        "there": [task for task in by if task != "sort"],  # where a start can arrive
        "mitsuba_behind": [
            task
            for task, rows in by.items()
            if _ranges.apart(rows["mitsuba"], rows["plateau"], "share_of_start") == _ranges.ABOVE
        ],
        "no_offsets": [task for task in TASKS if task not in compared],
        "overview": overview(tables),
        "details": details(tables),
        "paper": _plateau_paper.beside(by),
        "by": by,
        "settled": {task: settled(results, task) for task in by},
        "paces": paces,
        "reached_eight": [task for task, pace in paces.items() if pace >= EIGHT],
        "iterations": iterations,
        "sort": of_sort(results, by["sort"]),
        "cost": cost,
        "variance": variances(results / "plateau_variance.csv"),
        "residual": variances(results / "plateau_residual.csv"),
        "offsets": drawn,
        "authors": authors(results / "prdpt_shadows.csv"),
        "black_box": black_box(results / "black_box.csv"),
    }


def _table(results: Path, task: str) -> pandas.DataFrame:
    """Of a task's methods, with a mark where the best rate was an end of those tried."""
    table, rates = (
        pandas.read_csv(results / f"plateau_{task}{end}.csv").assign(task=task)
        for end in ("", "_rates")
    )
    return _ranges.marked(table, rates, ("task", "method"))


def beside_renderer(results: Path, task: str) -> dict:
    """Of the starts that `plateau` and `plateau_renderer` share: from how many the first ends
    nearer, and the median of both; of sort by places that are not filled."""
    runs = pandas.read_csv(results / f"plateau_{task}_runs.csv")
    measure = "unfilled" if task == "sort" else "share_of_start"
    left = runs.pivot(index="trial", columns="method", values=measure)
    left = left[["plateau", RENDERER]].dropna()
    found = {"nearer": int((left["plateau"] < left[RENDERER]).sum()), "of": len(left)}
    return found | {"medians": list(left.median())}


def claims(
    by: dict[str, dict],
    drawn: list[dict],
    cost: dict[str, float],
    paired: dict[str, dict],
    iterations: dict[str, list[float]],
) -> list[dict]:
    """The paper's claims that were measured, by task: where they stand there, what is left of
    `plateau`, of the rival, and whether the claim ``holds``. Of sort, whose cubes are alike, by
    places that are filled. ``drawn``: see ``offsets``; ``cost``: of a step of Mitsuba's with as
    many pixels; ``paired``: see ``beside_renderer``; ``iterations``: ``as_many_iterations``."""
    found = []

    def add(where: str, claim: str, task: str, ours: str, theirs: str, holds: bool | str) -> None:
        word = holds if isinstance(holds, str) else ("yes" if holds else "no")
        row = {"where": where, "claim": claim, "task": task, "ours": ours, "theirs": theirs}
        found.append(row | {"holds": word})

    def left(row: dict) -> str:
        below = f"{row['within_1_percent']} of {row['starts']}"
        return f"{row['share_of_start']:.2g}{row['mark']}, {below}"

    for task, rows in by.items():
        ours, theirs = rows["plateau"], rows["mitsuba"]
        where = SHOWN_IN.get(task, "fig. 5")
        claim = "arrives where the path tracer's derivative does not"
        if task == "sort":
            both = [f"{row['filled']:.0f} of 75" for row in (ours, theirs)]
            add(where, claim, task, *both, ours["filled_low"] > theirs["filled_high"])
        else:
            there = [row["share_of_start"] < ARRIVED for row in (ours, theirs)]
            add(where, claim, task, left(ours), left(theirs), there == [True, False])
    for task, shares in iterations.items():
        ours, claim = by[task]["plateau"], "and does not with as many iterations either"
        holds = ours["share_of_start"] < ARRIVED <= min(shares)
        told = " and ".join(f"{share:.2g}" for share in shares)
        add("§4", claim, task, left(ours), told, holds)
    for measure, what in (("parameter_mse", "parameter"), ("image_mse", "image")):
        claim = f"its squared {what} error is lower by orders of magnitude (here: 100 times)"
        for task, rows in by.items():
            ours, theirs = (rows[name][measure] for name in ("plateau", "mitsuba"))
            add("tab. 1", claim, task, f"{ours:.1e}", f"{theirs:.1e}", 100 * ours <= theirs)
    claim = "blurring the renderer's derivative (κ∂P) is notably worse"
    for task in by:
        if task not in paired:
            add("tab. 1", claim, task, "–", UNRACED.get(task, "not raced"), "cannot be told")
            continue
        both = paired[task]
        marks = [by[task][name]["mark"] for name in ("plateau", RENDERER)]
        told = [f"{share:.2g}{mark}" for share, mark in zip(both["medians"], marks)]
        if task == "sort":
            told = [f"{75 - share:.0f} of 75{mark}" for share, mark in zip(both["medians"], marks)]
        nearer = f"from {both['nearer']} of {both['of']} starts"
        told = [f"{each}, of the same starts" for each in told]
        add("tab. 1", claim, task, *told, both["nearer"] == both["of"] or nearer)
    for way, claim in (
        ("uniform", "uniform offsets have a larger variance than importance-sampled ones"),
        ("independent", "so have offsets on both sides that are not each other's opposites"),
    ):
        for task in dict.fromkeys(row["task"] for row in drawn):
            own = {row["progress"]: row[way] for row in drawn if row["task"] == task}
            told = " and ".join(f"{ratio:.1f}" for ratio, *_ in own.values())
            add("§3.2", claim, task, "1", told, larger(own))
    raced = float(np.mean([rows["mitsuba"]["pace"] for rows in by.values()]))
    alike = float(np.mean(list(cost.values())))
    claim = "an iteration of Mitsuba takes 8 times as long, on average"
    told = f"{alike:.1f} with as many pixels, {raced:.1f} in the races"
    one_way = (alike >= EIGHT) == (raced >= EIGHT)
    add("§4", claim, "all, mean", "1", told, alike >= EIGHT if one_way else "depends on the paths")
    return found


def larger(own: dict[float, list[float]]) -> bool | str:
    """Whether ratios are above 1 by their intervals; ``own``: ratio, low, high by the share of the
    budget."""
    above = [f"{share:g}" for share, (_, low, _) in own.items() if low > 1]
    if above and len(above) < len(own):
        return f"at {' and '.join(above)} of the budget alone"
    if all(high < 1 for *_, high in own.values()):
        return "no, the other way round"
    return bool(above) or "level (intervals hold 1)"


def black_box(path: Path) -> list[dict]:
    """Of each way with another renderer, at its best factor and with the seeds that did not choose
    it, the share of the start's error that is left: median, least, most; and its iterations."""
    table, rows = pandas.read_csv(path), []
    judging = table[table["seed"] != table["seed"].iloc[0]]
    for way, own in judging.groupby("way", sort=False):
        left = own["end"] / own["start"]
        row = {"way": way, "factor": own["factor"].iloc[0], "seeds": len(own)}
        row |= {"left": left.median(), "low": left.min(), "high": left.max()}
        row["factors"] = sorted(float(each) for each in table["factor"].unique())
        row["at_end"] = row["factor"] in (row["factors"][0], row["factors"][-1])
        rows.append(row | {"iterations": int(own["iterations"].median())})
    return rows


def offsets(path: Path) -> list[dict]:
    """By task and share of the budget, of each other way to draw a pair's offsets the variance over
    that of ours: ratio, low, high."""
    rows = []
    for (task, progress), own in pandas.read_csv(path).groupby(["task", "progress"], sort=False):
        row = {"task": task, "progress": progress}
        for side in own[own["side"] != "separate"].to_dict("records"):
            row[side["side"]] = [
                1 / side[key] for key in ("variance", "variance_high", "variance_low")
            ]
        rows.append(row)
    return rows


def authors(path: Path) -> list[dict]:
    """Of each way on the authors' own shadows scene the median, least and most squared parameter
    error, iterations, and of each goal how many seeds reach it and in the median after which share
    of the budget and how many iterations."""
    rows = []
    for way, own in pandas.read_csv(path).groupby("way", sort=False):
        row = {"way": way.partition(", a third")[0], "seeds": len(own)}
        row["seconds"] = own["seconds"].iloc[0]
        row["end"] = [own["end"].median(), own["end"].min(), own["end"].max()]
        # Tables of before do not have it.
        row["image"] = own["image_rmse"].median() if "image_rmse" in own else None
        row["iterations"] = int(own["iterations"].median())
        for goal in ("0.001", "1e-05"):
            reached = own[[f"seconds_{goal}", f"iterations_{goal}"]].dropna()
            share, iterations = reached.median() / [row["seconds"], 1.0]
            row[goal] = (len(reached), share, iterations)
        rows.append(row)
    return rows


def settled(results: Path, task: str, level: float = 0.01) -> dict[str, float]:
    """Of each method, the share of the budget from which the median error stays below ``level`` of
    the start's; infinite where it does not."""
    curves = pandas.read_csv(results / f"plateau_{task}_curves.csv")
    found = {}
    for row in curves[curves["quartile"] == 0.5].itertuples(index=False):
        above = np.flatnonzero(np.array(row[2:], float) >= level)
        first = above[-1] + 1 if above.size else 0
        found[row.method] = GRID[first] if first < len(GRID) else np.inf
    return found


def as_many_iterations(results: Path) -> dict[str, list[float]]:
    """Of each task and start, what Mitsuba's derivative leaves at the best factor tried."""
    table = pandas.read_csv(results / "plateau_iterations.csv")
    best = table.groupby(["task", "trial"], sort=False)["share_of_start"].min()
    return {task: list(best[task]) for task in dict.fromkeys(table["task"])}


def of_sort(results: Path, rows: dict[str, dict]) -> dict:
    """Places filled start by start, and until when Mitsuba's median is ahead."""
    runs = pandas.read_csv(results / "plateau_sort_runs.csv")
    curves = pandas.read_csv(results / "plateau_sort_curves.csv")
    middle = curves[curves["quartile"] == 0.5].set_index("method").iloc[:, 1:]
    ahead = np.flatnonzero(middle.loc["mitsuba"].to_numpy() < middle.loc["plateau"].to_numpy())
    return {
        "filled": {m: list(own["filled"].astype(int)) for m, own in runs.groupby("method")},
        "ahead_until": GRID[ahead[-1]] if ahead.size else 0.0,
        "apart": {m: np.sqrt(row["sorted_mse"]) for m, row in rows.items()},
        "apart_at_start": np.sqrt(rows["plateau"]["sorted_mse_at_start"]),
    }


def costs(results: Path) -> dict[str, dict[str, float]]:
    """Per side, task → time of a step over that of `plateau`: medians over the rounds."""
    found: dict[str, dict[str, float]] = {}
    for name in ("plateau_cost", "plateau_cost_guided"):
        table = pandas.read_csv(results / f"{name}.csv")
        for task, rows in table.groupby("task", sort=False):
            wide = rows.pivot(index="round", columns="side", values="seconds")
            for side in wide.columns.drop("plateau"):
                ratio = wide[side] / wide["plateau"]
                found.setdefault(side, {})[task] = float(ratio.median())
    return found


def variances(path: Path) -> dict:
    """task → share of the budget → side → its row."""
    found: dict = {}
    for row in pandas.read_csv(path).to_dict("records"):
        found.setdefault(row["task"], {}).setdefault(row["progress"], {})[row["side"]] = row
    return found


def overview(tables: dict[str, pandas.DataFrame]) -> list[str]:
    """A row per task: what is left of the start's error, and from how many starts less than 1 %, or
    how many cubes are in place."""
    made = _head(["task", *(f"`{method}`" for method in SHOWN)])
    for task, rows in tables.items():
        by_method = {row["method"]: row for row in rows.to_dict("records")}
        cells = [f"{task}, {rows['budget'].iloc[0]:.0f} s"]
        for row in (by_method.get(method) for method in SHOWN):
            if row is None:
                cells.append("–")
            elif "filled" in row:
                cells.append(f"{_number(row, 'filled', '.0f')} of 75")
            else:
                below = f"{row['within_1_percent']} of {row['starts']}"
                cells.append(f"{row['share_of_start']:.2g}, {below}")
        made.append(_row(cells))
    return made


def details(tables: dict[str, pandas.DataFrame]) -> list[str]:
    """What is left of the errors: a row per task and method."""
    head = ["task", "method", "rates ×", "starts", "image MSE", "share of the start's error"]
    head += ["below 1 %, or in place", "share of the budget until `plateau`'s error", "iterations"]
    made = _head([*head, "time an iteration / `plateau`'s"])
    for task, rows in tables.items():
        is_sort = "filled" in rows
        for number, row in enumerate(rows.to_dict("records")):
            below = f"{row['within_1_percent']} of {row['starts']}"
            cells = [
                f"{task}, {row['budget']:.0f} s" if number == 0 else "",
                f"`{row['method']}`",
                f"{row['factor']:g}{row['mark']}",
                str(row["starts"]),
                _number(row, "image_mse", ".1e"),
                "" if is_sort else _number(row, "share_of_start", ".2g"),
                _number(row, "filled", ".0f") + " of 75" if is_sort else below,
                "" if is_sort else _number(row, "time", ".2f"),
                f"{row['iterations']:.0f}",
                _number(row, "pace", ".1f"),
            ]
            made.append(_row(cells))
    return made


def _head(names: list[str]) -> list[str]:
    return [_row(names), "|" + "---|" * len(names)]


def _row(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _number(row, name: str, form: str) -> str:
    if name not in row or pandas.isna(row[name]):
        return ""
    found = (row[name], row[name + "_low"], row[name + "_high"])
    middle, low, high = ("–" if np.isinf(x) else format(x, form) for x in found)
    return f"{middle} [{low}, {high}]"
