"""Where else evaluations and pictures go while a run is on: nowhere, or to TensorBoard.

A tracker only repeats what the record holds already, so nothing that goes wrong with its files may
end a run: it warns once and stays silent from then on.
"""

from __future__ import annotations

import contextlib
import importlib.util
import math
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from ..runtime.errors import InputError, extra, nearest

if TYPE_CHECKING:
    import numpy as np

NAMES = ("none", "tensorboard")


class Tracker:
    """What the recorder tells, besides writing its own files: nobody."""

    def evaluation(self, row: dict[str, Any]) -> None:
        """A new row of the history, in the columns of history.csv."""

    def image(self, name: str, picture: np.ndarray, iteration: int, exposure: float = 1.0) -> None:
        """A picture on the way: (H, W, 3) linear, shown through `images.to_display`."""

    def close(self) -> None:
        """The run has ended; nothing follows."""


def check(name: str) -> None:
    """Raises InputError, before anything is computed, for a tracker that `open` could not open."""
    if name not in NAMES:
        raise InputError(f"tracker={name}: no such tracker; {nearest(name, NAMES)}")
    if name == "tensorboard" and importlib.util.find_spec("tensorboardX") is None:
        raise InputError(
            f"tracker=tensorboard needs tensorboardX, which is not installed: {extra(name)}"
        )


def open(
    name: str,
    folder: Path,
    config_text: str,
    purge_step: int | None = None,
    warn: Callable[[str], None] = lambda text: print(text, file=sys.stderr),
) -> Tracker:
    """The tracker called `name`, one of `NAMES`, for the run in `folder`.

    config_text  the resolved configuration, YAML
    purge_step   of a run that goes on: the first iteration that is written anew; what an earlier
                 process wrote from there on is no longer shown
    warn         takes the one line that is said when the files cannot be written

    Raises InputError like `check`.
    """
    check(name)
    if name == "none":
        return Tracker()
    return _TensorBoard(Path(folder) / "tensorboard", config_text, purge_step, warn)


class _TensorBoard(Tracker):
    """Events that TensorBoard reads: scalars under the names of history.csv, the configuration as
    text and as hyperparameters, pictures.

    An event's step is the iteration. Its time is that of the run's first event plus the billed
    seconds, so that TensorBoard's horizontal axis "Relative" is billed time, also over a resumption
    and between runs; the true time of day is in none of them.

    Written in the loop's own thread, between iterations: tensorboardX's SummaryWriter writes from
    a thread of its own, within billed time, and waits for ever once that has died of a full disk.
    """

    def __init__(
        self,
        folder: Path,
        config_text: str,
        purge_step: int | None,
        warn: Callable[[str], None],
    ):
        from tensorboardX import summary
        from tensorboardX.event_file_writer import EventsWriter
        from tensorboardX.proto import event_pb2

        self._summary, self._events = summary, event_pb2
        self._folder, self._warn, self._seconds = folder, warn, 0.0
        self._writer: EventsWriter | None = None
        self._begun = 0.0
        with self._tolerant():
            folder.mkdir(parents=True, exist_ok=True)
            # The names have whole seconds: two within one of them must not be one file.
            self._writer = EventsWriter(str(folder / "events"), f".{time.monotonic_ns()}")
            self._begun = _begun(folder)
            if purge_step is not None:
                log = event_pb2.SessionLog(status=event_pb2.SessionLog.START)
                self._write(step=purge_step, session_log=log)
            indented = "".join(f"    {line}\n" for line in config_text.splitlines())
            self._write(step=0, summary=summary.text("config", indented))  # Markdown for code
            errors = dict.fromkeys(("image_rmse", "parameter_rmse"))
            experiment, session, _ = summary.hparams(_settings(config_text), errors)
            self._write(step=0, summary=experiment)
            self._write(step=0, summary=session)
            self._writer.flush()

    def evaluation(self, row: dict[str, Any]) -> None:
        """Scalars of every column that is known in `row`."""
        self._seconds = float(row["seconds"])
        with self._tolerant():
            for name, value in row.items():
                if name != "iteration" and value is not None and not math.isnan(value):
                    made = self._summary.scalar(name, float(value))
                    self._write(step=int(row["iteration"]), summary=made)
            self._flush()

    def image(self, name: str, picture: np.ndarray, iteration: int, exposure: float = 1.0) -> None:
        """An 8-bit picture at the time of the last evaluation."""
        from ..runtime.images import to_display

        shown = to_display(picture, exposure)
        with self._tolerant():
            made = self._summary.image(name, shown, dataformats="HWC")
            self._write(step=iteration, summary=made)
            self._flush()

    def close(self) -> None:
        """Everything is on the disk already; gives the file back."""
        with self._tolerant():
            if self._writer is not None:
                self._writer.close()
                self._writer = None

    def _write(self, step: int, **content: Any) -> None:
        if self._writer is not None:
            moment = self._begun + self._seconds
            self._writer.write_event(self._events.Event(wall_time=moment, step=step, **content))

    def _flush(self) -> None:
        if self._writer is not None:
            self._writer.flush()

    @contextlib.contextmanager
    def _tolerant(self) -> Iterator[None]:
        """Within it an OSError (disk full, no permission) silences the tracker, with a warning."""
        try:
            yield
        except OSError as error:
            writer, self._writer = self._writer, None
            reason = error.strerror or error
            with contextlib.suppress(OSError):  # what could not be written still cannot
                if writer is not None:
                    writer.close()
            with contextlib.suppress(OSError):  # standard error may be on that disk, too
                self._warn(
                    f"warning: tracker=tensorboard: {self._folder}: {reason}; no more events, "
                    "the run goes on"
                )


def _begun(folder: Path) -> float:
    """The time, in seconds since 1970, at which the first file of events in `folder` was begun."""
    # Their names are events.out.tfevents.<seconds>.<host>…
    return float(min(path.name.split(".")[3] for path in folder.glob("events.out.tfevents.*")))


def _settings(config_text: str) -> dict[str, Any]:
    """The configuration as one level of dotted keys, lists as text."""
    flat: dict[str, Any] = {}

    def add(prefix: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, item in value.items():
                add(f"{prefix}.{key}" if prefix else str(key), item)
        else:
            flat[prefix] = str(value) if isinstance(value, list) else value

    add("", yaml.safe_load(config_text) or {})
    return flat
