"""What volumes.md says: of the races on grids."""

from __future__ import annotations

from pathlib import Path

import pandas


def facts(results: Path) -> dict | None:
    """None before there was a race."""
    path = results / "volumes.csv"
    if not path.exists():
        return None
    table = pandas.read_csv(path)
    for measure in ("image_rmse", "image_rmse_low", "image_rmse_high"):
        table[f"{measure}_share"] = table[measure] / table["start"]
    scenes = {scene: rows for scene, rows in table.groupby("scene", sort=False)}
    by = {scene: rows.set_index("method") for scene, rows in scenes.items()}
    return {
        "scenes": {scene: rows.to_dict("records") for scene, rows in scenes.items()},
        "seconds": table["seconds"].max(),
        "seeds": table["seeds"].min(),
        "best": {scene: rows["image_rmse"].idxmin() for scene, rows in by.items()},
        "sooner": {
            scene: {name: rows.loc[name, "time_to_uniform"] for name in ("ours", "progress")}
            for scene, rows in by.items()
        },
        "coarse": {scene: rows.loc["uniform", "time_to_fine"] for scene, rows in by.items()},
    }
