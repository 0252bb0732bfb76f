"""How a run goes on, in the terminal: one line, one row of a table, or a page with a chart."""

from __future__ import annotations

import math
import shlex
from pathlib import Path

import numpy as np
import plotille
from rich.console import Console, Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from ..engine.display import number
from ..records import Run
from ..records.follow import KILLED, RUNNING, UNREADABLE, Follower, Standing, alive

_RACE = "race.yaml"  # what `isas race` leaves in its folder
_MEASURES = {"image_rmse": "cyan", "parameter_rmse": "magenta"}
_SILENT_SECONDS = 60.0  # checkpoints come every few seconds
_BAR = 30
# The chart, in characters: at most as wide as is easily read, and what its axis takes of that.
_WIDEST, _LOWEST, _HIGHEST, _AXIS, _TICK = 100, 5, 14, 26, 10
_BELOW_CHART, _BESIDE_CHART = 3, 12  # lines: of its horizontal axis, and of all that is no chart


def line(standing: Standing) -> str:
    """The last row in one line: time, iteration, errors, speed."""
    last, budget = standing.last, standing.budget
    if not last:
        return "no row yet"
    steps = f"/{budget.iterations}" if budget and budget.iterations is not None else ""
    parts = [_spent(standing), f"it {last['iteration']:.0f}{steps}"]
    parts += [f"{name} {_error(standing, name)}" for name in _MEASURES if name in last]
    parts.append(f"loss {number(last.get('loss'))}")
    return "  ".join([*parts, f"{_rate(standing)} M paths/s"])


def ending(follower: Follower) -> list[str]:
    """How a run has ended and what can be done now, line by line; nothing where it goes on."""
    run, status = follower.run, follower.status()
    if status == UNREADABLE:
        return [f"cannot be read: {follower.problem}"]
    if run is None or status == RUNNING:
        return []
    summary = run.summary or {}
    resume = _resume(follower.folder)
    if status == KILLED:
        text = "killed: its process has gone without a word"
        saved = (follower.folder / "checkpoint" / "state.npz").is_file()
        return [
            text + (f"; go on with: {resume}" if saved else ", and before its first checkpoint")
        ]
    text = status + (f": {summary['error']}" if summary.get("error") else "")
    said = [text + (f"; go on with: {resume}" if status == "interrupted" else "")]
    said += [f"warning: {warning}" for warning in summary.get("warnings") or []]
    report = follower.folder / "report.html"
    if report.is_file():
        said.append(f"report: {report}")
    elif not (follower.folder / "manifest.json").is_file():
        pass  # a job that failed before it had a record
    elif alive(run.manifest):
        said.append(f"report: {report}, which is being written")
    elif not run.complete:
        said.append(f"pictures and report are missing; make them with: {resume}")
    return said


def _resume(folder: Path) -> str:
    """What goes on with a run; of a race's with all of it, at equal billed time."""
    race = folder.absolute().parent.parent
    if (race / _RACE).is_file():
        return f"isas race {shlex.quote(f'resume={race}')}"
    return f"isas run {shlex.quote(f'resume={folder}')}"


def page(follower: Follower, console: Console) -> RenderableType:
    """One run: what it is, how far it is, its errors and their course."""
    run = follower.run
    if run is None:
        return Text(f"{follower.folder}: no run has begun here yet")
    standing = Standing.of(run)
    head = Text("  ".join(standing.labels), style="bold")
    head.append(f"  {follower.folder}", style="not bold dim")
    parts: list[RenderableType] = [head, _spending(follower, standing)]
    if standing.last:
        parts += ["", _errors(standing), _speed(standing)]
        parts += _chart(run, console)
    if follower.status() == RUNNING:
        parts += [Text(f"warning: {warning}", style="yellow") for warning in standing.warnings]
    return Group(*parts)


def table(followers: dict[str, Follower], console: Console) -> RenderableType:
    """Several runs by name, a line each; those that go on first, and no more than fit."""
    made = Table(box=None, pad_edge=False, header_style="bold")
    made.add_column("run", overflow="fold", min_width=12)
    made.add_column("state", no_wrap=True)
    for title in ("spent", "it", *_MEASURES, "M paths/s"):
        made.add_column(title, justify="right", no_wrap=True)
    states = {name: follower.status() for name, follower in followers.items()}
    names = sorted(states, key=lambda name: states[name] != RUNNING)  # else in their order
    room = max(console.height - 4, 1) if console.is_terminal else len(names)
    for name in names[:room]:
        made.add_row(Text(name), *_cells(followers[name], states[name]))
    running = list(states.values()).count(RUNNING)
    below = [f"{running} running, {len(names) - running} ended"]
    if len(names) > room:
        below.append(f"{len(names) - room} of them not shown")
    return Group(made, Text("; ".join(below)))


def _cells(follower: Follower, state: str) -> list[Text]:
    if follower.run is None:
        return [Text(state, style=_style(state))]
    standing = Standing.of(follower.run)
    shown = [_state(follower, state)]
    if not standing.last:
        return shown
    texts = [_spent(standing), f"{standing.last['iteration']:.0f}"]
    texts += [_error(standing, name) for name in _MEASURES]
    return shown + [Text(text) for text in [*texts, _rate(standing)]]


def _state(follower: Follower, status: str) -> Text:
    """The status in a word, and in a few for a run that has long written nothing."""
    silence = follower.silence()
    if status == RUNNING and silence > _SILENT_SECONDS:
        return Text(f"silent for {silence / 60:,.0f} min", style="yellow")
    return Text(status, style=_style(status))


def _spending(follower: Follower, standing: Standing) -> RenderableType:
    """Running or not, and how much of the budget is spent."""
    row = Table.grid(padding=(0, 2))
    cells: list[RenderableType] = [_state(follower, follower.status())]
    if standing.spent is not None:
        cells.append(ProgressBar(total=1.0, completed=standing.spent, width=_BAR))
        cells.append(f"{100 * standing.spent:.0f} %")
    if standing.last:
        cells.append(f"{_spent(standing)} billed")
    row.add_row(*cells)
    return row


def _errors(standing: Standing) -> RenderableType:
    made = Table(box=None, pad_edge=False, header_style="dim")
    made.add_column("")
    for title in ("now", "start", "now / start"):
        made.add_column(title, justify="right")
    for name, colour in {**_MEASURES, "loss": ""}.items():
        if name in standing.last:
            values = (standing.last[name], standing.first.get(name), standing.share(name))
            made.add_row(Text(name, style=colour), *(number(value) for value in values))
    return made


def _speed(standing: Standing) -> Text:
    last, seconds = standing.last, standing.last["seconds"]
    parts = [f"iteration {last['iteration']:,.0f}", f"{_rate(standing)} M paths/s"]
    if seconds:
        parts.append(f"stage 1 {100 * last.get('stage1_seconds', 0.0) / seconds:.1f} %")
    if "learning_rate" in last:
        parts.append(f"learning rate {number(last['learning_rate'])}")
    return Text("  ".join(parts))


def _chart(run: Run, console: Console) -> list[RenderableType]:
    """The errors over their starts, logarithmic, against billed seconds; nothing before there are
    two rows, or where there is no room or no alphabet for it."""
    width = (min(console.width, _WIDEST) - _AXIS) // _TICK * _TICK
    height = min(console.height - _BESIDE_CHART - _BELOW_CHART, _HIGHEST)
    courses = _courses(run)
    if not courses or width < 2 * _TICK or height < _LOWEST or console.options.ascii_only:
        return []
    coloured = console.color_system is not None
    figure = plotille.Figure()
    figure.width, figure.height, figure.origin = width, height, False
    figure.color_mode, figure.with_colors = "names", coloured
    figure.x_label, figure.y_label = "billed s", "now / start"
    figure.x_ticks_fkt = lambda value, _: f"{value:.6g}"
    figure.y_ticks_fkt = lambda value, _: f"{10**value:.3g}"
    all_shares = np.concatenate([shares for _, shares in courses.values()])
    low, high = all_shares.min(), all_shares.max()
    figure.set_y_limits(min_=low, max_=max(high, low + 1e-3))
    end = max(seconds[-1] for seconds, _ in courses.values())
    figure.set_x_limits(min_=0.0, max_=_round(end * _TICK / width) * width / _TICK)
    for name, (seconds, shares) in courses.items():
        figure.plot(
            seconds.tolist(),
            shares.tolist(),
            lc=_MEASURES[name] if coloured else None,
            marker=None if coloured else name[0],
        )
    return ["", Text.from_ansi(figure.show())]


def _courses(run: Run) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Billed seconds and the decimal logarithm of error over start, of each error that is known."""
    found = {}
    seconds = run.history["seconds"].to_numpy()
    for name in _MEASURES:
        errors = run.history[name].to_numpy()
        if errors.size and errors[0] > 0:
            known = np.isfinite(errors) & (errors > 0)
            if known.sum() > 1 and seconds[known][-1] > 0:
                found[name] = seconds[known], np.log10(errors[known] / errors[0])
    return found


def _round(least: float) -> float:
    """The next number from `least` on that is easily read."""
    power = 10.0 ** math.floor(math.log10(least))
    steps = (1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10)
    return next(step * power for step in steps if step * power >= least)


def _style(status: str) -> str:
    return {RUNNING: "green", "done": "bold green", "interrupted": "yellow"}.get(status, "red")


def _spent(standing: Standing) -> str:
    limit = standing.budget.seconds if standing.budget else None
    return f"{standing.last['seconds']:.1f}{'' if limit is None else f'/{limit:g}'} s"


def _error(standing: Standing, name: str) -> str:
    share = standing.share(name)
    known = number(standing.last.get(name))
    return known if share is None else f"{known} ×{share:.3g}"


def _rate(standing: Standing) -> str:
    return number(standing.rate and standing.rate / 1e6, ".2f")
