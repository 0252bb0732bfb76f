"""Reading a run's record back, typed."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from ..runtime.errors import InputError, nearest
from .files import (
    AFTER_KEYS,
    BEFORE_KEYS,
    KEY_PREFIX,
    OWN_UNIT,
    WHOLE_NUMBERS,
    check_schema,
    one_line,
    parsed,
)

if TYPE_CHECKING:
    import pandas

_VALUE = "value/"  # of a checkpoint's arrays


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
    def complete(self) -> bool:
        """Whether the run has ended and its record, pictures included, with it."""
        return self.summary is not None and bool(self.summary.get("complete", True))

    def parameters(self) -> dict[str, np.ndarray]:
        """The unknowns where the run stands, by key, float32 in their own shapes; of one that has
        not come to its last level as coarse as it is. Raises InputError where there is no
        checkpoint, or the folder was written by another run, or went on, since it was loaded."""
        self._check_same()
        arrays, _ = load_checkpoint(self.folder)
        return {k[len(_VALUE) :]: array for k, array in arrays.items() if k.startswith(_VALUE)}

    def frame(self, name: str) -> np.ndarray:
        """frames/``name``.exr, such as ``result_v00``: ``(H, W, 3) float32``, linear. Raises
        InputError like ``parameters`` and, naming what there is, where there is none of this
        name."""
        from ..runtime import images  # loads OpenImageIO, which who reads numbers need not wait for

        self._check_same()
        path = self.folder / "frames" / f"{name}.exr"
        if not path.is_file():
            names = sorted(each.stem for each in path.parent.glob("*.exr"))
            raise InputError(f"{path}: no such frame; {nearest(name, names)}")
        return images.read(path, finite=False)

    def _check_same(self) -> None:
        """A manifest is written when a run begins and when it goes on."""
        if read_json(self.folder / "manifest.json") != self.manifest:
            raise InputError(f"{self.folder} was written again since it was loaded: load it anew")

    @property
    def parameter_rmse_is(self) -> str:
        """What the column `parameter_rmse` is in: a unit, or what else its values are."""
        return self.manifest.get("parameter_rmse_is") or OWN_UNIT

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
    return _run(folder, read_json(folder / "manifest.json"))


def load_failed(folder: Path) -> Run:
    """What is known of a sweep's job that failed before it had a record: its settings and, in its
    summary, why and by which process. Raises InputError for a file that is damaged."""
    summary = read_json(Path(folder) / "summary.json")
    return _run(Path(folder), summary.get("process") or {})


def _run(folder: Path, manifest: dict[str, Any]) -> Run:
    has_summary = (folder / "summary.json").is_file()
    return Run(
        folder=folder,
        config=_read_config(folder / "config.yaml"),
        manifest=manifest,
        history=_read_history(folder / "history.csv"),
        summary=read_json(folder / "summary.json") if has_summary else None,
    )


def load_checkpoint(
    folder: Path, arrays: bool = True
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The ``arrays``, if wanted, and the state that `RunWriter.checkpoint` last wrote. Raises
    InputError when there is none, it is damaged, or it was written under another schema version."""
    path = Path(folder) / "checkpoint" / "state.npz"
    if not path.is_file():
        raise InputError(f"{folder} holds no checkpoint: it has no checkpoint/state.npz")
    try:
        with open(path, "rb") as stored, np.load(stored, allow_pickle=False) as file:
            members = {n: file[n] for n in (file.files if arrays else ["state"])}
        wrapped = json.loads(members.pop("state").tobytes().decode())
    except Exception as error:  # numpy, zipfile and json each have their own kinds for damage
        raise InputError(f"{path}: damaged: {one_line(error)}") from error
    check_schema(path, wrapped)
    return {name[len("array/") :]: array for name, array in members.items()}, wrapped["state"]


def read_json(path: Path) -> dict[str, Any]:
    content = parsed(path, lambda: json.loads(path.read_text(encoding="utf-8")))
    check_schema(path, content)
    return content


def _read_config(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    content = parsed(path, lambda: yaml.safe_load(path.read_text(encoding="utf-8")))
    return content if isinstance(content, dict) else {}


def _read_history(path: Path) -> pandas.DataFrame:
    import pandas  # half a second: only who reads a run pays for it

    if path.is_file():
        # As text first: pandas' own parser of numbers may be off in the last digit.
        table = parsed(path, lambda: pandas.read_csv(path, dtype=str).fillna("nan"))
    else:
        table = pandas.DataFrame({name: [] for name in BEFORE_KEYS + AFTER_KEYS})
    kinds = {c: "int64" if c in WHOLE_NUMBERS else "float64" for c in table.columns}
    return parsed(path, lambda: table.astype(kinds))


def read_rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """Column names and rows of a history.csv as text; nothing where there is none."""
    if not path.is_file():
        return [], []
    text = parsed(path, lambda: path.read_text(encoding="utf-8"))
    columns, *rows = list(csv.reader(io.StringIO(text))) or [[]]
    return columns, rows
