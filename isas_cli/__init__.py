"""isas: recover scene parameters from images, and measure what each way of sampling costs.

From Python, as from the command line:

    import isas_cli

    run = isas_cli.run("scene=pottery", "budget.seconds=20")
    run.history.plot("seconds", "image_rmse")       # a pandas DataFrame, a row per evaluation
    texture = run.parameters()["jar.bsdf.base_color.data"]
    earlier = isas_cli.load("runs/pottery/uniform/…")
"""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING

from .runtime import llvm
from .runtime.errors import InputError

if TYPE_CHECKING:
    from .records import Run
else:

    def __getattr__(name):  # imports NumPy, which `isas --help` does without
        if name != "Run":
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from .records import Run

        return Run


llvm.prepare()
__version__ = "0.1.0"
__all__ = ["Run", "load", "run"]
_running = threading.Lock()


def run(*settings: str) -> Run:
    """Runs what ``isas run`` with the same ``settings`` runs, and reads its record back.

    Progress goes to standard error. After Ctrl-C the record is complete up to there. Mitsuba's
    variant and Dr.Jit's threads are afterwards what they were. One run at a time: several at once
    are for processes of their own. Raises ``runtime.errors.InputError`` for settings that make no
    sense, and ``NumericalError`` where the estimates are mostly non-finite (the record holds the
    last good state).
    """
    from .cli.run import folder_of
    from .config import searchpath

    for each in settings:
        if not isinstance(each, str):
            kind = type(each).__name__
            raise InputError(f'a setting is given as {kind}: give texts, run("KEY=VALUE", …)')
    if not _running.acquire(blocking=False):
        raise InputError(
            "another run goes on in this process: make one after the other, or each in a process "
            "of its own"
        )
    try:
        with searchpath.asked(list(settings)) as rest:
            return load(folder_of(rest))
    finally:
        _running.release()


def load(folder: str | Path) -> Run:
    """The record in a run's folder: ``config``, ``manifest``, ``history`` (a pandas DataFrame),
    ``summary``, ``parameters()`` and ``frame(name)``. Raises ``runtime.errors.InputError``."""
    from . import records

    return records.load(Path(folder).absolute())  # programs go to other folders
