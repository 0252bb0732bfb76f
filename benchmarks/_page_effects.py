"""What effects.md says: plans of effects, at equal time."""

from __future__ import annotations

import math
from pathlib import Path

import _ranges
import numpy as np
import pandas
from scipy import stats

# What steps_or_paths.py sets, and what it is where nothing is said: pixels a step, factor on the
# rates, how these fall, to which share and by which steps, and how slowly Adam's second moments
# forget.
SET = ["batch", "factor", "schedule", "final", "half", "beta_2"]
DEFAULT = (65536, 1.0, "inverse", 0.02, 40.0, 0.999)


def facts(results: Path) -> dict:
    scenes = _scenes(results / "effects.csv")
    ladder = [scene for scene in scenes if "staged" in scene["verdict"]]
    times = pandas.Series([scene["auto"]["time_to_full"] for scene in scenes])
    spent = pandas.read_csv(results / "steps_or_paths.csv")
    return {
        "spending": _spending(spent),
        "usual": dict(zip(SET, DEFAULT)),
        "scenes": scenes,
        "ladder": ladder,
        "seeds": int(scenes[0]["auto"]["seeds"]),
        "median": float(times.median()),
        "p": float(stats.wilcoxon(np.log([scene["auto"]["share"] for scene in scenes])).pvalue),
        "medians": [float(times.drop(index).median()) for index in times.index],
        "verdicts": {"auto": _verdicts(scenes, "auto"), "staged": _verdicts(ladder, "staged")},
        "never": [s["name"] for s in scenes if not math.isfinite(s["auto"]["time_to_full"])],
        "acts": _acts(scenes),
        # Before targets were rendered to a noise.
        "earlier": [
            s["name"] for s in scenes if not math.isfinite(s["auto"].get("noise", math.nan))
        ],
        # Before rows had a day, a probe asked otherwise.
        "older": [s["name"] for s in scenes if not isinstance(s["auto"].get("day"), str)],
        "threads": [scene["auto"]["threads"] for scene in scenes],
        # Where the first look of `progress` came after as many steps as it cost.
        "late": [scene["name"] for scene in scenes if not scene["auto"]["passes"] == 1],
        "choosing": _choosing(pandas.read_csv(results / "effects_rates.csv")),
    } | _sharing(pandas.read_csv(results / "sharing.csv"))


def _scenes(path: Path) -> list[dict]:
    scenes = []
    table = _ranges.marked(pandas.read_csv(path), pandas.read_csv(path.with_stem("effects_rates")))
    for scene, rows in table.groupby("scene", sort=False):
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


def _acts(scenes: list[dict]) -> dict[str, list[str]]:
    """The scenes on which `auto` does what."""
    tests = {
        "paths": lambda full, auto: auto["depth"] < full["depth"],
        "derivatives": lambda full, auto: auto["derivative"] < auto["depth"],
        "caustics": lambda full, auto: not auto["caustics"],
        "samples": lambda full, auto: auto["light_samples"] != full["light_samples"],
    }
    return {
        name: [each["name"] for each in scenes if test(each["full"], each["auto"])]
        for name, test in tests.items()
    }


def _choosing(rates: pandas.DataFrame) -> list[str]:
    """Scenes where more than one seed chose the rates."""
    seeds = rates.groupby("scene", sort=False)["seed"].nunique()
    return list(seeds[seeds > 1].index)


def _verdicts(scenes: list[dict], plan: str) -> dict[str, list[str]]:
    return {
        words: [scene["name"] for scene in scenes if scene["verdict"].get(plan) == words]
        for words in ("better", "worse", "alike")
    }


def _sharing(table: pandas.DataFrame) -> dict:
    """A row per scene, in words: noise by the power heuristic over the balance heuristic's, with
    one light sample and with four, each of four directions; over one light sample, noise and time
    of one of four directions, of four, of four that trace what they draw, and of roulette; with
    directions found the other way. The scenes where one heuristic has surely less noise; noise ×
    time of early roulette, of one sample that picks over one that does not, and the same of four;
    ``other``: of directions found the other way, with one sample and with four."""
    rows, lower, higher, early, picked, other = [], [], [], [], [[], []], [[], []]
    for scene, own in table.groupby("scene", sort=False):
        sides = ["heuristic", "lights", "directions", "roulette", "other"]
        of = own.fillna({"roulette": 0}).set_index(sides)

        def found(heuristic="balance", lights=1, directions=1, roulette=0, other=False, of=of):
            return of.loc[(heuristic, lights, directions, roulette, other)]

        powers = []
        for count in (1, 4):
            ratio, error = _over(found("power", count, count), found("balance", count, count))
            powers.append(f"{ratio:.2f} ± {error:.2f}")
            if abs(ratio - 1) > 2 * error:
                (lower if ratio > 1 else higher).append(scene)
        one, many, each = found(directions=4), found(lights=4, directions=4), found(lights=4)
        for shares, share in zip(picked, (_product(one), _product(many) / _product(each))):
            shares.append(share)
        early.append(_product(found(roulette=1)))
        pairs = []
        if own["other"].any():
            pairs = [[found("balance", n, n, 0, way) for way in (True, False)] for n in (1, 4)]
            for shares, (a, b) in zip(other, pairs):
                shares.append(_product(a) / _product(b))
        rows.append(
            {
                "scene": scene,
                "power": powers,
                "samples": [_told(side) for side in (one, many, each)],
                "other": [
                    ["{:.2f} ± {:.2f}".format(*_over(a, b)), f"{a['time'] / b['time']:.2f}"]
                    for a, b in pairs
                ],
                "roulette": [_told(found(roulette=n)) for n in (1, 2)],
            }
        )
    return {
        "sharing": rows,
        "lower": list(dict.fromkeys(lower)),
        "higher": list(dict.fromkeys(higher)),
        "roulette": (min(early), max(early)),
        "picked": picked,
        "other": other,
    }


def _over(one: pandas.Series, other: pandas.Series) -> tuple[float, float]:
    """Ratio of two noises, and its standard error."""
    ratio = one["noise"] / other["noise"]
    return ratio, ratio * math.hypot(*(e["error"] / e["noise"] for e in (one, other)))


def _product(row: pandas.Series) -> float:
    """Noise × time."""
    return row["noise"] * row["time"]


def _told(row: pandas.Series) -> list[str]:
    """Noise and time."""
    return [f"{row['noise']:.2f} ± {row['error']:.2f}", f"{row['time']:.2f}"]


def by_scene(table: pandas.DataFrame) -> pandas.DataFrame:
    """Runs of steps_or_paths.py, by scene and what was set: ``share`` that the parameter error is
    of the default's, with the same seed, their geometric mean."""
    run = ["scene", "seconds", "seed"]
    usual = (table[SET] == DEFAULT).all(axis="columns")
    table = table.merge(table[usual][[*run, "parameter_rmse"]], on=run, suffixes=("", "_usual"))
    share = np.log(table["parameter_rmse"] / table["parameter_rmse_usual"])
    ways = table.assign(share=share).groupby(["scene", "seconds", *SET], sort=False)
    found = ways.agg(share=("share", "mean"), seeds=("seed", "size")).reset_index()
    return found.assign(share=np.exp(found["share"]))


def named(way: tuple) -> str:
    """By what differs from the default."""
    batch, factor, schedule, final, half, beta = way
    words = [f"{batch:,} pixels", f"rates × {factor:g}", schedule, f"to {final:g}"]
    words += [f"half after {half:g}", f"β₂ {beta:g}"]
    differ = [word for word, own, usual in zip(words, way, DEFAULT) if own != usual]
    return ", ".join(differ) or "default"


def _spending(table: pandas.DataFrame) -> list[dict]:
    """By budget and what was set: the median over scenes, and how many are better."""
    rows = []
    for (seconds, *way), own in by_scene(table).groupby(["seconds", *SET], sort=False):
        row = {"seconds": seconds, "way": named(tuple(way)), "scenes": len(own)}
        row |= {"seeds": (own["seeds"].min(), own["seeds"].max())}
        row |= {"median": own["share"].median()}
        row |= {"least": own["share"].min(), "most": own["share"].max()}
        rows.append(row | {"better": int((own["share"] < 1).sum())})
    return sorted(rows, key=lambda row: row["seconds"])


def _row(row: dict, full: dict) -> dict:
    time = row["time_to_full"]
    return {
        **row,
        "share": row["parameter_rmse"] / full["parameter_rmse"],
        "time": _time(time) if row is not full else "–",
        "left": "–" if pandas.isna(row["left_out"]) else f"{row['left_out']:.2g}",
        "lights": _lights(row),
    }


def _lights(row: dict) -> str:
    told = row["light_samples"].replace(" ", ", ")
    directions = row.get("directions", math.nan)
    return told + (f" of {directions:g}" if directions > 1 else "")


def _time(share: float) -> str:
    return f"{share:.2f}" if math.isfinite(share) else "not reached"


def _verdict(row: dict, full: dict) -> str:
    """By the ranges of the seeds."""
    words = {_ranges.BELOW: "better", _ranges.ABOVE: "worse", _ranges.LEVEL: "alike"}
    return words[_ranges.apart(row, full, "parameter_rmse")]
