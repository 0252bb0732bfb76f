"""The comparison as CSV files: numbers, and words where there is no number."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pandas

from ...records import write_atomically
from ...runtime.errors import InputError
from . import across
from .gather import Comparison

NOT_REACHED = "not reached"
NEITHER = "neither reached"
NOT_CONVERGED = "not converged"
ONE_RUN = "one run"
_MEANING = {
    NOT_REACHED: np.inf,
    NOT_CONVERGED: np.inf,
    NEITHER: np.nan,
    ONE_RUN: np.nan,
}
_TEXTS = ("scene", "measure", "method", "axis", "seeds")
_BOUNDS = ("_low", "_high")


def write(comparison: Comparison, output: Path) -> list[Path]:
    """Writes accuracy_time.csv, price_of_accuracy.csv, methods.csv and curves.csv into ``output``,
    and, of several scenes, across.csv.

    Infinite costs stand there as "not reached" (of CS: "not converged"), a ratio of two of them as
    "neither reached", the bounds of what one run alone knows (this method's or, of a ratio, the
    baseline's) as "one run". In curves.csv, whose columns stay numbers, these are blank. Elsewhere
    a blank is what is not known. `read` turns words back into numbers.
    Each file appears whole; IsasError when the disk refuses.
    """
    files = {
        "accuracy_time.csv": worded(comparison.accuracy),
        "price_of_accuracy.csv": worded(comparison.price),
        "methods.csv": worded(comparison.summary),
        "curves.csv": comparison.curves,
    }
    if comparison.across:
        files["across.csv"] = across.table(comparison.across)
    else:  # an earlier one was of other runs
        with contextlib.suppress(OSError):
            (output / "across.csv").unlink()
    for name, frame in files.items():
        write_atomically(output / name, lambda path: frame.to_csv(path, index=False))
    return [output / name for name in files]


def read(path: Path) -> pandas.DataFrame:
    """A table that ``write`` wrote, as numbers: "not reached" and "not converged" as +inf, "neither
    reached" and "one run" as NaN. Raises InputError for a file that is missing or none of these."""
    try:
        # Exactly what was written: pandas' fast parser may be off in the last digit.
        frame = pandas.read_csv(path, float_precision="round_trip", dtype={"seeds": str})
        if not {"scene", "scenes"} & set(frame):
            raise ValueError("it has no column scene")
        for name in frame.columns:
            if name.startswith("bound"):
                frame[name] = frame[name].astype(object).fillna("")
            elif name not in _TEXTS and not pandas.api.types.is_numeric_dtype(frame[name]):
                frame[name] = [float(_MEANING.get(cell, cell)) for cell in frame[name]]
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: no table of isas compare: {reason}") from error
    return frame


def worded(frame: pandas.DataFrame) -> pandas.DataFrame:
    """The numbers with words in place of infinities and of what is no number for a reason."""
    shown = frame.copy()
    for name in frame.columns if len(frame) else ():
        if name in _TEXTS or frame[name].dtype == bool:
            continue
        stem = name.removesuffix("_low").removesuffix("_high")
        column = shown[name].astype(object)
        if stem.endswith(("ratio", "speed_up")):
            # Of photographs nothing is known of the parameters, and so nothing of their speed-up.
            of = frame["scene" if stem == "ratio" else stem.removesuffix("_speed_up")]
            column[frame[stem].isna() & of.notna()] = NEITHER
        else:
            column[np.isinf(frame[name])] = NOT_CONVERGED if name == "CS" else NOT_REACHED
        if name.endswith(_BOUNDS):
            column[frame[name].isna() & frame[stem].notna()] = ONE_RUN
        shown[name] = column
    return shown
