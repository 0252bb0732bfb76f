"""All scenes in one Markdown table, a row each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas

_ALWAYS = ["uniform", "relevant", "gradient", "ours", "progress"]
_SOONER = ["relevant", "gradient", "ours", "progress"]


def write(tables: list[pandas.DataFrame], path: Path) -> None:
    """``tables``: of each scene, a row per sampler (``reproduce.table``)."""
    samplers = [*_ALWAYS, *sorted({s for t in tables for s in t["sampler"]} - set(_ALWAYS))]
    head = ["scene", "seconds", *(f"`{s}`" for s in samplers)]
    head.append(" / ".join(f"`{s}`" for s in _SOONER))
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for table in tables:
        rows = table.set_index("sampler")
        cells = [rows["scene"].iloc[0], f"{rows['seconds'].iloc[0]:g}"]
        cells += [_error(rows, sampler) for sampler in samplers]
        cells.append(" / ".join(_time(rows, sampler) for sampler in _SOONER))
        lines.append("| " + " | ".join(cells) + " |")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _error(rows: pandas.DataFrame, sampler: str) -> str:
    """Median final parameter error and its range; the least is bold, with what it overlaps."""
    if sampler not in rows.index:
        return ""
    own, best = rows.loc[sampler], rows.loc[rows["parameter_rmse"].idxmin()]
    digits = max(0, 2 - int(np.floor(np.log10(own["parameter_rmse"]))))
    numbers = (own[f"parameter_rmse{end}"] for end in ("", "_low", "_high"))
    median, low, high = (f"{number:.{digits}f}" for number in numbers)
    text = f"{median} [{low}, {high}]"
    return f"**{text}**" if own["parameter_rmse_low"] <= best["parameter_rmse_high"] else text


def _time(rows: pandas.DataFrame, sampler: str) -> str:
    if sampler not in rows.index or not np.isfinite(rows.loc[sampler, "time_to_uniform"]):
        return "–"
    return f"{rows.loc[sampler, 'time_to_uniform']:.2f}"
