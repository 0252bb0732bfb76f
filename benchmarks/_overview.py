"""All scenes in one Markdown table, three rows each: both errors, and time."""

from __future__ import annotations

import numpy as np
import pandas

_ALWAYS = ["uniform", "relevant", "gradient", "ours", "progress"]
# A median of 0: its noise is taken off an image error, and which is least is chance then.
BELOW = "below noise"


def lines(tables: list[pandas.DataFrame]) -> list[str]:
    """``tables``: of each scene, a row per sampler (``reproduce.table``)."""
    samplers = [*_ALWAYS, *sorted({s for t in tables for s in t["sampler"]} - set(_ALWAYS))]
    head = ["scene", "", *(f"`{s}`" for s in samplers)]
    made = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for table in tables:
        rows = table.set_index("sampler")
        scene = f"{rows['scene'].iloc[0]}, {rows['seconds'].iloc[0]:g} s"
        for first, what, cell in (
            (scene, "parameters", lambda s: _error(rows, s, "parameter_rmse")),
            ("", "image", lambda s: _error(rows, s, "image_rmse")),
            ("", "time", lambda s: _time(rows, s)),
        ):
            made.append("| " + " | ".join([first, what, *map(cell, samplers)]) + " |")
    return made


def _error(rows: pandas.DataFrame, sampler: str, measure: str) -> str:
    """Median final error and its range; the least is bold, with what it overlaps, unless it is
    ``BELOW``."""
    if sampler not in rows.index or not np.isfinite(rows.loc[sampler, measure]):
        return ""
    own, best = rows.loc[sampler], rows.loc[rows[measure].idxmin()]
    ends = own[measure], own[f"{measure}_high"]
    scale = next((end for end in ends if 0 < end < np.inf), 1e-3)
    digits = max(0, 2 - int(np.floor(np.log10(scale))))
    numbers = (own[f"{measure}{end}"] for end in ("", "_low", "_high"))
    median, low, high = (f"{number:.{digits}f}" for number in numbers)
    text = f"{median if own[measure] else BELOW} [{low}, {high}]"
    level = best[measure] > 0 and own[f"{measure}_low"] <= best[f"{measure}_high"]
    return f"**{text}**" if level else text


def _time(rows: pandas.DataFrame, sampler: str) -> str:
    """Share of the budget after which the error stays at `uniform`'s final one; "–": it does not.
    Without a range for `uniform` itself, whose median run it is."""
    if sampler not in rows.index or sampler == "uniform":
        return ""
    names = ("time_to_uniform", "time_to_uniform_low", "time_to_uniform_high")
    numbers = (rows.loc[sampler, name] for name in names)
    median, low, high = (f"{n:.2f}" if np.isfinite(n) else "–" for n in numbers)
    return f"{median} [{low}, {high}]"
