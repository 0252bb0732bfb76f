"""What the plots and tables of a page show, taken from a comparison once for all of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import matplotlib
import matplotlib.colors
import numpy as np
import pandas

from .gather import Comparison, Method

# The parameters' error first: it is what the optimisation is for.
MEASURES = {
    "parameter_rmse": "parameter RMSE",
    "image_rmse": "image RMSE (linear radiance)",
}
SHORT = {"parameter_rmse": "parameter error", "image_rmse": "image error"}
TRAINING = {
    "gradient_norm": "norm of the gradient",
    "gradient_noise": "gradient noise (GN)",
    "nonfinite": "non-finite gradient entries",
}


@dataclass(frozen=True)
class Bar:
    """How much sooner than the baseline a method reaches a level: ratio of billed seconds.

    ratio: NaN where there is none, and then `words` says why. low, high: 95 % interval, NaN where
    one run says nothing of spread; 0 and infinity are possible bounds.
    """

    level: float
    ratio: float
    low: float
    high: float
    words: str = ""


def measures(comparison: Comparison, scene: str) -> list[str]:
    """The measures that are known of a scene."""
    known = comparison.curves[comparison.curves["scene"] == scene]
    return [
        name for name in MEASURES if known.loc[known["measure"] == name, "median"].notna().any()
    ]


def label(measure: str, methods: list[Method]) -> str:
    """A measure and what it is in; where runs of ``methods`` differ in that, all of it."""
    if measure != "parameter_rmse":
        return MEASURES[measure]
    words = dict.fromkeys(run.parameter_rmse_is for method in methods for run in method.runs)
    return f"{MEASURES[measure]} ({' or '.join(words)})"


def curve(
    comparison: Comparison, scene: str, label: str, measure: str, axis: str
) -> list[pandas.DataFrame]:
    """The curve of one method: x, median, low, high, runs, by x, without what cost nothing.

    In pieces, one for each number of runs that went so far: where a run ends the median jumps, and
    a line across the jump would look like progress or harm.
    """
    rows = comparison.curves
    rows = rows[(rows["scene"] == scene) & (rows["method"] == label)]
    rows = rows[(rows["measure"] == measure) & (rows["axis"] == axis)]
    rows = rows[(rows["x"] > 0) & np.isfinite(rows["median"])].sort_values("x")
    piece = (rows["runs"] != rows["runs"].shift()).cumsum()
    return [part for _, part in rows.groupby(piece)]


def guide(left: float, right: float, low: float, high: float) -> tuple[list[float], list[float]]:
    """Two points, x and y, of a line of slope −1/2 through the middle of a log-log panel, as long
    as the panel holds it."""
    middle_x, middle_y = math.sqrt(left * right), math.sqrt(low * high)
    reach = min(math.sqrt(right / left), high / low)  # in x each way; y goes half as far
    drop = math.sqrt(reach)
    return [middle_x / reach, middle_x * reach], [middle_y * drop, middle_y / drop]


def start(methods: list[Method], measure: str) -> float:
    """The error before the first iteration, the median over all runs; NaN where unknown."""
    values = np.array([run.history[measure].iloc[0] for m in methods for run in m.runs])
    return float(np.median(values[np.isfinite(values)])) if np.isfinite(values).any() else math.nan


def level_name(level: float) -> str:
    """A share of the start's error as one writes it: 1/8."""
    return str(Fraction(level).limit_denominator(1 << 20))


def step_name(level: float) -> str:
    """The halving that ends at a level: 1/4 → 1/8."""
    return f"{level_name(2 * level)} → {level_name(level)}"


def levels(comparison: Comparison, scene: str, measure: str) -> list[float]:
    """The levels that some method reached (in its median), the easiest first, and the next one,
    which none did: deeper ones, which single runs may have reached, say little and take room."""
    rows = comparison.accuracy
    rows = rows[(rows["scene"] == scene) & (rows["measure"] == measure)]
    reached = rows.loc[np.isfinite(rows["seconds"]), "level"].min()
    every = sorted(rows["level"].unique(), reverse=True)
    return [level for level in every if not level < reached / 2]


def cell(
    comparison: Comparison, scene: str, measure: str, label: str, level: float
) -> pandas.Series | None:
    """The row of accuracy_time for one method and level, None where there is none."""
    rows = comparison.accuracy
    rows = rows[(rows["scene"] == scene) & (rows["measure"] == measure)]
    rows = rows[(rows["method"] == label) & np.isclose(rows["level"], level)]
    return None if rows.empty else rows.iloc[0]


def price(comparison: Comparison, scene: str, measure: str, label: str) -> pandas.DataFrame:
    """The rows of price_of_accuracy for one method, by `levels`."""
    rows = comparison.price
    rows = rows[(rows["scene"] == scene) & (rows["measure"] == measure)]
    rows = rows[rows["level"].isin(levels(comparison, scene, measure))]
    return rows[rows["method"] == label].sort_values("level", ascending=False)


def bars(comparison: Comparison, scene: str, measure: str, label: str) -> list[Bar]:
    """A method's speed-up over its scene's baseline at every level of `levels`."""
    made = []
    for level in levels(comparison, scene, measure):
        own = cell(comparison, scene, measure, label, level)
        base = cell(comparison, scene, measure, comparison.baseline[scene], level)
        if own is None or not math.isfinite(own["seconds"]):
            made.append(Bar(level, math.nan, math.nan, math.nan, "not reached"))
        elif base is None or not math.isfinite(base["seconds"]):
            made.append(Bar(level, math.nan, math.nan, math.nan, "baseline never"))
        else:
            made.append(Bar(level, own["ratio"], own["ratio_low"], own["ratio_high"]))
    return made


def bar_limits(bars: list[Bar]) -> tuple[float, float]:
    """A range of ratios that shows all bars and the finite ends of their intervals, at least a
    factor of two each way."""
    ends = [x for bar in bars for x in (bar.ratio, bar.low, bar.high) if math.isfinite(x) and x > 0]
    return min(0.5, *ends, 1.0) / 1.1, max(2.0, *ends, 1.0) * 1.1


def phases(methods: list[Method]) -> dict[str, pandas.DataFrame]:
    """Seconds by phase, median over runs: a row for each method, a column for each phase.

    Keys are "billed" and "not billed"; runs without a summary do not count.
    """
    halves = {"billed": "seconds_by_phase", "not billed": "seconds_unbilled"}
    tables = {}
    for title, key in halves.items():
        rows = {}
        for method in methods:
            found = [(run.summary or {}).get(key) or {} for run in method.runs]
            rows[method.label] = (
                pandas.DataFrame([one for one in found if one]).fillna(0.0).median()
            )
        table = pandas.DataFrame(rows).T.astype(float).fillna(0.0)
        tables[title] = table.loc[:, (table > 0).any()] if len(table.columns) else table
    return tables


def shades(half: str, count: int) -> list[str]:
    """Colours for the phases of a half of `phases`, in none of the colours of methods."""
    shown = matplotlib.colormaps["Greys" if half == "billed" else "YlOrBr"](
        np.linspace(0.7, 0.25, max(count, 1))
    )
    return [matplotlib.colors.to_hex(colour) for colour in shown]


def histories(method: Method, name: str) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Billed seconds and a column of the history, for each run that knows it; without gaps.

    Gradient noise begins with the second iteration: in the first the smoothed gradient is the
    gradient, and rounding is all that differs.
    """
    for run in method.runs:
        if name in run.history:
            known = run.history[np.isfinite(run.history[name])]
            known = known[known["iteration"] > 1] if name == "gradient_noise" else known
            if len(known):
                yield known["seconds"].to_numpy(), known[name].to_numpy()
