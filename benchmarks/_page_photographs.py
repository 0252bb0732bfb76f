"""What photographs.md says: of poses and shapes by their outline, and by colours alone."""

from __future__ import annotations

from pathlib import Path

import pandas

MEASURES = ("degrees", "size", "shift", "chamfer")


def facts(results: Path) -> dict | None:
    """None before there was a run."""
    path = results / "photographs.csv"
    if not path.exists():
        return None
    table = pandas.read_csv(path)
    table["size"] = 100 * table["size"].abs()
    rows = []
    for (case, by), own in table.groupby(["case", "by"], sort=False):
        row = {"case": case, "by": by, "seeds": len(own)}
        for name in MEASURES:
            if own[name].notna().all():
                row[name] = [own[name].median(), own[name].min(), own[name].max()]
        if "degrees" in row:
            row["landed"] = int(((own["degrees"] < 0.5) & (own["size"] < 1)).sum())
        rows.append(row)
    return {"rows": rows}
