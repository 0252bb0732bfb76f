"""Writing one run's record."""

from __future__ import annotations

import csv
import errno
import fcntl
import io
import json
import math
import operator
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..runtime.errors import InputError
from . import manifest
from .files import (
    AFTER_KEYS,
    BEFORE_KEYS,
    KEY_PREFIX,
    SCHEMA_VERSION,
    VALUE_PREFIX,
    WHOLE_NUMBERS,
    scalar,
    write_atomically,
    write_json,
    write_text,
)
from .reader import load_checkpoint, read_json, read_rows

RECORD_FILES = ("manifest.json", "config.yaml", "history.csv", "summary.json")
# How names of pictures and meshes begin: others in such folders may be a user's own.
_UNKNOWNS = ("start", "result", "truth")
_FRAMES = (*_UNKNOWNS, "target", "error", "density", "progress", "held")
_MADE_FILES = (
    "profile.csv",
    "error.txt",
    "report.html",
    "landscape.csv",
    *(f"frames/{what}_*.{form}" for what in _FRAMES for form in ("exr", "png")),
    *(f"meshes/{what}_*" for what in (*_UNKNOWNS, "turntable", "turning")),
    "plots/*.png",
    "checkpoint/state.npz",
    "tensorboard/events.*",
    "relit/scores.json",
    "result/scene.*",
)
# Of a killed run.
_WRITTEN = "", "frames/", "meshes/", "plots/", "checkpoint/"
_LEFT_OVER = tuple(f"{where}.*.tmp" for where in _WRITTEN)
# What disks without locks answer: Lustre with noflock, NFS without a lock daemon.
_NO_LOCKS = errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP
_GOOD = "meshes/good_"  # what is doubted, as it was before


class RunWriter:
    """Writes the files of one run into `folder`.

    Raises InputError when the folder cannot be written, or already holds a run and `overwrite` is
    false, or another process writes it. With `overwrite` the earlier run's files go, and nothing
    else that lies in the folder.
    Every method raises IsasError, one line naming the file, when the disk refuses.
    """

    def __init__(self, folder: Path, overwrite: bool = False):
        self.folder = Path(folder)
        self._columns: list[str] = []
        self._rows: list[list[str]] = []
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._claim()
            if any((self.folder / name).exists() for name in RECORD_FILES):
                if not overwrite:
                    message = "already holds a run; choose another folder with hydra.run.dir=DIR"
                    raise InputError(f"{self.folder} {message}")
                for pattern in (*RECORD_FILES, *_MADE_FILES, *_LEFT_OVER, f"{_GOOD}*"):
                    for old in self.folder.glob(pattern):
                        old.unlink()
        except OSError as error:
            raise InputError(
                f"cannot write to the output folder {self.folder}: {error.strerror or error}; "
                "choose another with hydra.run.dir=DIR"
            ) from error

    @classmethod
    def reopen(
        cls, folder: Path, iteration: int, state: dict[str, Any] | None = None
    ) -> "RunWriter":
        """The writer of a run that goes on after ``iteration``: rows and snapshots beyond
        it, made after the checkpoint that is continued, go and will be made again, and so does
        the summary of the earlier end. ``state``: that checkpoint's, as it was read. Raises
        InputError when the folder cannot be written, when another process writes it, and when one
        has written another checkpoint since."""
        writer = cls.__new__(cls)
        writer.folder = Path(folder)
        try:
            writer._claim()
            if state is not None:
                writer._check_still(state)
            columns, rows = read_rows(writer.folder / "history.csv")
            writer._columns = columns
            place = columns.index("iteration") if columns else 0
            writer._rows = [row for row in rows if int(row[place]) <= iteration]
            if columns:
                writer._history()
            for name in ("summary.json", "error.txt"):
                (writer.folder / name).unlink(missing_ok=True)
            for old in writer.folder.glob("frames/progress_*_i*"):
                made = re.fullmatch(r".*_i(\d+)", old.stem)  # a user's own copy is called otherwise
                if made and int(made[1]) > iteration:
                    old.unlink()
            for pattern in _LEFT_OVER:
                for old in writer.folder.glob(pattern):
                    old.unlink()
        except OSError as error:
            raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from error
        return writer

    def _check_still(self, state: dict[str, Any]) -> None:
        """Raises InputError unless the checkpoint is that of ``state``."""
        _, now = load_checkpoint(self.folder, arrays=False)
        if any(now[name] != state[name] for name in ("iteration", "billed")):
            self.release()
            raise InputError(
                f"{self.folder}: another process went on with it meanwhile, from iteration "
                f"{state['iteration']} to {now['iteration']}: once it has ended, resume again"
            )

    def _claim(self) -> None:
        """Keep other processes out for as long as this one lives, where the disk has locks; the
        system ends it with it."""
        self._lock = open(self.folder / ".lock", "w")
        try:
            fcntl.lockf(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError) as error:
            raise InputError(
                f"{self.folder} is still being written: its process has not ended"
            ) from error
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            self._check_alone()

    def _check_alone(self) -> None:
        """By the record alone. Raises InputError."""
        try:
            known = read_json(self.folder / "manifest.json")
        except InputError:  # none yet
            return
        if manifest.alive(known):
            raise InputError(f"{self.folder} is still being written: its process has not ended")

    def release(self) -> None:
        """Others may write the folder: of a notebook the process lives on."""
        self._lock.close()

    @property
    def rows(self) -> list[dict[str, float]]:
        """The rows of history.csv so far, as numbers; cells that are not known are left out."""
        return [
            {
                name: int(cell) if name in WHOLE_NUMBERS else float(cell)
                for name, cell in zip(self._columns, row)
                if cell
            }
            for row in self._rows
        ]

    def config(self, text_yaml: str) -> None:
        """The resolved configuration, as YAML text."""
        write_text(self.folder / "config.yaml", text_yaml)

    def manifest(self, d: dict[str, Any]) -> None:
        """What the run was made with: versions, machine, seeds, hashes. The schema is added."""
        write_json(self.folder / "manifest.json", d)

    def evaluation(self, row: dict[str, Any]) -> None:
        """Adds a row to history.csv.

        row: the columns of the module's tables, `seconds` billed, `paths` light paths traced within
        billed time; `parameter_rmse/<key>` may stand for any number of keys, the same in all rows,
        and so may `value/<key>` and `value/<key>/<name>`, numbers that tell of an unknown.
        A missing or None value stays empty, which reads as NaN; the whole-number columns must be
        there. Raises ValueError for a column that is not known.
        """
        if not self._columns:
            keys = [name for name in row if name.startswith(KEY_PREFIX)]
            self._columns = BEFORE_KEYS + keys + AFTER_KEYS
        for name in row:
            if name.startswith(VALUE_PREFIX) and name not in self._columns:
                self._columns.append(name)
                self._rows = [[*earlier, ""] for earlier in self._rows]
        strange = sorted(set(row) - set(self._columns))
        if strange:
            raise ValueError(f"history.csv has no column {', '.join(strange)}")
        self._rows.append([_cell(name, row.get(name)) for name in self._columns])
        self._history()

    def _history(self) -> None:
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(self._columns)
        table.writerows(self._rows)
        write_text(self.folder / "history.csv", text.getvalue())

    def summary(self, d: dict[str, Any]) -> None:
        """How the run ended. The schema is added; NaN and infinity become null."""
        write_json(self.folder / "summary.json", d)

    def frame(
        self,
        name: str,
        image: np.ndarray,
        channels: list[str],
        metadata: dict[str, Any],
        exposure: float | None = None,
        data: bool = False,
    ) -> None:
        """frames/<name>.exr, the arguments those of `images.write_exr`; with an ``exposure`` also
        frames/<name>.png, as `images.write_preview` shows it."""
        # Imported here: readers need no OpenImageIO.
        from ..runtime.images import write_exr, write_preview

        path = self.folder / "frames" / f"{name}.exr"
        write_exr(path, image, channels, metadata, data)
        if exposure is not None:
            write_preview(path.with_suffix(".png"), image, exposure, metadata, data)

    def good(self, name: str, files: dict[str, bytes]) -> None:
        """meshes/good_<name>.<extension>, in place of such as there are: a shape as it was before
        it was doubted; ``files`` by extension, none of one that is not."""
        for extension, content in files.items():
            self.mesh(f"good_{name}.{extension}", content)
        for old in self.folder.glob(f"{_GOOD}{name}.*"):
            if old.suffix[1:] not in files:
                old.unlink()

    def mesh(self, name: str, content: bytes) -> None:
        """meshes/<name>: a shape for other programs."""
        path = self.folder / "meshes" / name
        write_atomically(path, lambda temporary: temporary.write_bytes(content))

    def checkpoint(self, arrays: dict[str, np.ndarray], state: dict[str, Any]) -> None:
        """Arrays (any names; ValueError for objects) and JSON state, swapped in as one file."""
        members = {f"array/{name}": np.asarray(array) for name, array in arrays.items()}
        if any(member.dtype.hasobject for member in members.values()):
            raise ValueError("a checkpoint holds arrays of numbers, not of Python objects")
        text = json.dumps({"schema": SCHEMA_VERSION, "state": state}, default=scalar)
        members["state"] = np.frombuffer(text.encode(), dtype=np.uint8)

        def write(temporary: Path) -> None:
            with open(temporary, "wb") as file:  # a path would get a second extension
                np.savez(file, **members)  # type: ignore[arg-type]

        write_atomically(self.folder / "checkpoint" / "state.npz", write)


def _cell(column: str, value: Any) -> str:
    """A number as text that reads back as the same number; empty for None and NaN."""
    if column in WHOLE_NUMBERS:
        return str(operator.index(value))
    if value is None or math.isnan(value):
        return ""
    return repr(float(value))
