"""What the plots and tables of a page show, taken from a comparison once for all of them."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pandas

from .gather import Comparison, Method

# The parameters' error first: it is what the optimisation is for.
MEASURES = {
    "parameter_rmse": "parameter RMSE",
    "image_rmse": "image RMSE (linear radiance)",
}
SHORT = {"parameter_rmse": "parameter error", "image_rmse": "image error"}


def rows(table: pandas.DataFrame, **values: Any) -> pandas.DataFrame:
    """The rows of a table that have these values in the columns of these names."""
    for name, value in values.items():
        table = table[table[name] == value]
    return table


def measures(comparison: Comparison, scene: str) -> list[str]:
    """The measures that are known of a scene."""
    known = rows(comparison.curves, scene=scene).dropna(subset="median")["measure"]
    return [name for name in MEASURES if (known == name).any()]


def label(measure: str, methods: list[Method]) -> str:
    """A measure and what it is in; where runs of ``methods`` differ in that, all of it."""
    if measure != "parameter_rmse":
        return MEASURES[measure]
    words = dict.fromkeys(run.parameter_rmse_is for method in methods for run in method.runs)
    return f"{MEASURES[measure]} ({' or '.join(words)})"


def start(methods: list[Method], measure: str) -> float:
    """The error before the first iteration, the median over all runs; NaN where unknown."""
    values = np.array([run.history[measure].iloc[0] for m in methods for run in m.runs])
    return float(np.median(values[np.isfinite(values)])) if np.isfinite(values).any() else math.nan


def level_name(level: float) -> str:
    """A share of the start's error as one writes it: 1/8."""
    return str(Fraction(level))


def step_name(level: float) -> str:
    """The halving that ends at a level: 1/4 → 1/8."""
    return f"{level_name(2 * level)} → {level_name(level)}"


def levels(comparison: Comparison, scene: str, measure: str) -> list[float]:
    """The levels that some method reached (in its median), the easiest first, and the next one,
    which none did: deeper ones, which single runs may have reached, say little and take room."""
    own = rows(comparison.accuracy, scene=scene, measure=measure)
    reached = own.loc[np.isfinite(own["seconds"]), "level"].min()
    every = sorted(own["level"].unique(), reverse=True)
    return [level for level in every if not level < reached / 2]


def cell(
    comparison: Comparison, scene: str, measure: str, label: str, level: float
) -> pandas.Series | None:
    """The row of accuracy_time for one method and level, None where there is none."""
    own = rows(comparison.accuracy, scene=scene, measure=measure, method=label, level=level)
    return None if own.empty else own.iloc[0]


def price(comparison: Comparison, scene: str, measure: str, label: str) -> pandas.DataFrame:
    """The rows of price_of_accuracy for one method, by `levels`."""
    own = rows(comparison.price, scene=scene, measure=measure, method=label)
    own = own[own["level"].isin(levels(comparison, scene, measure))]
    return own.sort_values("level", ascending=False)
