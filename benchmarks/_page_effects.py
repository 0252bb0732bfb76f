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
        "never": [s["name"] for s in scenes if not math.isfinite(s["auto"]["time_to_full"])],
        # Rows of before caustics were planned do not say whether they are.
        "before": [s["name"] for s in ladder if pandas.isna(s["full"].get("caustics", math.nan))],
    } | _sharing(pandas.read_csv(results / "sharing.csv"))


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


def _sharing(table: pandas.DataFrame) -> dict:
    """A row per scene, in words: noise by the power heuristic over the balance heuristic's, with
    one light sample and with four; noise and time of four light samples, and of roulette, over one
    and none of it. The scenes where one heuristic has surely less noise, and the range of noise ×
    time of early roulette."""
    rows, lower, higher, products = [], [], [], []
    for scene, own in table.groupby("scene", sort=False):
        of = own.fillna({"roulette": 0}).set_index(["heuristic", "lights", "roulette"])
        powers = []
        for count in (1, 4):
            one, other = (of.loc[(name, count, 0)] for name in ("power", "balance"))
            ratio = one["noise"] / other["noise"]
            error = ratio * math.hypot(*(e["error"] / e["noise"] for e in (one, other)))
            powers.append(f"{ratio:.2f} ± {error:.2f}")
            if abs(ratio - 1) > 2 * error:
                (lower if ratio > 1 else higher).append(scene)
        early = of.loc[("balance", 1, 1)]
        products.append(early["noise"] * early["time"])
        rows.append(
            {
                "scene": scene,
                "power": powers,
                "many": _told(of.loc[("balance", 4, 0)]),
                "roulette": [_told(of.loc[("balance", 1, n)]) for n in (1, 2)],
            }
        )
    return {
        "sharing": rows,
        "lower": list(dict.fromkeys(lower)),
        "higher": list(dict.fromkeys(higher)),
        "roulette": (min(products), max(products)),
    }


def _told(row: pandas.Series) -> list[str]:
    """Noise and time."""
    return [f"{row['noise']:.2f} ± {row['error']:.2f}", f"{row['time']:.2f}"]


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
