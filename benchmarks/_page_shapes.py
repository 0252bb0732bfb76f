"""What shapes.md says: of the races to shapes, and of what a step costs."""

from __future__ import annotations

from pathlib import Path

import pandas

STOCK = "Mitsuba's loop"


def facts(results: Path) -> dict:
    table = pandas.read_csv(results / "shapes.csv")
    for name in ("chamfer", "chamfer_low", "chamfer_high"):
        table[f"{name}_share"] = table[name] / table["start"]
    step = pandas.read_csv(results / "shapes_step.csv").groupby("side")["seconds"].median()
    ours = table[table["method"] != STOCK]
    best = ours.loc[ours.groupby("scene", sort=False)["chamfer"].idxmin()]
    rebuilds = results / "shapes_rebuilds.csv"
    return {
        "scenes": {
            scene: rows.to_dict("records") for scene, rows in table.groupby("scene", sort=False)
        },
        "seconds": table["seconds"].max(),
        "seeds": table["seeds"].min(),
        "best": dict(zip(best["scene"], best["method"])),
        "left": dict(zip(best["scene"], best["chamfer_share"])),
        "sooner": list(ours["time_to_stock"]),
        "step": step["silhouettes"] / step[STOCK],
        "rebuilds": pandas.read_csv(rebuilds).to_dict("records") if rebuilds.exists() else [],
    }
