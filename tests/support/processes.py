"""The command in a process of its own."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ISAS = [sys.executable, "-m", "isas_cli"]
_IGNORED = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
# A terminal that is gone, as a test's parameter.
HANGUP = pytest.param(
    signal.SIGHUP,
    marks=[pytest.mark.slow, pytest.mark.skipif(_IGNORED, reason="what runs under nohup goes on")],
)
PIPES = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}


def isas(folder: Path, *arguments: str, by=ISAS, **more) -> subprocess.CompletedProcess:
    """What has become of it in that folder."""
    return subprocess.run([*by, *arguments], cwd=folder, timeout=300, **PIPES, **more)


def started(folder: Path, *arguments: str, by=ISAS, **more) -> subprocess.Popen:
    return subprocess.Popen([*by, *arguments], cwd=folder, **PIPES, **more)


def until(process: subprocess.Popen, reached: Callable[[], Any]) -> Any:
    """What ``reached`` gives as soon as it is anything, while the process goes on."""
    end = time.monotonic() + 200
    while not (found := reached()):
        if time.monotonic() > end:
            process.kill()
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    return found


def begun(
    folder: Path, *arguments: str, rows: int, runs: int = 1, below: str = "", by=ISAS
) -> tuple[subprocess.Popen, list[Path]]:
    """The process, once ``runs`` runs ``below`` the folder have so many rows; and their folders."""
    process = started(folder, *arguments, by=by)

    def reached() -> list[Path]:
        histories = Path(folder, below).rglob("history.csv")
        found = [h.parent for h in histories if len(h.read_text().splitlines()) > rows]
        return found if len(found) >= runs else []

    return process, until(process, reached)
