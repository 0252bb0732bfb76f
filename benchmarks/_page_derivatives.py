"""What derivatives.md says: which derivatives can be trusted, by the census of all plugins."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas
from _derivative_verdicts import WAYS, judged, of_keys, of_words, read
from _plugin_bsdfs import BSDFS
from _plugin_scenes import EMITTERS, MEDIA, SENSORS, SHAPES, TEXTURES
from _plugins import REASONS

SECTIONS = {
    "Materials": BSDFS,
    "Lights": EMITTERS,
    "Textures, colours and attributes of meshes": TEXTURES,
    "Media, phase functions and volumes": MEDIA,
    "Sensors": SENSORS,
    "Shapes": SHAPES,
}
# What a way is called in the page.
NAMES = {
    "prb": "`prb`",
    "path": "`path`, attached",
    "isas": "`isas`",
    "replayed": "`isas`, replayed",
}


def facts(results: Path) -> dict:
    table = read(results / "derivatives.csv")
    measured = table.dropna(subset=["reference"])
    told = judged(measured)
    keys = of_keys(table[table["key"].notna()])
    words = of_words(keys)
    return {
        "wrong": words[words["verdict"] == "wrong (isas)"].to_dict("records"),
        "mitsuba": table["mitsuba"].dropna().max(),
        "drjit": table["drjit"].dropna().max(),
        "variants": " and ".join(f"`{name}`" for name in sorted(set(table["variant"].dropna()))),
        "first": table["date"].dropna().min(),
        "last": table["date"].dropna().max(),
        "scenes": table["scene"].nunique(),
        "keys": len(keys),
        "sections": {
            name: rows
            for name, scenes in SECTIONS.items()
            if (rows := _section(keys[keys["scene"].isin(list(scenes))], told))
        },
        "counts": {NAMES[way]: _counts(keys, way) for way in WAYS},
        "reasons": REASONS,
        "without": sorted(table.loc[table["key"].isna(), "scene"]),
    }


def _counts(keys: pandas.DataFrame, way: str) -> dict[str, int]:
    """At generic values: of how many keys the derivative is right, wrong, or none."""
    each = keys[way]
    return {
        "right": int((each == "right").sum()),
        "wrong": int((each == "wrong").sum()),
        "never": int(each.isin(["never", "fails"]).sum()),
        "refused": int((each == "refused").sum()),
        "unsure": int((each == "unsure").sum()),
    }


def _section(keys: pandas.DataFrame, told: pandas.DataFrame) -> list[dict]:
    rows = []
    for row in keys.to_dict("records"):
        if row["isas"] == "moves":
            cells = {way: "" for way in WAYS} | {"isas": "moves", "differences": ""}
        else:
            mine = told[(told["scene"] == row["scene"]) & (told["key"] == row["key"])]
            inside = mine[mine["point"] == "generic"]
            cells = {way: _cell(row, inside, way) for way in WAYS}
            cells["differences"] = _differences(inside)
        name = row["key"].removeprefix("thing.").removesuffix(".value")
        rows.append({"scene": row["scene"], "key": name} | cells)
    return rows


def _cell(row: dict, inside: pandas.DataFrame, way: str) -> str:
    """The ratio to the differences that is farthest from 1, and where at an end it is not right."""
    word = row[way]
    if word == "never":
        text = "**0**"
    elif word in ("fails", "refused"):
        text = word
    elif word in ("", "-"):
        text = "–"
    else:
        ratios = inside[way] / inside["reference"]
        ratios = ratios[np.isfinite(ratios) & (inside[f"verdict_{way}"] == word)]
        if ratios.empty:
            return "–"
        ratio = ratios.loc[(ratios - 1).abs().idxmax()]
        text = f"**{ratio:.2f}**" if word == "wrong" else f"{ratio:.2f}"
        text += "?" if word == "unsure" else ""
    ends = row[f"{way}_ends"]
    return f"{text} ({ends.replace(' ', ', ')})" if ends else text


def _differences(inside: pandas.DataFrame) -> str:
    """Of the picture's mean: the derivative and its standard error."""
    first = inside[inside["functional"] == "mean"].iloc[0]
    return f"{first['reference']:.3g} ± {first['reference_error']:.1g}"
