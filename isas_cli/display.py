"""What a person sees while a run goes on."""

from __future__ import annotations

import sys
import time

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

# Plain lines: one per evaluation; for targets at most one every so many seconds.
_QUIET_SECONDS = 5.0
# Redrawing is host time: not more often than a person can read.
_REDRAW_SECONDS = 0.25


def _number(value) -> str:
    return "–" if value is None or value != value else f"{value:.3g}"


class Display:
    """A live line in a terminal, plain lines elsewhere. Writes to standard error."""

    def __init__(self) -> None:
        self.console = Console(stderr=True)
        self.live = self.console.is_terminal and sys.stderr.isatty()
        self._bar: Progress | None = None
        self._last = 0.0

    def __enter__(self) -> "Display":
        if self.live:
            self._bar = Progress(
                SpinnerColumn(),
                TextColumn("{task.description}"),
                BarColumn(bar_width=24),
                TextColumn("{task.fields[text]}"),
                console=self.console,
                transient=True,
                refresh_per_second=4,
            )
            self._task = self._bar.add_task("", total=1.0, text="")
            self._bar.start()
        return self

    def __exit__(self, *unused) -> None:
        if self._bar:
            self._bar.stop()

    def say(self, text: str) -> None:
        """A lasting line."""
        self.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def phase(self, name: str) -> None:
        """Work of another kind begins."""
        if self._bar:
            self._bar.update(self._task, description=name, completed=0.0, text="")
        self._last = time.monotonic()

    def targets(self, done: int, total: int) -> None:
        """Progress of rendering targets, in light paths."""
        if self._bar:
            self._bar.update(
                self._task, completed=done / total, text=f"{done / 1e6:.0f} of {total / 1e6:.0f} M paths"
            )
        elif time.monotonic() - self._last > _QUIET_SECONDS or done == total:
            self._last = time.monotonic()
            self.say(f"targets {100 * done / total:.0f} %")

    def evaluated(self, row: dict) -> None:
        """A new row of the history: always a line where there is no terminal."""
        if not self.live:
            self.say(_line(row))

    def stepped(self, loop, progress: float) -> None:
        """After each iteration; redraws at most a few times a second."""
        now = time.monotonic()
        if not self._bar or now - self._last < _REDRAW_SECONDS:
            return
        self._last = now
        row = (loop.last or {}) | {
            "iteration": loop.position.iteration,
            "seconds": loop.clock.seconds,
            "paths": loop.position.paths,
        }
        self._bar.update(self._task, completed=progress, text=_line(row))


def _line(row: dict) -> str:
    rate = row["paths"] / row["seconds"] / 1e6 if row["seconds"] else 0.0
    return (
        f"{row['seconds']:7.2f} s  it {row['iteration']:<6d} loss {_number(row.get('loss'))}  "
        f"image {_number(row.get('image_rmse'))}  "
        f"parameters {_number(row.get('parameter_rmse'))}  {rate:.2f} M paths/s"
    )
