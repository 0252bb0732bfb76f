"""What filters.md says: of runs at equal iterations."""

from __future__ import annotations

from pathlib import Path

import _ranges
import numpy as np
import pandas

BASE, LOOKED_AT = "none", "pottery"  # a judging scene that was looked at while rates were chosen
DEFAULT = ("laplacian", 0.5, 40)  # filter, rate, half
RATIOS = ["parameter_rmse_ratio", "image_rmse_ratio"]


def facts(results: Path) -> dict:
    table = pandas.read_csv(results / "filters.csv")
    judged, choosing = (table[table["judged"] == number] for number in (1, 0))
    means = judged.groupby(["scene", "filter"]).mean().reset_index()
    means["steps"] = means["iterations"].astype(int)
    means = _ranges.marked(means, choosing, ("scene", "filter"))
    # On the scenes that all have.
    each = means[means["filter"] != BASE].groupby("scene")["filter"].nunique()
    shared = each.index[each == each.max()]
    alike = means["scene"].isin(shared) & (means["filter"] != BASE)
    over = means[alike].groupby("filter")[RATIOS]
    return {
        "sooner": sooner(results / "sooner.csv"),
        "ways": (chosen := ways(results / "choosing.csv")),
        "nearer": nearer(chosen),
        "usual": DEFAULT,
        "scenes": {scene: rows.to_dict("records") for scene, rows in means.groupby("scene")},
        "seeds": judged.groupby(["scene", "filter"]).size().min(),
        "batch": int(judged["batch"].iloc[0]),
        "iterations": sorted(set(means["steps"])),
        "across": over.agg(lambda each: np.exp(np.log(each).mean())).to_dict("index"),
        "shared": list(shared),
        "worst": over.max().to_dict("index"),
        "tried": choosing.groupby("filter")["factor"].agg(["min", "max"]).to_dict("index"),
    }


def sooner(path: Path) -> dict:
    """Today's default beside an earlier commit's, medians over a scene's seeds."""
    table = pandas.read_csv(path)
    rows = table.groupby("scene", sort=False)
    medians = rows.median(numeric_only=True).reset_index()
    return {
        "commit": table["commit"].iloc[0],
        "seconds": table["seconds"].iloc[0],
        "seeds": [int(rows.size().min()), int(rows.size().max())],
        "rows": medians.to_dict("records"),
        "median": medians["parameter_rmse_share"].median(),
        "image": medians["image_rmse_share"].median(),
        "unseen": medians.loc[
            medians["scene"] != LOOKED_AT, ["parameter_rmse_share", "image_rmse_share"]
        ].median(),
        "steps": (medians["iterations_now"] / medians["iterations_then"]).median(),
        "behind": {
            word: medians.loc[medians[name] > medians[f"{name}_then"], "scene"].tolist()
            for word, name in (("parameters", "parameter_rmse"), ("image", "image_rmse"))
        },
    }


def ways(path: Path) -> list[dict]:
    """A row for each way to take steps, errors over those of ``BASE`` by scene, with as many
    seconds."""
    table = pandas.read_csv(path)
    errors = [name.removesuffix("_ratio") for name in RATIOS]
    means = table.groupby(["filter", "rate", "half", "scene"], dropna=False)[errors].mean()
    means = means.reset_index().replace({np.nan: None})
    plain = means[means["filter"] == BASE].set_index("scene")
    rows = []
    for key, own in means.groupby(["filter", "rate", "half"], dropna=False, sort=True):
        over = own.set_index("scene")[errors] / plain[errors]
        row = dict(zip(("filter", "rate", "half"), key))
        rows.append(row | {name: over[name].to_dict() for name in errors})
    return rows


def nearer(rows: list[dict]) -> list[dict]:
    """The ways that end nearer than the DEFAULT on most scenes and measures, on how many."""
    errors = [name.removesuffix("_ratio") for name in RATIOS]
    told = {(row["filter"], row["rate"], row["half"]): row for row in rows}
    usual, found = told[DEFAULT], []
    for row in rows:
        less = [row[e][scene] < usual[e][scene] for e in errors for scene in usual[e]]
        if 2 * sum(less) > len(less):
            found.append(row | {"less": sum(less), "of": len(less)})
    return found
