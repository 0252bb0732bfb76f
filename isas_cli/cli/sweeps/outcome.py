"""How the jobs of a sweep ended, and the table that says so."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from ...engine.display import Stderr, number, say
from ...runtime import interrupt

# Columns where there is no terminal: the folders must stay whole.
_WIDTH = 200
_COLOURS = {"done": "green", "resumed": "green", "failed": "red", "interrupted": "yellow"}


@dataclass(frozen=True)
class Outcome:
    """One job: ``status`` is done, resumed (and done), skipped (done before), failed, interrupted
    or not begun; ``code`` the exit status that a single run would have had. The errors are the
    final ones, ``seconds`` the billed ones; None where not known."""

    label: str
    folder: Path
    status: str
    code: int = 0
    error: str = ""
    image: float | None = None
    parameter: float | None = None
    seconds: float | None = None

    @property
    def finished(self) -> bool:
        return self.status in ("done", "resumed", "skipped")

    @property
    def value(self) -> float | None:
        """What a search minimises: the final parameter error, or the image error where no truth
        is known; None for a job that did not finish."""
        value = self.image if self.parameter is None else self.parameter
        return value if self.finished else None


def outcome(label: str, folder: Path, status: str, code: int = 0, error: str = "") -> Outcome:
    """The outcome with the figures from the folder's summary."""
    summary = read_summary(folder) or {}
    final = summary.get("final") or {}
    return Outcome(
        label,
        folder,
        status,
        code,
        error,
        final.get("image_rmse"),
        final.get("parameter_rmse"),
        summary.get("seconds_billed"),
    )


def read_summary(folder: Path) -> dict | None:
    """summary.json as it is, or None where there is none that can be read."""
    try:
        content = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def exit_status(outcomes: list[Outcome]) -> int:
    """The first failure's; 130 when there is none but a job was interrupted; else 0."""
    failed = [o.code for o in outcomes if o.status == "failed"]
    if failed:
        return failed[0]
    return 0 if all(o.finished for o in outcomes) else interrupt.STATUS


def show(outcomes: list[Outcome], figures: bool = True) -> None:
    """The table, and below it why jobs failed, on standard error. ``figures``: errors and seconds,
    which single runs have."""
    console = Stderr(stderr=True)
    if not console.is_terminal:
        console = Stderr(stderr=True, width=_WIDTH)
    table = Table(box=None, pad_edge=False)
    table.add_column("job", overflow="fold")
    table.add_column("status", no_wrap=True)
    for title in ("image error", "parameter error", "seconds") if figures else ():
        table.add_column(title, justify="right")
    table.add_column("folder", overflow="fold")
    for o in outcomes:
        colour = _COLOURS.get(o.status, "")
        numbers = (number(o.image, ".4g"), number(o.parameter, ".4g"), number(o.seconds, ".1f"))
        status = f"[{colour}]{o.status}[/]" if colour else o.status
        numbers = numbers if figures else ()
        table.add_row(escape(o.label), status, *numbers, escape(shown(o.folder)))
    console.print(table, highlight=False)
    for o in outcomes:
        if o.error:
            say(f"isas: {o.label}: {o.error}")


def shown(folder: Path) -> str:
    """The folder as seen from here, where that is shorter."""
    relative = os.path.relpath(folder)
    return str(folder) if relative.startswith("..") else relative
