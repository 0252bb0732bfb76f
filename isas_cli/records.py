"""The files of one run: written whole, read back typed. Knows nothing of rendering.

A run's folder holds config.yaml, manifest.json, history.csv (one row per evaluation), summary.json,
frames/*.exr, checkpoint/state.npz and, from `report`, plots/*.png and report.html. Each file is
written under a temporary name in its own folder, flushed to the disk and renamed over the earlier
version, so that whoever reads at any moment, or after a kill, finds a whole file.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import operator
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, unquote

import numpy as np
import yaml

from .errors import InputError, IsasError

if TYPE_CHECKING:
    import pandas

SCHEMA_VERSION = 1

KEY_PREFIX = "parameter_rmse/"
_BEFORE_KEYS = ["iteration", "seconds", "paths", "loss", "image_rmse", "parameter_rmse"]
_AFTER_KEYS = ["gradient_norm", "nonfinite", "stage1_seconds", "learning_rate"]
_WHOLE_NUMBERS = ("iteration", "paths", "nonfinite")
_RECORD_FILES = ("manifest.json", "config.yaml", "history.csv", "summary.json")
_MADE_FILES = ("report.html", "frames/*.exr", "plots/*.png", "checkpoint/state.npz")
_LEFT_OVER = (".*.tmp", "frames/.*.tmp", "plots/.*.tmp", "checkpoint/.*.tmp")  # of a killed run


def write_atomically(path: Path, write: Callable[[Path], None]) -> None:
    """Calls `write(temporary path)` and renames the result to `path`, which appears whole or not.

    The folder is made when missing. If anything fails, the temporary file goes and an earlier
    version of `path` stays as it was. Raises IsasError, one line naming the file, for an OSError
    (disk full, no permission); other exceptions pass.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise IsasError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):  # renamed already, or never made
            temporary.unlink()


def safe_name(key: str) -> str:
    """A file name for an unknown's key; `key_of` gives the key back."""
    return quote(key, safe="")


def key_of(name: str) -> str:
    """The key that `safe_name` made `name` from."""
    return unquote(name)


class RunWriter:
    """Writes the files of one run into `folder`.

    Raises InputError when the folder cannot be written, or already holds a run and `overwrite` is
    false. With `overwrite` the earlier run's files go, and nothing else that lies in the folder.
    Every method raises IsasError, one line naming the file, when the disk refuses.
    """

    def __init__(self, folder: Path, overwrite: bool = False):
        self.folder = Path(folder)
        self._columns: list[str] = []
        self._rows: list[list[str]] = []
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=self.folder).close()
            if any((self.folder / name).exists() for name in _RECORD_FILES):
                if not overwrite:
                    message = "already holds a run; choose another folder with hydra.run.dir=DIR"
                    raise InputError(f"{self.folder} {message}")
                for pattern in _RECORD_FILES + _MADE_FILES + _LEFT_OVER:
                    for old in self.folder.glob(pattern):
                        old.unlink()
        except OSError as error:
            raise InputError(
                f"cannot write to the output folder {self.folder}: {error.strerror or error}; "
                "choose another with hydra.run.dir=DIR"
            ) from error

    def config(self, text_yaml: str) -> None:
        """The resolved configuration, as YAML text."""
        _write_text(self.folder / "config.yaml", text_yaml)

    def manifest(self, d: dict[str, Any]) -> None:
        """What the run was made with: versions, machine, seeds, hashes. The schema is added."""
        _write_json(self.folder / "manifest.json", d)

    def evaluation(self, row: dict[str, Any]) -> None:
        """Adds a row to history.csv.

        row: the columns of the module's tables, `seconds` billed, `paths` light paths traced within
        billed time; `parameter_rmse/<key>` may stand for any number of keys, the same in all rows.
        A missing or None value stays empty, which reads as NaN; the whole-number columns must be
        there. Raises ValueError for a column that is not known.
        """
        if not self._columns:
            keys = [name for name in row if name.startswith(KEY_PREFIX)]
            self._columns = _BEFORE_KEYS + keys + _AFTER_KEYS
        strange = sorted(set(row) - set(self._columns))
        if strange:
            raise ValueError(f"history.csv has no column {', '.join(strange)}")
        self._rows.append([_cell(name, row.get(name)) for name in self._columns])
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(self._columns)
        table.writerows(self._rows)
        _write_text(self.folder / "history.csv", text.getvalue())

    def summary(self, d: dict[str, Any]) -> None:
        """How the run ended. The schema is added; NaN and infinity become null."""
        _write_json(self.folder / "summary.json", d)

    def frame(
        self, name: str, image: np.ndarray, channels: list[str], metadata: dict[str, Any]
    ) -> None:
        """frames/<name>.exr; the arguments are those of `images.write_exr`."""
        # Imported here: images stands on this module, and readers need no OpenImageIO.
        from .images import write_exr

        write_exr(self.folder / "frames" / f"{name}.exr", image, channels, metadata)

    def checkpoint(self, arrays: dict[str, np.ndarray], state: dict[str, Any]) -> None:
        """Arrays (any names; ValueError for objects) and JSON state, swapped in as one file."""
        members = {f"array/{name}": np.asarray(array) for name, array in arrays.items()}
        if any(member.dtype.hasobject for member in members.values()):
            raise ValueError("a checkpoint holds arrays of numbers, not of Python objects")
        text = json.dumps({"schema": SCHEMA_VERSION, "state": state}, default=_scalar)
        members["state"] = np.frombuffer(text.encode(), dtype=np.uint8)

        def write(temporary: Path) -> None:
            with open(temporary, "wb") as file:  # a path would get a second extension
                np.savez(file, **members)

        write_atomically(self.folder / "checkpoint" / "state.npz", write)


@dataclass(frozen=True)
class Run:
    """One run as read from its folder.

    history: the columns of history.csv, whole numbers as int64 and the others as float64, NaN where
    not known; no rows when the run was killed before its first evaluation. summary: None when the
    run was killed before it could end.
    """

    folder: Path
    config: dict[str, Any]
    manifest: dict[str, Any]
    history: pandas.DataFrame
    summary: dict[str, Any] | None

    @property
    def keys(self) -> list[str]:
        """The unknowns that have a parameter error of their own, in the order of the columns."""
        return [c[len(KEY_PREFIX) :] for c in self.history.columns if c.startswith(KEY_PREFIX)]


def load(folder: Path) -> Run:
    """Reads a run. Raises InputError, one line, for a folder that is missing, holds no run, was
    written under another schema version, or holds a file that is damaged."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such run folder")
    if not (folder / "manifest.json").is_file():
        raise InputError(f"{folder} holds no run: it has no manifest.json")
    manifest = _read_json(folder / "manifest.json")
    has_summary = (folder / "summary.json").is_file()
    return Run(
        folder=folder,
        config=_read_config(folder / "config.yaml"),
        manifest=manifest,
        history=_read_history(folder / "history.csv"),
        summary=_read_json(folder / "summary.json") if has_summary else None,
    )


def load_checkpoint(folder: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The arrays and the state that `RunWriter.checkpoint` last wrote. Raises InputError when there
    is none, it is damaged, or it was written under another schema version."""
    path = Path(folder) / "checkpoint" / "state.npz"
    if not path.is_file():
        raise InputError(f"{folder} holds no checkpoint: it has no checkpoint/state.npz")
    try:
        with open(path, "rb") as stored, np.load(stored, allow_pickle=False) as file:
            members = {name: file[name] for name in file.files}
        wrapped = json.loads(members.pop("state").tobytes().decode())
    except Exception as error:  # numpy, zipfile and json each have their own kinds for damage
        raise InputError(f"{path}: damaged: {_one_line(error)}") from error
    _check_schema(path, wrapped)
    return {name[len("array/") :]: array for name, array in members.items()}, wrapped["state"]


def _write_text(path: Path, text: str) -> None:
    def write(temporary: Path) -> None:
        temporary.write_text(text, encoding="utf-8")

    write_atomically(path, write)


def _write_json(path: Path, d: dict[str, Any]) -> None:
    plain = _plain({"schema": SCHEMA_VERSION, **d})
    _write_text(path, json.dumps(plain, indent=2, allow_nan=False) + "\n")


def _plain(value: Any) -> Any:
    """The value in JSON's types; NaN and infinity, which JSON lacks, become None."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (np.generic, np.ndarray, Path)):
        return _plain(_scalar(value))
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _scalar(value: Any) -> Any:
    """NumPy's numbers and arrays and paths as plain Python; TypeError for anything else."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} does not fit into a JSON file")


def _cell(column: str, value: Any) -> str:
    """A number as text that reads back as the same number; empty for None and NaN."""
    if column in _WHOLE_NUMBERS:
        return str(operator.index(value))
    if value is None or math.isnan(value):
        return ""
    return repr(float(value))


def _read_json(path: Path) -> dict[str, Any]:
    content = _parsed(path, lambda: json.loads(path.read_text(encoding="utf-8")))
    _check_schema(path, content)
    return content


def _check_schema(path: Path, content: Any) -> None:
    found = content.get("schema") if isinstance(content, dict) else None
    if found != SCHEMA_VERSION:
        raise InputError(f"{path}: schema version {found}; this isas reads {SCHEMA_VERSION}")


def _read_config(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    content = _parsed(path, lambda: yaml.safe_load(path.read_text(encoding="utf-8")))
    return content if isinstance(content, dict) else {}


def _read_history(path: Path) -> pandas.DataFrame:
    import pandas  # half a second: only who reads a run pays for it

    if path.is_file():
        # As text first: pandas' own parser of numbers may be off in the last digit.
        table = _parsed(path, lambda: pandas.read_csv(path, dtype=str).fillna("nan"))
    else:
        table = pandas.DataFrame({name: [] for name in _BEFORE_KEYS + _AFTER_KEYS})
    kinds = {c: "int64" if c in _WHOLE_NUMBERS else "float64" for c in table.columns}
    return _parsed(path, lambda: table.astype(kinds))


def _parsed(path: Path, parse: Callable[[], Any]) -> Any:
    try:
        return parse()
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise InputError(f"{path}: cannot be read: {_one_line(error)}") from error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
