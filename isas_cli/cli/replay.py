"""`isas replay`: one iteration of a run again, and what in it is not finite."""

from __future__ import annotations

import re
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..runtime import interrupt
from ..runtime.errors import InputError


def main(folder: Path, iteration: str | None = None) -> int:
    """Print what is not finite in an iteration of the run in ``folder``; ``iteration``: which, as
    iteration=N. Raises InputError; returns 0 where all is finite, else 3."""
    number = re.fullmatch(r"iteration=(\d{1,8})", iteration or "iteration=0")
    if not number:
        raise InputError(f"{iteration}: give iteration=N, a whole number from 0 on")
    from ..engine import experiment

    with interrupt.prompt():
        found = experiment.replay(folder, int(number[1]) if iteration else None)
    console = Console()
    console.print(f"iteration {found.iteration}, at the values of the checkpoint")
    table = Table("unknown", "entries of the gradient", "not finite")
    for key, (bad, entries) in found.entries.items():
        table.add_row(escape(key), str(entries), str(bad))
    console.print(table)
    if found.places:
        table = Table("view", "column", "row", "not finite", title=f"{found.paths} paths to blame")
        for place in found.places:
            table.add_row(str(place.view), str(place.column), str(place.row), escape(place.what))
        console.print(table)
    return 3 if found.paths or any(bad for bad, _ in found.entries.values()) else 0
