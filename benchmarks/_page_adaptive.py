"""What adaptive_sampling.md says, from the tables of the samplers' races."""

from __future__ import annotations

from pathlib import Path

import _claims
import _overview
import _ranges
import numpy as np
import pandas

GOAL = 1 / 3  # of `uniform`'s time
_TURNED = 0.9  # share of the budget
_ONE_NUMBER = ("dodoco", "trashcan")  # scenes whose unknown is one


def facts(results: Path) -> dict:
    table = pandas.read_csv(results / "reproduce.csv")
    scenes = [rows for _, rows in table.groupby("scene", sort=False)]
    by = {rows["scene"].iloc[0]: rows.set_index("sampler") for rows in scenes}
    textures = [name for name in by if name not in _ONE_NUMBER]
    # Where `uniform` has its final error long before the end, a time to it says nothing.
    turned = [s for s in by if by[s].loc["uniform", "time_to_uniform"] < _TURNED]
    times = {s: by[s].loc["progress", "time_to_uniform"] for s in by if s not in turned}
    variance = pandas.read_csv(results / "variance_dodoco.csv").set_index("sampler")
    looks = pandas.read_csv(results / "caustic.csv").set_index(["scene", "looks"])["distance"]
    return {
        "table": _overview.lines(scenes),
        "short": short(by, turned),
        "claims": _claims.lines(results),
        "ours_parameters": sides(by, "ours", "uniform", "parameter_rmse"),
        "ours_image": sides(by, "ours", "uniform", "image_rmse"),
        "ours_gradient": sides(by, "ours", "gradient", "parameter_rmse"),
        "ours_least_image": [s for s in by if foremost(by[s], "image_rmse", _ranges.BELOW)],
        "ours_worst": [s for s in by if foremost(by[s], "parameter_rmse", _ranges.ABOVE)],
        "progress_best": [s for s in textures if leads(by[s], "progress")],
        "progress_behind": [s for s in textures if not leads(by[s], "progress")],
        "progress_worse": sides(by, "progress", "uniform", "parameter_rmse")["above"],
        "times": [time for time in times.values() if np.isfinite(time)],
        "not_reached": [s for s, time in times.items() if not np.isfinite(time)],
        # Where it ends level with `uniform`, it got there by chance.
        "in_goal": [
            s
            for s, time in times.items()
            if time <= GOAL
            and s in sides(by, "progress", "uniform", "parameter_rmse")[_ranges.BELOW]
        ],
        "turned": turned,
        "steps_of_uniform": [
            by[s].loc["uniform", "iterations"] / by[s].loc["relevant", "iterations"] for s in by
        ],
        "worst_twentieth": {s: list(by[s]["worst_twentieth"]) for s in ("pottery", "jumpydumpy")},
        "trashcan": by["trashcan"].to_dict("index"),
        "dodoco_high": by["dodoco"]["parameter_rmse_high"].max(),
        "dodoco_nearer": [
            s
            for s, row in by["dodoco"].iterrows()
            if _ranges.apart(row, by["dodoco"].loc["uniform"], "parameter_rmse") == _ranges.BELOW
        ],
        "multires": multires(by["multires"]),
        "unseen": unseen(results / "unseen.csv"),
        "settings": settings(results / "settings.csv"),
        "draws": draws(results / "draws.csv"),
        "variance": variance.to_dict("index"),
        "looks": {scene: dict(looks[scene]) for scene in ("caustic_failure", "dodoco")},
        "derivative": pandas.read_csv(results / "derivative_sampling.csv").to_dict("records"),
    }


def leads(rows: pandas.DataFrame, sampler: str, measure: str = "parameter_rmse") -> bool:
    """Least error, or a range that overlaps that of the least."""
    best = rows.loc[rows[measure].idxmin()]
    return rows.loc[sampler, f"{measure}_low"] <= best[f"{measure}_high"]


def sides(by: dict, sampler: str, rival: str, measure: str) -> dict[str, list[str]]:
    """Scenes on which the ranges lie apart: ``sampler``'s ``below`` or ``above`` the rival's."""
    where = {s: _ranges.apart(r.loc[sampler], r.loc[rival], measure) for s, r in by.items()}
    return {side: [s for s in by if where[s] == side] for side in (_ranges.BELOW, _ranges.ABOVE)}


def foremost(rows: pandas.DataFrame, measure: str, side: str) -> bool:
    """Whether the range of `ours` lies on one ``side`` of those of all others."""
    others = (row for name, row in rows.iterrows() if name != "ours")
    return all(_ranges.apart(rows.loc["ours"], row, measure) == side for row in others)


def multires(rows: pandas.DataFrame) -> dict:
    """What is left of the start's error; which samplers are level with the least, which not."""
    level = [name for name in rows.index if leads(rows, name)]
    return {
        "share": list(rows["share_of_start"]),
        "iterations": list(rows["iterations"]),
        "least": rows["parameter_rmse"].idxmin(),
        "level": level,
        "behind": [name for name in rows.index if name not in level],
    }


def unseen(path: Path) -> list[dict]:
    """By scene, what `unseen.py` has of texels that camera rays meet, ``met``, and of others."""
    found = []
    for scene, rows in pandas.read_csv(path).groupby("scene", sort=False):
        of = {bool(row["met"]): row for row in rows.to_dict("records")}
        worse = of[False]["end_low"] > of[False]["start"]
        found.append({"scene": scene, "met": of[True], "other": of[False], "worse": worse})
    return found


def settings(path: Path) -> list[dict]:
    """The rows of `settings.py`, with the side of what each is ``beside`` by both errors; none
    before it has run."""
    if not path.exists():
        return []
    table = pandas.read_csv(path).fillna({"beside": ""})
    rates = pandas.read_csv(path.with_stem("settings_rates"))
    of = {(row["scene"], row["method"]): row for row in table.to_dict("records")}
    rows = _ranges.marked(table, rates).to_dict("records")
    for row in rows:
        rival, both = of.get((row["scene"], row["beside"])), ("parameter_rmse", "image_rmse")
        row["sides"] = [_ranges.apart(row, rival, name) for name in both] if rival else ["", ""]
    return rows


def draws(path: Path) -> list[dict]:
    """The rows of `settings.py --draws`; none before it has run."""
    return pandas.read_csv(path).to_dict("records") if path.exists() else []


def short(by: dict[str, pandas.DataFrame], turned: list[str]) -> list[str]:
    """The README's table: what is left of the start's error, and the time that it took."""
    shown = ("uniform", "ours", "progress")
    head = ["scene", *(f"`{s}`" for s in shown), "time of `progress` to `uniform`'s error"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for scene, rows in by.items():
        name = scene.replace("_relative", ", relative L2")
        cells = [f"{name}, {rows['seconds'].iloc[0]:g} s"]
        for sampler in shown:
            text = f"{100 * rows.loc[sampler, 'share_of_start']:.1f} %"
            cells.append(f"**{text}**" if leads(rows.loc[list(shown)], sampler) else text)
        time = rows.loc["progress", "time_to_uniform"]
        cells.append(f"{time:.2f}" if np.isfinite(time) else "not reached")
        if scene in turned:
            cells[-1] = "–"
        lines.append("| " + " | ".join(cells) + " |")
    return lines
