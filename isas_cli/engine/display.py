"""What a person sees while a run goes on."""

from __future__ import annotations

import contextlib
import sys
import time

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn
from rich.table import Column

from ..runtime.budget import Budget

# Plain lines: one per evaluation; for targets at most one every so many seconds.
_QUIET_SECONDS = 5.0
# Redrawing is host time: not more often than a person can read.
_REDRAW_SECONDS = 0.25
_ROOMY = 100  # columns of a terminal from which on the bar may be long
_BESIDE = 12  # columns of the spinner, the longest phase's name and the gaps


def number(value: float | None, form: str = ".3g") -> str:
    """For terminals: – where it is not known."""
    return "–" if value is None or value != value else format(value, form)


class Stderr(Console):
    """Standard error. Where nobody reads it any more, or its disk is full, it falls silent: what is
    said there ends no work."""

    def __exit__(self, *raised) -> None:
        try:
            super().__exit__(*raised)
        except OSError:
            self.quiet = True

    def on_broken_pipe(self) -> None:
        self.quiet = True


def say(text: str) -> None:
    """A line on standard error, where it can be written: work goes on."""
    with contextlib.suppress(OSError):
        print(text, file=sys.stderr, flush=True)


class Display:
    """A live line in a terminal, plain lines elsewhere. Writes to standard error."""

    def __init__(self, budget: Budget | None) -> None:
        self.console = Stderr(stderr=True)
        self.live = self.console.is_terminal and sys.stderr.isatty()
        self.budget = budget
        self._bar_width = 16 if self.console.width >= _ROOMY else 8
        self._bar: Progress | None = None
        self._last = 0.0

    def __enter__(self) -> "Display":
        if self.live:
            one_line = Column(no_wrap=True, overflow="ellipsis")
            self._bar = Progress(
                SpinnerColumn(),
                TextColumn("{task.description}", table_column=Column(no_wrap=True)),
                BarColumn(bar_width=self._bar_width),
                TextColumn("{task.fields[text]}", table_column=one_line, markup=False),
                console=self.console,
                transient=True,
                # Drawn between iterations: a thread of its own would draw in billed time.
                auto_refresh=False,
            )
            self._task = self._bar.add_task("", total=1.0, text="")
            self._bar.start()
        return self

    def __exit__(self, *unused) -> None:
        self.stop()

    def stop(self) -> None:
        """Take the live line away; what follows are lasting lines."""
        if self._bar:
            self._bar.stop()
            self._bar = None

    def say(self, text: str) -> None:
        """A lasting line."""
        self.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def interrupted(self) -> None:
        """Ctrl-C was pressed, and the record is being finished."""
        self.say("interrupted: finishing the record (Ctrl-C again: stop at once)")

    def phase(self, name: str) -> None:
        """Work of another kind begins."""
        if self._bar:
            self._bar.update(self._task, description=name, completed=0.0, text="", refresh=True)
        self._last = time.monotonic()

    def targets(self, done: int, total: int) -> None:
        """Progress of rendering targets, in light paths."""
        text = f"{done / 1e6:.1f} of {total / 1e6:.1f} M paths"
        self.advanced(done / total, text, f"targets {100 * done / total:.0f} %")

    def advanced(self, share: float, text: str, line: str) -> None:
        """Progress of what has no rows: ``text`` beside the bar, or a ``line``, not too often."""
        if self._bar:
            self._bar.update(self._task, completed=share, text=text, refresh=True)
        elif time.monotonic() - self._last > _QUIET_SECONDS or share == 1:
            self._last = time.monotonic()
            self.say(line)

    def evaluated(self, row: dict) -> None:
        """A new row of the history: always a line where there is no terminal."""
        if not self.live:
            self.say("  ".join(self._fields(row)))

    def stepped(self, loop, spent: float, name: str = "") -> None:
        """After each iteration; redraws at most a few times a second. ``name``: whose it was."""
        now = time.monotonic()
        if not self._bar or now - self._last < _REDRAW_SECONDS:
            return
        self._last = now
        # The last row with what has been spent since.
        row = (loop.last or {}) | {
            "iteration": loop.position.iteration,
            "seconds": loop.clock.seconds,
            "paths": loop.position.paths,
        }
        room = self.console.width - self._bar_width - _BESIDE - len(name)
        shown = {"completed": spent, "text": _fitting(self._fields(row), room)}
        self._bar.update(self._task, description=name or None, **shown, refresh=True)

    def _fields(self, row: dict) -> list[str]:
        """Time, iteration, errors and speed; the first of them in the order of importance."""
        budget, seconds = self.budget, row["seconds"]
        spent = f"/{budget.seconds:g}" if budget and budget.seconds is not None else ""
        steps = f"/{budget.iterations}" if budget and budget.iterations is not None else ""
        rate = f"{row['paths'] / seconds / 1e6:.2f}" if seconds else "–"
        fields = [f"{seconds:5.1f}{spent} s", f"it {row['iteration']:3d}{steps}"]
        if "parameter_rmse" in row:
            fields.append(f"param {number(row['parameter_rmse'])}")
        fields.append(f"image {number(row.get('image_rmse'))}")
        fields.append(f"loss {number(row.get('loss'))}")
        fields.append(f"{rate} M paths/s")
        return fields


class Lane:
    """One contestant's share of a race's display."""

    def __init__(self, race: "RaceDisplay", name: str):
        self.race, self.name, self.spent = race, name, 0.0

    def phase(self, name: str) -> None:
        self.race.phase(f"{name} {self.name}")

    def evaluated(self, row: dict) -> None:
        if not self.race.live:
            self.race.say(f"{self.name}:  " + "  ".join(self.race._fields(row)))

    def stepped(self, loop, spent: float) -> None:
        self.spent = spent
        together = sum(each.spent for each in self.race.lanes) / self.race.count
        self.race.stepped(loop, together, self.name)


class RaceDisplay(Display):
    """One line for all contestants of a race: whose turn it is, and how far all are together."""

    def __init__(self, count: int) -> None:
        super().__init__(None)
        self.lanes: list[Lane] = []
        self.count = count

    def lane(self, name: str) -> Lane:
        self.lanes.append(Lane(self, name))
        return self.lanes[-1]

    def ended(self, name: str, status: str, first: dict, last: dict) -> None:
        """A contestant's record is finished."""
        measure = "parameter_rmse" if "parameter_rmse" in last else "image_rmse"
        change = f"{measure} {number(first.get(measure))} → {number(last.get(measure))}"
        self.say(f"{name}: {status}, {change}")


def _fitting(fields: list[str], width: int) -> str:
    """As many of the fields, from the first on, as fit into one line."""
    line = fields[0]
    for field in fields[1:]:
        if len(line) + 2 + len(field) > width:
            break
        line += "  " + field
    return line
