"""The run that stands for its method in pictures, and the methods that have any."""

from __future__ import annotations

import math

from ...records import Run
from .gather import Method
from .metrics import last
from .series import seed

# At most: all pictures are held at once, and side by side a WebP has at most 16,383 pixels.
_PICTURED = 24
_MEDIAN = "Runs shown, of each method the one with the median final error"


def final_error(run: Run) -> tuple[str, float]:
    """The measure by which a run is judged and its last known value: the parameters' error where
    the truth is known, else the image's. NaN where neither was ever known."""
    for measure in ("parameter_rmse", "image_rmse"):
        error = last(run, measure)
        if not math.isnan(error):
            return measure, error
    return "image_rmse", math.nan


def typical_run(method: Method) -> Run:
    """The run with the median final error; of an even number, the better of the middle two.

    Infinite and unknown errors count as the worst.
    """
    order = sorted(method.runs, key=lambda run: _rank(final_error(run)[1]))
    return order[(len(order) - 1) // 2]


def pictured(methods: list[Method]) -> tuple[list[Method], str]:
    """The methods whose pictures are shown and, where these are not all, a sentence for a
    caption."""
    shown = methods[:_PICTURED]
    left = len(shown) < len(methods)
    return shown, f" The first {len(shown)} of {len(methods)} methods." if left else ""


def words(methods: list[Method]) -> str:
    """Which runs `typical_run` chose, as a sentence for a caption."""
    chosen = [f"{method.label} seed {seed(typical_run(method))}" for method in methods]
    which = "Runs shown" if all(len(method.runs) == 1 for method in methods) else _MEDIAN
    return f"{which}: {', '.join(chosen)}."


def _rank(error: float) -> float:
    return math.inf if math.isnan(error) else error
