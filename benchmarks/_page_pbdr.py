"""What pbdr.md says: of runs where everything is unknown at once, and of the paper's claims."""

from __future__ import annotations

from pathlib import Path

import pandas

FULL, PLAIN, STOCK = "full", "ours", "Mitsuba's loop"


def facts(results: Path) -> dict | None:
    """None before there was a race."""
    path = results / "pbdr.csv"
    if not path.exists():
        return None
    table = pandas.read_csv(path)
    by = {scene: rows.set_index("method") for scene, rows in table.groupby("scene", sort=False)}
    more, shape = results / "pbdr_more.csv", results / "pbdr_shape.csv"
    return {
        "scenes": {scene: rows.reset_index().to_dict("records") for scene, rows in by.items()},
        "seconds": dict(table.groupby("scene", sort=False)["seconds"].max()),
        "seeds": table["seeds"].min(),
        "ends": _ends(table, pandas.read_csv(results / "pbdr_rates.csv")),
        **(_more(pandas.read_csv(more)) if more.exists() else {"more": []}),
        "shape": pandas.read_csv(shape).to_dict("records") if shape.exists() else [],
        "claims": _claims(by),
        "prior": {scene: _ratio(rows, "mpea", "without the prior") for scene, rows in by.items()},
        "smoothing": {
            scene: _ratio(rows, "re", "without smoothing")
            for scene, rows in by.items()
            if "without smoothing" in rows.index
        },
        "best": {scene: rows["re"].idxmin() for scene, rows in by.items()},
        "sooner": {scene: rows.loc[FULL, "time_to_stock"] for scene, rows in by.items()},
    }


def _ends(table: pandas.DataFrame, rates: pandas.DataFrame) -> dict[str, list[str]]:
    """By scene, the methods whose best factor is the largest that was tried."""
    most = rates.groupby(["scene", "method"])["factor"].max()
    found: dict[str, list[str]] = {}
    for row in table.to_dict("records"):
        if row["factor"] >= most[row["scene"], row["method"]]:
            found.setdefault(row["scene"], []).append(row["method"])
    return found


def _more(table: pandas.DataFrame) -> dict:
    """The rows; by scene, the method of least RE, and which end worse or better than `ours` by all
    seeds."""
    best, apart = {}, {}
    for scene, rows in table.groupby("scene", sort=False):
        rows = rows.set_index("method")
        best[scene], ours = rows["re"].idxmin(), rows.loc[PLAIN]
        apart[scene] = {
            "better": list(rows.index[rows["re_high"] < ours["re_low"]]),
            "worse": list(rows.index[rows["re_low"] > ours["re_high"]]),
        }
    return {"more": table.to_dict("records"), "more_best": best, "more_apart": apart}


def _ratio(rows: pandas.DataFrame, measure: str, rival: str) -> float:
    """Of the full method to a rival; where nothing is to be smoothed, the full method without the
    prior is `ours`."""
    return rows.loc[FULL, measure] / rows.loc[rival if rival in rows.index else PLAIN, measure]


def _claims(by: dict[str, pandas.DataFrame]) -> list[dict]:
    """A row per claim and scene: the measure with the method and with what it is claimed to beat,
    and whether all seeds agree (``holds``: yes, no, or the ranges overlap)."""
    rivals = [
        ("RE is lower than Mitsuba's", "re", FULL, STOCK),
        ("MPEA is lower than Mitsuba's", "mpea", FULL, STOCK),
        ("converges in fewer iterations than Mitsuba", "cs", FULL, STOCK),
        ("smoothing lowers the gradients' noise", "gn", FULL, "without smoothing"),
        ("without smoothing RE rises", "re", FULL, "without smoothing"),
        ("without smoothing convergence takes longer", "cs", FULL, "without smoothing"),
        ("without the prior RE rises", "re", FULL, "without the prior"),
        ("without the prior convergence takes longer", "cs", FULL, "without the prior"),
    ]
    found = []
    for claim, measure, method, rival in rivals:
        for scene, rows in by.items():
            # Where nothing is to be smoothed, the full method without the prior is `ours`.
            other = rival if rival in rows.index else PLAIN if "prior" in rival else None
            if other is None:
                continue
            ours, theirs = rows.loc[method], rows.loc[other]
            holds = "the ranges overlap"
            if ours[f"{measure}_high"] < theirs[f"{measure}_low"]:
                holds = "yes"
            elif theirs[f"{measure}_high"] < ours[f"{measure}_low"]:
                holds = "no, the other way round"
            values = {"ours": ours[measure], "theirs": theirs[measure]}
            found.append({"claim": claim, "scene": scene, "holds": holds, **values})
    return found
