"""What pbdr.md says: of runs where everything is unknown at once, and of the paper's claims."""

from __future__ import annotations

from pathlib import Path

import _ranges
import pandas

FULL, PLAIN, STOCK = "full", "ours", "Mitsuba's loop"
PHOTOGRAPHED = "materials_joint, photographed"
SHAPE = "object_joint_shape"


def facts(results: Path) -> dict:
    def read(name: str) -> pandas.DataFrame:
        return pandas.read_csv(results / f"{name}.csv")

    table = _ranges.marked(read("pbdr"), read("pbdr_rates"))
    by = {scene: rows.set_index("method") for scene, rows in table.groupby("scene", sort=False)}
    photographed = _marked(results, "pbdr_photographs", (0.09, 100 / 3)).set_index("method")
    every = by | {PHOTOGRAPHED: photographed}
    shape = _marked(results, "pbdr_shape", (0.09, 9.0))
    return {
        "scenes": {scene: rows.reset_index().to_dict("records") for scene, rows in by.items()},
        "seconds": dict(table.groupby("scene", sort=False)["seconds"].max()),
        "seeds": table["seeds"].min(),
        **_more(_ranges.marked(read("pbdr_more"), read("pbdr_more_rates"))),
        "more_otherwise": _otherwise(read("pbdr_more_rates")),
        "more_steps": [
            row["iterations"] / by[row["scene"]].loc[PLAIN, "iterations"]
            for row in read("pbdr_more").to_dict("records")
            if row["method"] == PLAIN
        ],
        "shape": shape.to_dict("records"),
        "photographed": photographed.reset_index().to_dict("records"),
        "claims": _claims(every | {SHAPE: _squared(shape.set_index("method"))}),
        "gains": {s: rows.loc[STOCK, "mpea"] / rows.loc[FULL, "mpea"] for s, rows in every.items()},
        "variance": read("variance_dodoco").set_index("sampler").to_dict("index"),
        "grid": _ranges.marked(
            *(read(name) for name in ("glowing_grid", "glowing_grid_rates")), ("seconds", "method")
        ).to_dict("records"),
        "prior": [
            {"scene": scene} | _beside(rows, "mpea", "without the prior")
            for scene, rows in every.items()
        ],
        "smoothing": [
            {"scene": scene} | _beside(rows, "re", "without smoothing")
            for scene, rows in every.items()
            if "without smoothing" in rows.index
        ],
        "best": {scene: rows["re"].idxmin() for scene, rows in every.items()},
        "sooner": {scene: rows.loc[FULL, "time_to_stock"] for scene, rows in every.items()},
    }


def _marked(results: Path, name: str, ends: tuple[float, float]) -> pandas.DataFrame:
    """A table with its marks; ``ends``: what a search that kept no table of rates had tried beyond
    its factors where the best was at an end of them."""
    table, rates = pandas.read_csv(results / f"{name}.csv"), results / f"{name}_rates.csv"
    if rates.exists():
        return _ranges.marked(table, pandas.read_csv(rates))
    return _ranges.marked(table, pandas.concat(table.assign(factor=end) for end in ends))


def _more(table: pandas.DataFrame) -> dict:
    """The rows; by scene, the method of least RE, and by each measure which end worse or better
    than `ours` by all seeds."""
    best, apart = {}, {}
    for scene, rows in table.groupby("scene", sort=False):
        rows = rows.set_index("method")
        best[scene], ours = rows["re"].idxmin(), rows.loc[PLAIN]
        apart[scene] = {
            measure.upper(): {
                word: [n for n, row in rows.iterrows() if _ranges.apart(row, ours, measure) == side]
                for word, side in (("better", _ranges.BELOW), ("worse", _ranges.ABOVE))
            }
            for measure in ("re", "mpea")
        }
    return {"more": table.to_dict("records"), "more_best": best, "more_apart": apart}


def _otherwise(rates: pandas.DataFrame) -> list[dict]:
    """Where another factor than the best by the image error had `ours` at less MPEA."""
    found = []
    for scene, own in rates[rates["method"] == PLAIN].groupby("scene", sort=False):
        chosen, other = (own.loc[own[name].idxmin()] for name in ("image_rmse", "mpea"))
        if other["factor"] != chosen["factor"]:
            share = other["mpea"] / chosen["mpea"]
            found.append({"scene": scene, "factor": other["factor"], "share": share})
    return found


def _beside(rows: pandas.DataFrame, measure: str, rival: str) -> dict:
    """The full method over a rival, whether their ranges overlap, and the factors of both; where
    nothing is to be smoothed, the full method without the prior is `ours`."""
    full, other = rows.loc[FULL], rows.loc[rival if rival in rows.index else PLAIN]
    level = _ranges.apart(full, other, measure) == _ranges.LEVEL
    factors = [full["factor"], other["factor"]]
    return {"times": full[measure] / other[measure], "level": level, "factors": factors}


def _squared(rows: pandas.DataFrame) -> pandas.DataFrame:
    """With the range of RE, where a table has that of its root alone."""
    ends = ("_low", "_high")
    return rows.assign(**{f"re{end}": 3 * rows[f"image_rmse{end}"] ** 2 for end in ends})


def _claims(by: dict[str, pandas.DataFrame]) -> list[dict]:
    """A row per claim and scene: where the paper has it, the measure with the method and with what
    it is claimed to beat, and whether all seeds agree (``holds``: yes, no, or the ranges
    overlap)."""
    rivals = [
        ("tab. I", "RE is lower than Mitsuba's", "re", FULL, STOCK),
        ("tab. II", "MPEA is lower than Mitsuba's", "mpea", FULL, STOCK),
    ]
    for part in ("smoothing", "the prior"):
        for claim, measure in (("RE rises", "re"), ("convergence takes longer (CS)", "cs")):
            without = f"without {part}"
            rivals.append(("ablation", f"{without} {claim}", measure, FULL, without))
    words = {
        _ranges.BELOW: "yes",
        _ranges.ABOVE: "no, the other way round",
        _ranges.LEVEL: "the ranges overlap",
    }
    found = []
    for where, claim, measure, method, rival in rivals:
        for scene, rows in by.items():
            # Where nothing is to be smoothed, the full method without the prior is `ours`.
            other = rival if rival in rows.index else PLAIN
            if other == PLAIN and ("prior" not in rival or scene == SHAPE):
                continue
            if f"{measure}_low" not in rows:
                continue
            ours, theirs = rows.loc[method], rows.loc[other]
            holds = words[_ranges.apart(ours, theirs, measure)]
            row = {"where": where, "claim": claim, "scene": scene, "holds": holds}
            found.append(row | {"ours": ours[measure], "theirs": theirs[measure]})
    return found
