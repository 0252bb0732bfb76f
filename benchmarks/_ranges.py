"""What tables of medians and ranges tell: whose ranges lie apart, whose best rate was an end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas

BELOW, ABOVE, LEVEL = "below", "above", "level"


def apart(own: Mapping, other: Mapping, measure: str) -> str:
    """Where the range of one row lies beside that of another: BELOW, ABOVE, or LEVEL where they
    overlap."""
    if own[f"{measure}_high"] < other[f"{measure}_low"]:
        return BELOW
    return ABOVE if own[f"{measure}_low"] > other[f"{measure}_high"] else LEVEL


def marked(
    table: pandas.DataFrame,
    rates: pandas.DataFrame,
    keys: Sequence[str] = ("scene", "method"),
    rate: str = "factor",
) -> pandas.DataFrame:
    """``table`` with a column ``mark``: a star where the best rate was the largest or the smallest
    of those tried, in ``rates``."""
    tried = rates.groupby(list(keys))[rate].agg(["min", "max"])
    ends = tried.reindex(pandas.MultiIndex.from_frame(table[list(keys)]))
    own = table[rate].to_numpy()
    at_end = (own <= ends["min"].to_numpy()) | (own >= ends["max"].to_numpy())
    return table.assign(mark=[r"\*" if each else "" for each in at_end])
