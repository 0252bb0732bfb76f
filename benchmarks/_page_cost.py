"""What cost.md says: of steps, looks, phases, sizes and records."""

from __future__ import annotations

import itertools
from pathlib import Path

import _ranges
import cost_against_size
import numpy as np
import pandas

FLOOR, TARGETS, GAIN = 1.3, 1 / 6, 0.03  # the goals


def facts(results: Path) -> dict:
    def read(name: str) -> pandas.DataFrame:
        return pandas.read_csv(results / f"{name}.csv")

    shares, phases, looks, growth = map(
        read, ("stage1_share", "phases", "first_look", "cost_against_size")
    )
    turns, runs = read("race"), read("crossed")
    targets, doubled = read("targets"), read("doubled")
    floors = floor(read("step_floor"))
    own = shares[shares["sampler"] == "progress"]
    recording = read("recording").groupby("tracker")
    return {
        "step_time": step_time(read("step_time")),
        "gpu": gpu(read("gpu_steps"), read("gpu_race"), read("gpu_rates")),
        "floor": floors,
        "above_floor": list(dict.fromkeys(row["scene"] for row in floors if row["median"] > FLOOR)),
        "crossed": crossed(read("crossed_estimates"), runs),
        # Tables without a day are by earlier engines; the page says which.
        "day": {
            name: table["day"].max() if "day" in table and table["day"].notna().all() else ""
            for name, table in (
                *(("stage1", shares), ("phases", phases), ("look", looks)),
                *(("sizes", growth), ("crossed", runs)),
            )
        },
        "stage1": {name: list(rows["share"]) for name, rows in shares.groupby("sampler")},
        "first_look": list(own["first_ms"] / own["step_ms"]),
        "begun": begun(looks),
        "half": own["share_half"].max(),
        "phases": {
            scene: dict(zip(rows["phase"], rows["share"]))
            for scene, rows in phases.groupby("scene", sort=False)
        },
        "sizes": sizes(growth),
        "memory": read("memory").to_dict("records"),
        "targets": targets.to_dict("records"),
        "targets_met": list(targets.loc[targets["of_time"] <= TARGETS, "scene"]),
        "doubled": doubled.to_dict("records"),
        "gained": list(doubled.loc[doubled["quotient"] < 1 - GAIN, "scene"]),
        "lost": list(doubled.loc[doubled["quotient"] > 1 + GAIN, "scene"]),
        "beside": itertools.zip_longest,
        "writing": recording["writing_share_of_wall"].max().to_dict(),
        "race": turns.groupby("contestant")["race_over_alone"].median().to_dict(),
        "race_spread": list(turns["race_over_alone"]),
        "race_rounds": len(turns) // turns["contestant"].nunique(),
    }


def step_time(table: pandas.DataFrame) -> list[dict]:
    """Per batch, of each side of ours the ratio to the stock loop: median, least, most."""
    wide = table.pivot(index=["batch", "round"], columns="side", values="seconds")
    rows = []
    for batch, group in wide.groupby("batch"):
        row = {"batch": batch, "rounds": len(group)}
        for side in group.columns.drop("stock"):
            ratio = group[side] / group["stock"]
            row[side] = (ratio.median(), ratio.min(), ratio.max())
        rows.append(row)
    return rows


def gpu(steps: pandas.DataFrame, race: pandas.DataFrame, rates: pandas.DataFrame) -> dict:
    """Whose card, when; ratios of steps; of each race a row per method."""
    rows = _ranges.marked(race, rates, ("scene", "size", "method")).to_dict("records")
    named = {name: steps[name].iloc[0] for name in ("card", "day")}
    return named | {"steps": step_time(steps), "rows": rows}


def begun(table: pandas.DataFrame) -> dict:
    """Runs of first_look.py: by scene and how often the first look of `progress` takes everything,
    its error over `uniform`'s at the shares of the time, a geometric mean over seeds."""
    sides = table.pivot(index=["scene", "seed", "share"], columns="side", values="error")
    ratios = np.log(sides.drop(columns="uniform").div(sides["uniform"], axis=0))
    means = np.exp(ratios.groupby(["scene", "share"], sort=False).mean())
    rows = [
        {"scene": scene, "side": side, "ratios": list(own[side])}
        for scene, own in means.groupby("scene", sort=False)
        for side in means.columns
    ]
    return {"rows": rows, "seconds": table["seconds"].iloc[0], "seeds": table["seed"].nunique()}


def floor(table: pandas.DataFrame) -> list[dict]:
    """Per scene, sampler and batch: the step over its floor, and over Mitsuba's `prb`."""
    rows = []
    for keys, group in table.groupby(["scene", "sampler", "batch"], sort=False):
        own = group["step"] / group["passes"]
        row = dict(zip(("scene", "sampler", "batch"), keys))
        row |= {"median": own.median(), "low": own.min(), "high": own.max()}
        stock = (group["step"] / group["prb"]).dropna()
        row |= {"prb": stock.median() if len(stock) else np.nan}
        rows.append(row)
    return rows


def crossed(estimates: pandas.DataFrame, runs: pandas.DataFrame) -> dict:
    """Of `estimator.crossed`: per scene and unknown, from start to truth; and runs."""
    rows = []
    for (scene, key), own in estimates.groupby(["scene", "key"], sort=False):
        row = {"scene": scene, "key": key, "replayed": own["product, replayed"].notna().all()}
        rows.append(row | {name: list(own[name]) for name in own.columns[3:]})
    seeds = int(runs["seeds"].min())
    return {"estimates": rows, "runs": runs.to_dict("records"), "seeds": seeds}


def sizes(table: pandas.DataFrame) -> list[dict]:
    """Per axis and sampler: first and last size and step, and what lies off theory's line."""
    rows = []
    for axis in cost_against_size.axes(quick=False):
        made = cost_against_size.summary(axis, table[table["axis"] == axis.name])
        for sampler, own in made.groupby("sampler", sort=False):
            own = own.sort_values("size")
            off = own["median"] / own["theory"] - 1
            far = off[off.abs() > cost_against_size.FAR]
            rows.append(
                {
                    "label": axis.label,
                    "theory": axis.theory,
                    "sampler": sampler,
                    "sizes": (own["size"].iloc[0], own["size"].iloc[-1]),
                    "growth": own["median"].iloc[-1] / own["median"].iloc[0],
                    "far": [(own.loc[i, "size"], value) for i, value in far.items()],
                }
            )
    return rows
