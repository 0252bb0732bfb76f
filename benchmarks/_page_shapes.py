"""What shapes.md says: of the races to shapes, and of what a step costs."""

from __future__ import annotations

from pathlib import Path

import _ranges
import pandas

STOCK = "Mitsuba's loop"
OVER = 1.005  # of the budget: what a last step that ends after it makes it
GOALS = ("dodoco_b", "kirby")  # the paper's


def facts(results: Path) -> dict:
    def read(name: str) -> pandas.DataFrame:
        return pandas.read_csv(results / f"{name}.csv")

    table = _ranges.marked(read("shapes"), read("shapes_rates"))
    for name in ("chamfer", "chamfer_low", "chamfer_high"):
        table[f"{name}_share"] = table[name] / table["start"]
    step = read("shapes_step").groupby("side")["seconds"].median()
    ours = table[table["method"] != STOCK]
    at_end, late = table["mark"] != "", table["time_to_stock"] > OVER
    best = ours.loc[ours.groupby("scene", sort=False)["chamfer"].idxmin()]
    return {
        "scenes": {
            scene: rows.to_dict("records") for scene, rows in table.groupby("scene", sort=False)
        },
        "seconds": table["seconds"].max(),
        "seeds": table["seeds"].min(),
        "best": dict(zip(best["scene"], best["method"])),
        "left": {s: share for s, share in zip(best["scene"], best["chamfer_share"]) if s in GOALS},
        "sooner": list(ours["time_to_stock"]),
        "stock_at_end": list(table.loc[(table["method"] == STOCK) & at_end, "scene"]),
        "stock_late": list(table.loc[(table["method"] == STOCK) & late, "scene"]),
        "shadows": dict(table[table["scene"] == "shadowplay"][["method", "chamfer_share"]].values),
        "step": step["silhouettes"] / step[STOCK],
        "levels": _levels(read("shapes_levels")),
        "rebuilds": read("shapes_rebuilds").to_dict("records"),
    }


def _levels(table: pandas.DataFrame) -> list[dict]:
    """A row per size and number of levels; distances over the start's of the whole mesh."""
    table["levels"] = table["method"].str.split().str[0].astype(int)
    table["vertices"] = table["size"].map({"default": 10 * 4**5 + 2, "paper": 10 * 4**6 + 2})
    whole = table[table["levels"] == 1].set_index("size")["start"]
    for name in ("chamfer", "chamfer_low", "chamfer_high"):
        table[f"{name}_share"] = table[name] / table["size"].map(whole)
    return table.to_dict("records")
