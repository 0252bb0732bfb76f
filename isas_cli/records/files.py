"""How a record's files get onto the disk whole, and what their layout is."""

from __future__ import annotations

import json
import math
import os
import unicodedata
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np
import yaml

from ..runtime.errors import InputError
from ..runtime.files import write_atomically

# One number until a version is released: records of earlier commits are refused in one line.
SCHEMA_VERSION = 4

KEY_PREFIX, VALUE_PREFIX = "parameter_rmse/", "value/"
BEFORE_KEYS = ["iteration", "seconds", "paths", "loss", "image_rmse", "parameter_rmse"]
AFTER_KEYS = [
    "gradient_norm",
    "gradient_noise",
    "nonfinite",
    "stage1_seconds",
    "learning_rate",
    "prior",
]
# What a manifest says of `parameter_rmse` where it is no length, angle, … of one unit.
RELATIVE, OWN_UNIT = "relative to the start", "parameter's unit"
WHOLE_NUMBERS = ("iteration", "paths", "nonfinite")


def safe_name(key: str) -> str:
    """A file name for an unknown's key; `key_of` gives the key back."""
    # Letters as they are: quoted, one of another script takes up to twelve of a name's 255 bytes.
    # But for those that some file systems take apart.
    kept = (c.isalnum() and not unicodedata.decomposition(c) for c in key)
    return "".join(c if keep else quote(c, safe="") for c, keep in zip(key, kept))


def walked(
    folder: Path, refused: Callable[[OSError], Any] | None = None
) -> Iterator[tuple[Path, list[str], list[str]]]:
    """As `os.walk`, in order, through links as well, and into no folder twice. ``refused`` is
    called for each that cannot be read."""
    seen = set()
    for place, folders, files in os.walk(folder, onerror=refused, followlinks=True):
        folders.sort()
        if (real := os.path.realpath(place)) in seen:
            folders.clear()
            continue
        seen.add(real)
        yield Path(place), folders, files


def key_of(name: str) -> str:
    """The key that `safe_name` made `name` from."""
    return unquote(name)


def write_text(path: Path, text: str) -> None:
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def write_json(path: Path, d: dict[str, Any]) -> None:
    plain = _plain({"schema": SCHEMA_VERSION, **d})
    write_text(path, json.dumps(plain, indent=2, allow_nan=False) + "\n")


def _plain(value: Any) -> Any:
    """The value in JSON's types; NaN and infinity, which JSON lacks, become None."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (np.generic, np.ndarray, Path)):
        return _plain(scalar(value))
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def scalar(value: Any) -> Any:
    """NumPy's numbers and arrays and paths as plain Python; TypeError for anything else."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} does not fit into a JSON file")


def check_schema(path: Path, content: Any) -> None:
    """Raises InputError for a file of another schema version."""
    found = content.get("schema") if isinstance(content, dict) else None
    if found != SCHEMA_VERSION:
        raise InputError(f"{path}: schema version {found}; this isas reads {SCHEMA_VERSION}")


def parsed(path: Path, parse: Callable[[], Any]) -> Any:
    try:
        return parse()
    except (OSError, ValueError, OverflowError, RecursionError, yaml.YAMLError) as error:
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from error


def one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
