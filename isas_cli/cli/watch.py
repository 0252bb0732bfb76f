"""`isas watch`: how a run, or several, come on while another process writes them. Only reads."""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

from rich.console import Console, RenderableType
from rich.live import Live
from rich.text import Text

from ..records.follow import KILLED, RUNNING, Follower, Standing, alive, find
from ..runtime import interrupt
from ..runtime.errors import InputError
from . import watch_view

_UPDATE_SECONDS = 0.5  # between updates: soon enough for a person, next to nothing for the machine
_REDRAW_SECONDS = 1.0
_FIND_SECONDS = 2.0  # between searches for new runs


def main(folder: Path, once: bool = False) -> int:
    """Shows the run in `folder`, or all runs below it, until they have ended; `once`: as they are.

    In a terminal the view is redrawn in place; elsewhere there is a line for each new row. Returns
    0, or 130 after Ctrl-C, which the run does not notice. Raises InputError for a folder that does
    not exist, and for the record of a single run that cannot be read.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(
            f"{folder}: no such folder; a run makes its own when its loop begins: "
            "until then watch the one above it"
        )
    console = Console()
    watched = _Watched(folder)
    try:
        with interrupt.prompt():
            if once:
                watched.update()
                console.print(watched.drawn(console))
                _say(console, watched.endings())
            elif console.is_terminal and sys.stdout.isatty() and not console.is_dumb_terminal:
                _live(watched, console)
            else:
                _plain(watched, console)
    except KeyboardInterrupt:
        return interrupt.STATUS
    return 0


def _live(watched: _Watched, console: Console) -> None:
    """Redraws in place until all is over; the last view stays."""
    drawn = -math.inf
    with Live(console=console, auto_refresh=False) as live:
        over = False
        while not over:
            changed, over = watched.update(), watched.over()
            if changed or over or time.monotonic() - drawn > _REDRAW_SECONDS:
                live.update(watched.drawn(console), refresh=True)
                drawn = time.monotonic()
            if not over:
                time.sleep(_UPDATE_SECONDS)
    _say(console, watched.endings())


def _plain(watched: _Watched, console: Console) -> None:
    """A line for each new row until all is over."""
    watched.update()
    if not watched.followers:
        _say(console, [f"{watched.folder}: no run has begun here yet; waiting"])
    while True:
        _say(console, watched.news())
        if watched.over():
            break
        time.sleep(_UPDATE_SECONDS)
        watched.update()


def _say(console: Console, lines: list[str]) -> None:
    for text in lines:
        console.print(text, highlight=False, markup=False, soft_wrap=True)


class _Watched:
    """The runs at or below a folder."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.followers: dict[Path, Follower] = {}
        self._searched = -math.inf
        self._over = False
        self._said: dict[Path, int] = {}  # the last iteration that was said of a run
        self._states: dict[Path, str] = {}  # at the last call of `news`
        self._ends: dict[Path, str] = {}  # that were said

    def update(self) -> bool:
        """Reads what has changed; whether anything has. Raises InputError when the folder has gone
        or its single run cannot be read."""
        if not self.folder.is_dir():
            raise InputError(f"{self.folder} has gone")
        if not self.followers or time.monotonic() - self._searched > _FIND_SECONDS:
            known, self._searched = self.followers, time.monotonic()
            found = find(self.folder, known)
            self.followers = {p: known.get(p) or Follower(p) for p in found}
        changed = [follower.update() for follower in self.followers.values()]
        if self._single and self.followers[self.folder].problem:
            raise InputError(self.followers[self.folder].problem)
        return any(changed)

    def over(self) -> bool:
        """Whether no run goes on, and no process lives that could begin another."""
        followers = list(self.followers.values())
        states = [follower.status() for follower in followers]
        over = bool(states) and RUNNING not in states
        if over and not self._single:
            over = not any(f.run is not None and alive(f.run.manifest) for f in followers)
        # Between two writes of a resumption a run seems killed: only one that stays so is.
        settled = over and (self._over or KILLED not in states)
        self._over = over
        return settled

    def drawn(self, console: Console) -> RenderableType:
        """The present state: a page or, for several runs, a table."""
        if not self.followers:
            return Text(f"{self.folder}: no run has begun here yet")
        if len(self.followers) == 1:
            return watch_view.page(*self.followers.values(), console)
        named = {self._name(path): follower for path, follower in self.followers.items()}
        return watch_view.table(named, console)

    def news(self) -> list[str]:
        """Lines on new rows and on runs that have ended, since the last call."""
        return [
            text if self._single else f"{self._name(path)}: {text}"
            for path, follower in self.followers.items()
            for text in [*self._new_rows(path, follower), *self._new_end(path, follower)]
        ]

    def endings(self) -> list[str]:
        """How the run has ended; of several, those that have not ended well. What is more than the
        view says already."""
        if self._single:
            said = watch_view.ending(self.followers[self.folder])
            return said[1:] if said[:1] == ["done"] else said
        return [
            f"{self._name(path)}: {text}"
            for path, follower in self.followers.items()
            if follower.status() != "done"
            for text in watch_view.ending(follower)[:1]
        ]

    def _new_rows(self, path: Path, follower: Follower) -> list[str]:
        """Of a run seen for the first time only what it is and where it stands."""
        run = follower.run
        if run is None:
            return []
        iterations, said = run.history["iteration"].tolist(), self._said.get(path)
        self._said[path] = iterations[-1] if iterations else -1
        if said is None:
            last = [watch_view.line(Standing.of(run))] if iterations else []
            return ["  ".join(Standing.of(run).labels), *last]
        if iterations and iterations[-1] < said:  # resumed from an earlier checkpoint, or anew
            said = iterations[-1] - 1
        new = [index for index, iteration in enumerate(iterations) if iteration > said]
        return [watch_view.line(Standing.of(run, index + 1)) for index in new]

    def _new_end(self, path: Path, follower: Follower) -> list[str]:
        before, state = self._states.get(path), follower.status()
        self._states[path] = state
        if state == RUNNING:
            self._ends.pop(path, None)
            return []
        if state == self._ends.get(path) or (state == KILLED and before != KILLED):
            return []
        self._ends[path] = state
        said = watch_view.ending(follower)
        return said if self._single else said[:1]

    def _name(self, path: Path) -> str:
        return str(path.relative_to(self.folder))

    @property
    def _single(self) -> bool:
        """Whether the folder itself holds the only run there is."""
        return list(self.followers) == [self.folder]
