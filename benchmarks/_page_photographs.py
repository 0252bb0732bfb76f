"""What photographs.md says: of poses and shapes by their outline, and by colours alone; and of what
views have that their file does not say."""

from __future__ import annotations

from pathlib import Path

import pandas

MEASURES = ("degrees", "size", "shift", "chamfer")
HELD = ("held_psnr", "held_ssim")
RELIT = ("factor", *HELD, "psnr_h", "psnr_l", "ssim", "roughness")
OF_VIEWS = ("psnr", "focal", "centre", "radial", "exposure")


def facts(results: Path) -> dict | None:
    """None before there was a run."""
    path = results / "photographs.csv"
    if not path.exists():
        return None
    table = pandas.read_csv(path)
    table["size"] = 100 * table["size"].abs()
    rows = _rows(table, MEASURES)
    for row in rows:
        if "degrees" in row:
            own = table[(table["case"] == row["case"]) & (table["by"] == row["by"])]
            row["landed"] = int(((own["degrees"] < 0.5) & (own["size"] < 1)).sum())
    path, found = results / "photographs_views.csv", {"rows": rows, "views": [], "relit": []}
    if path.exists():
        found["views"] = _rows(pandas.read_csv(path), OF_VIEWS)
    path = results / "relighting.csv"
    if path.exists():
        relit = pandas.read_csv(path).rename(columns={"way": "by"}).assign(case="jar")
        found["relit"] = _rows(relit, RELIT)
    return found


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
