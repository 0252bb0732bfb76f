"""isas: recover scene parameters from images, and measure what each way of sampling costs.

From Python, as from the command line:

    import isas_cli

    run = isas_cli.run("scene=pottery", "budget.seconds=20")
    run.history.plot("seconds", "image_rmse")       # a pandas DataFrame, a row per evaluation
    texture = run.parameters()["jar.bsdf.base_color.data"]
    earlier = isas_cli.load("runs/pottery/uniform/…")
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from .runtime import llvm

if TYPE_CHECKING:
    from .records import Run

llvm.prepare()
__version__ = "0.1.0"
__all__ = ["load", "run"]


def run(*settings: str) -> Run:
    """Runs what ``isas run`` with the same ``settings`` runs, and reads its record back.

    Progress goes to standard error. After Ctrl-C the record is complete up to there. Raises
    ``runtime.errors.InputError`` for settings that make no sense, and ``NumericalError`` where the
    estimates are mostly non-finite (the record holds the last good state).
    """
    from .cli.run import folder_of
    from .config import searchpath

    with searchpath.asked(list(settings)) as rest:
        return load(folder_of(rest))


def load(folder: str | Path) -> Run:
    """The record in a run's folder: ``config``, ``manifest``, ``history`` (a pandas DataFrame),
    ``summary``, ``parameters()`` and ``frame(name)``. Raises ``runtime.errors.InputError``."""
    from . import records

    return records.load(Path(folder).absolute())  # programs go to other folders
