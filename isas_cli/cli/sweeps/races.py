"""Several races of one command: a job each, handed to a launcher as a sweep's are.

A race stays whole: its contestants take turns in one process on one machine, so that they share
what disturbs it. Its folder is that of a race held by itself.
"""

from __future__ import annotations

import contextlib
import datetime
import itertools
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...config.compose import compose, translate
from ...config.roles import Role, meaning
from ...config.schema import register
from ...engine import race as engine
from ...engine import resumption
from ...engine.race import Entry
from ...records.reader import read_json
from ...runtime import backend, interrupt
from ...runtime.errors import InputError, IsasError, NumericalError
from .. import one
from . import fingerprint, launchers, outcome, race, sweep
from .job import DONE, NOTHING, OTHER, UNFINISHED, Job, Report, leave_trace, stamp
from .launch import Sweep, say
from .outcome import Outcome, read_summary

FILE = "races.yaml"
_COMPARISON = "comparison"
_LAUNCHER = ("hydra/launcher=", "hydra.launcher.")
_OWN = ("hydra.run.dir", "seed", "resume")  # what a race of several has otherwise than all together


@dataclass(frozen=True)
class Race(Job):
    """A whole race as a job: ``cfg`` is its first entry's, ``overrides`` what `isas race` takes for
    it alone. ``changes``: see `resumption.parse`."""

    plan: race.Plan
    changes: dict[str, Any]

    def found(self) -> str:
        """NOTHING, UNFINISHED, OTHER: a race with other settings, or DONE: compared as well. A
        contestant that failed numerically has ended."""
        if not (self.folder / race.FILE).exists():
            return NOTHING
        _, listed = race.read_yaml(self.folder / race.FILE, *race.LISTED)
        if [_kept(each) for each in listed] != [_kept(each) for each in self.plan.written]:
            return OTHER
        ended = not self.changes and all(_ended(entry.folder) for entry in self.plan.entries)
        with contextlib.suppress(InputError):  # ``go`` says what is wrong
            if ended or not race.unfinished(self.folder, self.changes):
                if self.elsewhere:
                    return OTHER
                return DONE if (self.folder / _COMPARISON / "report.html").exists() else UNFINISHED
        return UNFINISHED

    def _manifest(self) -> dict[str, Any]:
        with contextlib.suppress(InputError):
            return read_json(self.plan.entries[0].folder / "manifest.json")
        return {}

    def stamp(self) -> int | None:
        return max((stamp(entry.folder) or 0 for entry in self.plan.entries), default=0) or None

    def go(self, threads: int | None) -> Report:
        """Hold the race, or what is left of it, and compare its contestants."""
        from ...report.compare import compare

        leave_trace(self.folder, "")
        threads = self.cfg.threads or threads or 0
        changes = {**self.changes, "threads": threads}
        found, left = self.found(), None
        if found == UNFINISHED and not self.anew:
            left = race.unfinished(self.folder, changes)
            if begun := [entry for entry in left if entry.earlier]:
                # By what they began with: a card may have come since, or be missing for now.
                machine = backend.start(begun[0].typed.variant, threads)
                for entry in begun:
                    resumption.check_variant(machine, entry.earlier.manifest, entry.folder)
                # Seconds of two machines cannot be compared.
                if any(entry.earlier.device != machine.device for entry in begun):
                    told = f"begun on another machine than {machine.device}: begun anew"
                    say(f"{self.label}: {told}")
                    left = None
        resumed, status = left is not None, 0
        entries = left if resumed else self._anew(changes, overwrite=found != NOTHING)
        begin = (lambda: None) if resumed else self.plan.begin
        with one.argv(["isas", "race", *self.overrides]):
            if entries:
                status = engine.run(entries, self.plan.turn, begin)
        with contextlib.suppress(InputError):  # nothing was reached that could be compared
            compare([entry.folder for entry in self.plan.entries], self.folder / _COMPARISON)
        failed = status not in (0, interrupt.STATUS)
        how = " numerically" if status == NumericalError.status else ""
        text = f"a contestant failed{how}, the others went on" if failed else ""
        return Report(status, text, resumed=resumed)

    def _anew(self, changes: dict[str, Any], overwrite: bool) -> list[Entry]:
        entries = []
        for entry in self.plan.entries:
            cfg = resumption.changed(entry.cfg.copy(), changes)
            cfg.overwrite = cfg.overwrite or overwrite
            entries.append(Entry(entry.label, cfg, entry.folder))
        return entries

    def record_failure(self, report: Report, begun: bool) -> None:
        """Leave the error in the race's error.txt."""
        with contextlib.suppress(IsasError, OSError):
            leave_trace(self.folder, report.trace or f"{report.error}\n")


def _kept(written: dict[str, Any]) -> dict[str, Any]:
    """What race.yaml says of an entry, without what changes no result."""
    settings = [
        each
        for each in written["settings"]
        if meaning(each.lstrip("+~").partition("=")[0]).role is not Role.PLACE
    ]
    return {**written, "settings": settings}


def _ended(folder: Path) -> bool:
    summary = read_summary(folder) or {}
    ended = summary.get("status") in ("done", NumericalError.ended)
    return ended and bool(summary.get("complete", True))


def expanded(own: dict[str, str], overrides: list[str]) -> list[tuple[str, list[str]]]:
    """A place and the overrides of each race, where there are several or a launcher is named: every
    value with every other. Raises InputError.

    own, overrides: see `race.options_of`."""
    typed = [*overrides, *(f"{key}={own[key]}" for key in ("seed",) if key in own)]
    translated = translate(typed)
    with sweep.explained(typed):
        parsed = sweep.parsed(translated)
    several = [override.is_sweep_override() for override in parsed]
    if not any(several) and not any(each.startswith(_LAUNCHER) for each in typed):
        return []
    choices = [
        sweep.choices(override) if varies else [text]
        for override, varies, text in zip(parsed, several, typed)
    ]
    combined = [list(chosen) for chosen in itertools.product(*choices)]
    return [(_place(own, several), own) for own in combined]


def _place(overrides: list[str], several: list[bool]) -> str:
    """The folder of a race below that of all: its scene, what else tells it from the others, and
    its seed where there are several."""
    scene, others, seed = [], [], []
    for text, varies in zip(overrides, several):
        key, _, value = text.partition("=")
        if key == "scene":
            scene.append(race.slug(value))
        elif varies and key == "seed":
            seed.append(race.slug(f"seed{value}"))
        elif varies:
            others.append(race.slug(text))
    return "/".join([*scene, *others, *seed]) or "race"


def planned(
    arguments: list[str], label: str, changes: dict[str, Any] | None = None, home: str | None = None
) -> Race:
    """The job that holds the race of these ``arguments`` of `isas race`, which name its folder, and
    files as they are found from ``home`` (None: from here). Raises InputError, also where the
    folder holds another race."""
    own, overrides = race.options_of(arguments)
    plan = race.planned(own, overrides, home)
    folder, cfg = Path(os.path.abspath(plan.folder)), plan.entries[0].cfg
    job = Race(label, arguments, folder, cfg, plan, changes or {})
    if job.found() == OTHER and not cfg.overwrite:
        raise InputError(
            f"{plan.folder} holds a race with other settings: choose another folder with "
            "hydra.run.dir=DIR, or replace it with overwrite=true"
        )
    if job.found() == NOTHING:
        plan.check()
    return job


def main(own: dict[str, str], several: list[tuple[str, list[str]]]) -> int:
    """Hold ``several`` races, see `expanded`, and compare over all. Returns the exit status."""
    root = Path("runs") / f"races-{datetime.datetime.now():%Y%m%d-%H%M%S-%f}"
    if "hydra.run.dir" in own:
        root = race.folder_of(own["hydra.run.dir"])
    launcher = [each for each in several[0][1] if each.startswith(_LAUNCHER)]
    common = [f"{key}={value}" for key, value in own.items() if key not in _OWN]
    listed = [
        {"folder": place, "arguments": [*(o for o in own if o not in launcher), *common]}
        for place, own in several
    ]
    jobs = [_job(root, each) for each in listed]

    def begin() -> None:
        race.write_yaml(root / FILE, {"started_in": os.getcwd(), "races": listed})

    return _held(root, jobs, launcher, begin)


def resume(root: Path, own: dict[str, str], overrides: list[str]) -> int:
    """Go on with the races in ``root``, by the launcher that ``overrides`` name and with what else
    they change. Returns the exit status."""
    read, listed = race.read_yaml(root / FILE, "races", "arguments")
    launcher = [each for each in overrides if each.startswith(_LAUNCHER)]
    # With those of earlier times, which an interrupted race may not have heard of.
    given = [*read.get("changes", []), *(each for each in overrides if each not in launcher)]
    changed = list({each.partition("=")[0]: each for each in given}.values())
    changes = resumption.parse(changed)
    # What is replaced was replaced when they began.
    dropped = ("overwrite=", *(["slice="] if "slice" in own else []))
    more = [f"slice={own['slice']}"] if "slice" in own else []
    for each in listed:
        kept = [o for o in each["arguments"] if not o.startswith(dropped)]
        each["arguments"] = [*kept, *more]
    jobs = [_job(root, each, changes, read.get("started_in")) for each in listed]

    def begin() -> None:
        race.write_yaml(root / FILE, {**read, "changes": changed})

    return _held(root, jobs, launcher, begin)


def _job(root: Path, listed: dict[str, Any], *more) -> Race:
    place = listed["folder"]
    return planned([*listed["arguments"], f"hydra.run.dir={root / place}"], place, *more)


def _held(root: Path, jobs: list[Race], launcher: list[str], begin) -> int:
    folders = [entry.folder for job in jobs for entry in job.plan.entries]
    try:
        outcomes = launch(root, jobs, launcher, begin)
    except KeyboardInterrupt:
        race.compared(folders, root, interrupt.STATUS)
        raise
    status = outcome.exit_status(outcomes)
    race.compared(folders, root, status)
    return status


def launch(root: Path, jobs: list[Race], launcher: list[str], begin=lambda: None) -> list[Outcome]:
    """Hold those ``jobs`` that are not done, by a ``launcher``, such as
    ``["hydra/launcher=ray"]``. Says before how long that takes, and then how each ended.

    ``begin`` is called once, when nothing more can be refused here. Raises InputError, and
    KeyboardInterrupt after Ctrl-C, when what has begun has finished its records.
    """
    register()
    fingerprint.register()
    launchers.prepare(launcher)
    with sweep.explained(launcher):
        place = f"hydra.sweep.dir={race.override(str(root))}"
        first = [o for o in jobs[0].overrides if o.startswith("scene=")]
        settings = compose([*first, *launcher, place], hydra=True).hydra
    with interrupt.graceful() as stop:
        held = Sweep(launchers.launcher(settings), stop)
        begin()
        say(forecast(jobs))
        try:
            held.launch(jobs)
            if stop():
                raise KeyboardInterrupt
        finally:
            outcome.show(held.outcomes, figures=False)
    return held.outcomes


def forecast(jobs: list[Race]) -> str:
    """How many of the races are to be held, and what their runs are billed together."""
    left = [job for job in jobs if not job.skipped()]
    budgets = [entry.budget.seconds for job in left for entry in job.plan.entries]
    text = f"races: {len(left)} of {len(jobs)} to be held, with {len(budgets)} runs"
    if not budgets or None in budgets:
        return text
    together = datetime.timedelta(seconds=round(sum(budgets)))
    return f"{text}: {together} billed, plus targets, compiling and pictures"
