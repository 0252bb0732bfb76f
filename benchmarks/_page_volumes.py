"""What volumes.md says: of the races on grids."""

from __future__ import annotations

from pathlib import Path

import _ranges
import pandas

FINE, HALF = ", fine", ", half"


def facts(results: Path) -> dict:
    rates = pandas.read_csv(results / "volumes_rates.csv")
    table = _ranges.marked(pandas.read_csv(results / "volumes.csv"), rates)
    for measure in ("image_rmse", "image_rmse_low", "image_rmse_high"):
        table[f"{measure}_share"] = table[measure] / table["start"]
    scenes = {scene: rows for scene, rows in table.groupby("scene", sort=False)}
    by = {scene: rows.set_index("method") for scene, rows in scenes.items()}
    return {
        "scenes": {scene: rows.to_dict("records") for scene, rows in scenes.items()},
        "seconds": table["seconds"].max(),
        "seeds": table["seeds"].min(),
        "best": {scene: rows["image_rmse"].idxmin() for scene, rows in by.items()},
        "least": {scene: rows["parameter_rmse"].idxmin() for scene, rows in by.items()},
        "at_end": {
            scene: list(rows.index[(rows["mark"] != "") & ~rows.index.str.endswith(HALF)])
            for scene, rows in by.items()
        },
        "halves": {
            scene: {name: half for name, (_, half) in _shares(rows, HALF).items()}
            for scene, rows in by.items()
        },
        "fines": {scene: _shares(rows, FINE) for scene, rows in by.items()},
        "uniform": {scene: rows.loc["uniform", "image_rmse_share"] for scene, rows in by.items()},
    }


def _shares(rows: pandas.DataFrame, suffix: str) -> dict[str, tuple[float, float]]:
    """Of each method that was raced so, too, its error as usual, and so."""
    shares = rows["image_rmse_share"]
    names = [name.removesuffix(suffix) for name in rows.index if name.endswith(suffix)]
    return {name: (shares[name], shares[name + suffix]) for name in names}
