"""How a run stands, told from its files alone while another process writes them."""

from __future__ import annotations

import datetime
import math
import os
import platform
import time
from collections.abc import Container
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import psutil

from ..runtime.budget import Budget
from ..runtime.errors import InputError
from .files import walked
from .reader import Run, load, load_failed, read_json

RUNNING, KILLED, UNREADABLE = "running", "killed", "unreadable"
_READ = ("manifest.json", "config.yaml", "history.csv", "summary.json")
_NEWS = ("manifest.json", "history.csv", "checkpoint/state.npz", "summary.json")
# While a run is begun anew (overwrite=true) its files go one by one.
_TRIES, _PAUSE_SECONDS = 3, 0.1


def find(folder: Path, known: Container[Path] = ()) -> list[Path]:
    """The folders of all runs at or below `folder`, sorted; none lies within another. Among them
    are jobs that failed before they had a record, and folders that cannot be read. ``known``: runs
    that were found before, whose manifests need not be read again."""
    found: list[Path] = []

    def unread(error: OSError) -> None:
        if not isinstance(error, FileNotFoundError):  # it went away meanwhile
            found.append(Path(error.filename))

    for place, folders, files in walked(folder, unread):
        if "manifest.json" in files:
            folders.clear()
            if place in known or not measures(place):
                found.append(place)
        elif "summary.json" in files and failed(place):
            found.append(place)
    return sorted(found)


def measures(folder: Path) -> bool:
    """Whether this is what `isas variance` wrote: a measurement, not a run."""
    try:
        return "variance" in read_json(folder / "manifest.json")
    except InputError:
        return False


def failed(folder: Path) -> bool:
    """Whether this is what a sweep's job left that failed before it had a record."""
    try:
        return read_json(folder / "summary.json").get("status") == "failed"
    except InputError:
        return False


def alive(manifest: dict[str, Any]) -> bool | None:
    """Whether the process that last wrote the run still exists; None where that cannot be known:
    it ran on another machine or in another container, or an older isas did not record it."""
    latest = [manifest, *manifest.get("resumed", [])][-1]
    pid, started = latest.get("pid"), latest.get("started")
    if not pid or not started or latest.get("host") != platform.node():
        return None
    if latest.get("pid_namespace", ours := pid_namespace()) != ours:
        return None
    try:
        since = datetime.datetime.fromisoformat(started).timestamp()
        process = psutil.Process(pid)
        if process.status() == psutil.STATUS_ZOMBIE:
            return False
        if latest.get("ticks") and (ticks := ticks_of(pid)):
            return ticks == latest["ticks"]
        begun = process.create_time()
    except psutil.NoSuchProcess:
        return False
    except (psutil.Error, TypeError, ValueError):  # there is one, or the record is damaged
        return None
    # A number is given again: a process that began after the run is another. The manifest's time
    # is cut to seconds, and a process's is only known to within a clock tick.
    return begun <= since + 1


def unended(manifest: dict[str, Any]) -> str:
    """How a run without a summary stands, in words."""
    found = alive(manifest)
    if found is None:
        return "killed, or not yet at its end"
    if found:
        return "still running, or ended by an error"
    return "no summary: stopped before it could end its record"


def pid_namespace() -> str | None:
    """In which the numbers of processes hold: containers have their own, and may share a host's
    name. None where that cannot be known."""
    try:
        return os.readlink("/proc/self/ns/pid")
    except OSError:
        return None


def ticks_of(pid: int) -> int | None:
    """When a process began, in clock ticks since the machine did: setting the time of day leaves it
    as it is. None where that cannot be known."""
    try:
        content = Path(f"/proc/{pid}/stat").read_bytes()
    except OSError:
        return None
    # The second field, a name in brackets, may hold anything; this is the twenty-second.
    return int(content.rpartition(b")")[2].split()[19])


class Follower:
    """One run's folder, read again whenever its files have changed.

    run: what was read last; None as long as there is no run. problem: why it could not be read at
    the last update, in one line; None where it could.
    """

    def __init__(self, folder: Path):
        self.folder = Path(folder)
        self.run: Run | None = None
        self.problem: str | None = None
        self._seen: list[tuple | None] | None = None

    def update(self) -> bool:
        """Reads what has changed since the last update. Returns whether anything has."""
        now = [_stamp(self.folder / name) for name in _READ]
        if now == self._seen:
            return False
        self._seen = now
        try:
            self.run, self.problem = _read(self.folder), None
        except InputError as error:
            self.problem = str(error)
        return True

    def status(self) -> str:
        """`RUNNING`, `KILLED`, `UNREADABLE`, or how the run ended by its own summary."""
        if self._gone():
            self.update()  # it may have ended since
        if self.problem:
            return UNREADABLE
        if self.run is None:
            return RUNNING
        if self.run.summary is not None:
            return str(self.run.summary.get("status"))
        return KILLED if self._gone() else RUNNING

    def _gone(self) -> bool:
        """Whether there is no process and no summary."""
        run = self.run
        return run is not None and run.summary is None and alive(run.manifest) is False

    def silence(self) -> float:
        """Seconds since the run last wrote a row or a checkpoint."""
        stamps = [_stamp(self.folder / name) for name in _NEWS]
        latest = max((stamp[1] for stamp in stamps if stamp), default=time.time_ns())
        return max(0.0, (time.time_ns() - latest) / 1e9)


def _stamp(path: Path) -> tuple[int, int, int] | None:
    """What differs once another version of a file has been swapped in."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size


def _read(folder: Path) -> Run | None:
    for attempt in range(_TRIES):
        try:
            files = os.listdir(folder)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InputError(f"{folder}: {error.strerror}") from error
        if "manifest.json" not in files:
            return load_failed(folder) if failed(folder) else None
        try:
            return load(folder)
        except InputError:
            if attempt == _TRIES - 1:
                raise
            time.sleep(_PAUSE_SECONDS)
    return None


@dataclass(frozen=True)
class Standing:
    """What is worth saying of a run as it stands.

    labels: scene, sampler, loss and seed, as far as they are on record. budget: None where there is
    none on record. first, last: rows of the history, without what is not known; empty before there
    is one. rate: light paths a billed second since the row before the last, None before there is.
    """

    labels: tuple[str, ...]
    budget: Budget | None
    first: dict[str, float]
    last: dict[str, float]
    rate: float | None

    @classmethod
    def of(cls, run: Run, rows: int | None = None) -> Standing:
        """Reads it off a run, after so many of its rows (None: all)."""
        config = run.config
        rows = len(run.history) if rows is None else rows
        named = [config.get(group) for group in ("scene", "sampler", "loss")]
        labels = [str(group["name"]) for group in named if isinstance(group, dict)]
        if "seed" in config:
            labels.append(f"seed {config['seed']}")
        last = _row(run, rows - 1)
        before = _row(run, rows - 2)
        seconds = last["seconds"] - before["seconds"] if before else 0.0
        return cls(
            labels=tuple(labels),
            budget=_budget(config),
            first=_row(run, 0),
            last=last,
            rate=(last["paths"] - before["paths"]) / seconds if seconds > 0 else None,
        )

    @property
    def spent(self) -> float | None:
        """The share of the budget that the last row had used, from 0 to 1."""
        if self.budget is None or not self.last:
            return None
        last = self.last
        return self.budget.spent(last["seconds"], int(last["iteration"]), int(last["paths"]))

    def share(self, name: str) -> float | None:
        """An error over what it was at the start; None where either is not known."""
        first, last = self.first.get(name), self.last.get(name)
        return last / first if first and last is not None else None

    @property
    def warnings(self) -> list[str]:
        """What should worry whoever watches, each in a few words."""
        found = []
        if self.last.get("nonfinite"):
            found.append(f"{self.last['nonfinite']:,.0f} gradient entries were not finite so far")
        for name in ("image_rmse", "parameter_rmse"):
            share = self.share(name)
            if share is not None and share > 1:
                found.append(f"{name} is {share:.3g} times what it was at the start")
        return found


def _row(run: Run, index: int) -> dict[str, float]:
    """A row of the history by column, without what is not known; nothing outside the table."""
    if not 0 <= index < len(run.history):
        return {}
    row = run.history.iloc[index].to_dict()
    return {name: value for name, value in row.items() if not math.isnan(value)}


def _budget(config: dict[str, Any]) -> Budget | None:
    limits = config.get("budget")
    if not isinstance(limits, dict):
        return None
    return Budget(*(limits.get(each.name) for each in fields(Budget)))
