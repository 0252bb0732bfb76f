"""What effects.md says: plans of effects, at equal time."""

from __future__ import annotations

import math
from pathlib import Path

import pandas

# Pixels a step and learning rate of runs where nothing is said.
DEFAULT = (65536, 0.02)


def facts(results: Path) -> dict:
    scenes, ladder = (_scenes(results / f"{name}.csv") for name in ("effects", "effects_ladder"))
    times = [scene["auto"]["time_to_full"] for scene in scenes]
    across = pandas.read_csv(results / "effects_across.csv")
    (auto,) = (
        row
        for row in across.to_dict("records")
        if row["measure"] == "parameter_rmse" and "auto" in row["method"]
    )
    return {
        "spending": _spending(pandas.read_csv(results / "steps_or_paths.csv")),
        "across": auto,
        "scenes": scenes,
        "ladder": ladder,
        "seeds": int(scenes[0]["auto"]["seeds"]),
        "median": float(pandas.Series(times).median()),
        "verdicts": {"auto": _verdicts(scenes, "auto"), "staged": _verdicts(ladder, "staged")},
        "sharing": _sharing(pandas.read_csv(results / "sharing.csv")),
    }


def _scenes(path: Path) -> list[dict]:
    scenes = []
    for scene, rows in pandas.read_csv(path).groupby("scene", sort=False):
        of = {row["method"]: row for row in rows.to_dict("records")}
        full = of["full"]
        scenes.append(
            {
                "name": scene,
                "seconds": full["seconds"],
                "rows": [_row(row, full) for row in of.values()],
                "auto": _row(of["auto"], full),
                "full": full,
                "verdict": {name: _verdict(row, full) for name, row in of.items()},
            }
        )
    return scenes


def _verdicts(scenes: list[dict], plan: str) -> dict[str, list[str]]:
    return {
        words: [scene["name"] for scene in scenes if scene["verdict"].get(plan) == words]
        for words in ("better", "worse", "alike")
    }


def _sharing(table: pandas.DataFrame) -> list[dict]:
    """A row per scene: noise by the power heuristic over the balance heuristic's, with one light
    sample and with four; noise and time of four light samples, and of roulette, over one and none
    of it."""
    rows = []
    for scene, own in table.groupby("scene", sort=False):

        def of(heuristic: str, lights: int, roulette: int | None = None, own=own) -> pandas.Series:
            same = own["roulette"].isna() if roulette is None else own["roulette"] == roulette
            (found,) = own[(own["heuristic"] == heuristic) & (own["lights"] == lights) & same].index
            return own.loc[found]

        many = of("balance", 4)
        rows.append(
            {
                "scene": scene,
                "power": [of("power", n)["noise"] / of("balance", n)["noise"] for n in (1, 4)],
                "many": [many["noise"], many["time"]],
                "roulette": [[of("balance", 1, n)[m] for m in ("noise", "time")] for n in (1, 2)],
            }
        )
    return rows


def _spending(table: pandas.DataFrame) -> list[dict]:
    """Rows of steps_or_paths.csv, each with its error over that of the scene's default."""
    usual = (table["batch"] == DEFAULT[0]) & (table["rate"] == DEFAULT[1])
    of_default = table[usual].set_index("scene")["parameter_rmse"]
    share = table["parameter_rmse"] / table["scene"].map(of_default)
    return table.assign(share=share).to_dict("records")


def _row(row: dict, full: dict) -> dict:
    time = row["time_to_full"]
    return {
        **row,
        "share": row["parameter_rmse"] / full["parameter_rmse"],
        "time": _time(time) if row is not full else "–",
        "left": "–" if pandas.isna(row["left_out"]) else f"{row['left_out']:.2g}",
        "lights": row["light_samples"].replace(" ", ", "),
    }


def _time(share: float) -> str:
    return f"{share:.2f}" if math.isfinite(share) else "not reached"


def _verdict(row: dict, full: dict) -> str:
    """By the ranges of the seeds."""
    if row["parameter_rmse_high"] < full["parameter_rmse_low"]:
        return "better"
    return "worse" if row["parameter_rmse_low"] > full["parameter_rmse_high"] else "alike"
