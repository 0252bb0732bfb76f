"""`isas report`: a run's plots and page anew."""

from __future__ import annotations

from pathlib import Path

from ..report import write


def main(folder: Path) -> int:
    """Print where the page of the run in ``folder`` is. Raises InputError."""
    print(write(folder))
    return 0
