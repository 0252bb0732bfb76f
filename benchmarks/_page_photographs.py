"""What photographs.md says: of poses and shapes by their outline, and by colours alone; and of what
views have that their file does not say."""

from __future__ import annotations

from pathlib import Path

import pandas

MEASURES = ("degrees", "size", "shift", "chamfer")
HELD = ("held_psnr", "held_ssim", "held_flip")
RELIT = ("factor", *HELD, "psnr_l", "ssim", "flip", "roughness")
OF_HULL = ("chamfer", "psnr", "ssim", "flip")
OF_VIEWS = ("psnr", "flip", "focal", "centre", "radial", "exposure")


def facts(results: Path) -> dict:
    table = pandas.read_csv(results / "photographs.csv")
    table["size"] = 100 * table["size"].abs()
    rows = _rows(table, MEASURES)
    for row in rows:
        if "degrees" in row:
            own = table[(table["case"] == row["case"]) & (table["by"] == row["by"])]
            row["landed"] = int(((own["degrees"] < 0.5) & (own["size"] < 1)).sum())
    views = pandas.read_csv(results / "photographs_views.csv")
    relit = pandas.read_csv(results / "relighting.csv").rename(columns={"way": "by"})
    relit = _rows(relit.assign(case="jar"), RELIT)
    rates = pandas.read_csv(results / "relighting_rates.csv")
    factors = [f"{factor:g}" for factor in sorted(rates["factor"].unique())]
    alone = [row for row in rows if row["by"] == "colours alone" and "degrees" in row]
    alone = [row for row in alone if "clutter" not in row["case"]]
    hull = _rows(pandas.read_csv(results / "photographs_hull.csv"), OF_HULL)
    views = _rows(views, OF_VIEWS)
    return {
        "rows": rows,
        "hull": hull,
        "views": views,
        "relit": relit,
        # Where the search has no error of the views that are learnt from, those held out chose.
        "by_held": "image_rmse" not in rates,
        "factors": f"{', '.join(factors[:-1])} or {factors[-1]}",
        "alone": [sum(row[name] for row in alone) for name in ("landed", "seeds")],
    }


def _rows(table: pandas.DataFrame, measures: tuple[str, ...]) -> list[dict]:
    """Of each case and way the median, least and most of what was measured of it."""
    rows = []
    for (case, by), own in table.groupby(["case", "by"], sort=False):
        row = {"case": case, "by": by, "seeds": len(own)}
        for name in measures:
            if own[name].notna().all():
                row[name] = [own[name].median(), own[name].min(), own[name].max()]
        rows.append(row)
    return rows
