"""What exports.md says: whether a result's file shows what the run shows."""

from __future__ import annotations

from pathlib import Path

from _derivative_verdicts import read


def facts(results: Path) -> dict:
    table = read(results / "exports.csv")
    # What lights and surrounds every scene is the same in all of them.
    changed = table["changed"] > 1e-6
    same = table["verdict"] == "same"
    scenes = [
        {
            "scene": scene,
            "same": int((rows["verdict"] == "same").sum()),
            "all": int(rows["key"].notna().sum()),
            "apart": rows["apart"].max(),
            "others": [
                (str(row["key"]), row["verdict"], str(row["told"]).replace("|", "/"))
                for row in rows[rows["verdict"] != "same"].to_dict("records")
            ],
        }
        for scene, rows in table.groupby("scene", sort=False)
    ]
    return {
        "scenes": scenes,
        "keys": int(table["key"].notna().sum()),
        "same": int(same.sum()),
        "told": int((same & changed).sum()),
        "refused": int((table["verdict"] == "refused").sum()),
        "others": int((~same & (table["verdict"] != "refused") & table["key"].notna()).sum()),
        "version": table["mitsuba"].dropna().iloc[0],
        "date": table["date"].dropna().max(),
    }
