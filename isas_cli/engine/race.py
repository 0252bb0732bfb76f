"""Contestants of one process taking turns, until each has had the same billed budget."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from .. import records
from ..config.schema import Config
from ..runtime import backend, interrupt, memory
from ..runtime.budget import Budget
from ..runtime.errors import InputError, NumericalError
from ..scene import outside
from . import resumption
from .choices import Choices
from .display import RaceDisplay
from .experiment import Phases, built, checked, started

_FAILED = "failed"  # by another renderer: goes on with its race


@dataclass
class Entry:
    """One contestant with one seed: ``label`` names what it is, ``folder`` where it is recorded."""

    label: str
    cfg: DictConfig
    folder: Path
    earlier: resumption.Continuation | None = None  # of a run that goes on
    typed: Config = field(init=False)
    budget: Budget = field(init=False)

    def __post_init__(self) -> None:
        self.typed, self.budget = checked(self.cfg)
        if self.typed.budget.converged:
            raise InputError("budget.converged=true: a race gives all the same time; leave it out")

    @property
    def name(self) -> str:
        return f"{self.label} seed {self.cfg.seed}"

    @property
    def problem_key(self) -> str:
        """Equal for entries that share scene and targets."""
        return OmegaConf.to_yaml({"scene": self.cfg.scene, "target": self.cfg.target}, resolve=True)


def continued(label: str, folder: Path, changes: dict) -> Entry | None:
    """The entry that goes on in ``folder``; None where it is complete and its budget spent, or
    where it failed, but for another budget, which its record is to say as the others' do."""
    run = records.load(folder)
    failed = run.complete and run.summary["status"] == NumericalError.ended
    if failed and not any(key.partition(".")[0] == "budget" for key in changes):
        return None
    try:
        earlier = resumption.prepare(folder, changes)
    except resumption.Spent:
        return None
    return Entry(label, earlier.cfg, folder, earlier)


def run(entries: list[Entry], slice_seconds: float, begin: Callable[[], None]) -> int:
    """Race ``entries`` in slices of about ``slice_seconds`` billed. Each leaves an ordinary run.

    ``begin`` is called once, when everything is known to work and before any record.

    All share one process and, where scene and targets are the same, these and every compiled
    kernel. Each round every entry gets one slice, the order rotating by one, so that a drift of
    the machine falls on all alike. One that fails numerically, or that had, is recorded as such and
    the others go on, as they do where another renderer fails one. Returns 0, a failure's status, or
    130 after Ctrl-C.
    """
    # What has no record yet may say auto, by which others are not gone on with.
    first = next((entry for entry in entries if entry.earlier is not None), entries[0])
    machine, made = started([entry.cfg for entry in entries], first.typed)
    with RaceDisplay(len(entries)) as display:
        lanes = _Lanes(entries, made, display, machine)
        full = memory.kept("isas race", first.folder.parent.parent)
        with interrupt.graceful(display.interrupted) as stop, full:
            begin()
            lanes.open()
            return lanes.run(slice_seconds, stop)


class _Lanes:
    """The loops of a race and their records, side by side."""

    def __init__(
        self,
        entries: list[Entry],
        made: list[Choices],
        display: RaceDisplay,
        machine: backend.Backend,
    ):
        from .recorder import Recorder
        from .workshop import Workshop

        self.entries, self.display, self.machine = entries, display, machine
        phases = Phases(display)
        problems = {}
        going = [(e, e.earlier.manifest) for e in entries if e.earlier is not None]
        for entry, manifest in going:
            resumption.check_variant(machine, manifest, entry.folder)
        # All scenes before the first kernel: a material that comes later compiles all anew.
        for entry in entries:
            if entry.problem_key not in problems:
                sharing = [c for c, e in zip(made, entries) if e.problem_key == entry.problem_key]
                begun = [(m, e.folder) for e, m in going if e.problem_key == entry.problem_key]
                problems[entry.problem_key] = built(entry.typed, phases, sharing, begun)
        phases.begin("prepare")
        workshops = {key: Workshop(problem) for key, problem in problems.items()}
        self.recorders: list[Recorder] = []
        for entry, choices in zip(entries, made):
            interrupt.check()
            workshop = workshops[entry.problem_key]
            planned = None if entry.earlier is None else entry.earlier.manifest.get("plan")
            loop = workshop.loop(choices, entry.typed, entry.budget, planned)
            lane = display.lane(entry.name)
            renderer = workshop.renderer
            self.recorders.append(
                Recorder(entry.cfg, entry.typed, loop, entry.folder, lane, renderer)
            )
        phases.begin(None)
        for recorder in self.recorders:  # shared by all, so each names the whole
            recorder.loop.clock.unbilled_seconds.update(phases.seconds)
        for entry, recorder in zip(entries, self.recorders):
            interrupt.check()
            display.phase(f"compile {entry.label}")
            recorder.loop.rehearse()
            self._detach(recorder)

    def open(self) -> None:
        """Begin all records before any loop, so that a kill leaves each of them; and all folders
        before any record, so that none holds another race's when one of them fails."""
        self.display.phase("pictures")
        both = list(zip(self.entries, self.recorders))
        writers = {r.folder: r.claimed() for entry, r in both if entry.earlier is None}
        for entry, recorder in both:
            if entry.earlier is None:
                recorder.open(self.machine, writers[recorder.folder])
            else:
                recorder.reopen(self.machine, entry.earlier)

    def run(self, slice_seconds: float, stop) -> int:
        """Slices in turn until all have ended; then their records."""
        hooks = [recorder.hooks(stop) for recorder in self.recorders]
        everyone = range(len(hooks))
        ends: dict[int, str] = {}

        def begin(n: int) -> None:
            self._loop(n).begin(hooks[n])

        def advance(n: int) -> None:
            if self._loop(n).advance(hooks[n], slice_seconds):
                ends[n] = "done"

        def halt(n: int) -> None:
            ends[n] = self._loop(n).halt(hooks[n])

        for number in everyone:
            self._guarded(number, ends, begin)
            earlier = self.entries[number].earlier
            if earlier is not None and earlier.failed and number not in ends:
                ends[number] = NumericalError.ended
        turn = 0
        while len(ends) < len(hooks) and not stop():
            for number in ((turn + i) % len(hooks) for i in everyone):
                if number not in ends and not stop():
                    self._guarded(number, ends, advance)
            turn += 1
        for number in everyone:
            if number not in ends:
                self._guarded(number, ends, halt)
        return self._finish(ends, stop)

    def _finish(self, ends: dict[int, str], stop) -> int:
        """What was dear to compute first, of all; then the pictures. Returns the exit status."""
        for number, recorder in enumerate(self.recorders):
            if ends[number] != _FAILED:
                recorder.close(ends[number])
        interrupted = "interrupted" in ends.values()
        # Stopped once, a race has its pictures made; stopped while they are made, it does not.
        given_up = (lambda: False) if interrupted else stop
        for number, recorder in enumerate(self.recorders):
            if not given_up() and ends[number] != _FAILED:
                self._guarded(number, ends, lambda n: self.recorders[n].illustrate(given_up))
            self.display.ended(self.entries[number].name, ends[number], *recorder.ends)
        if interrupted or given_up():
            return interrupt.STATUS
        if NumericalError.ended in ends.values():
            return NumericalError.status
        return InputError.status if _FAILED in ends.values() else 0

    def _loop(self, number: int):
        return self.recorders[number].loop

    def _guarded(self, number: int, ends: dict, act) -> None:
        """``act(number)``; a numerical failure, or another renderer's, ends this entry and no
        other."""
        try:
            act(number)
        except NumericalError as error:
            ends[number] = NumericalError.ended
            folder = shlex.quote(str(self.recorders[number].folder))
            self.display.say(f"{self.entries[number].name}: {error}; isas replay {folder}")
        except outside.Failed as error:
            ends[number] = _FAILED
            self.display.say(f"{self.entries[number].name}: {error}; resume= goes on with it")
        finally:
            self._detach(self.recorders[number])

    @staticmethod
    def _detach(recorder) -> None:
        """Leave no gradients on the scene: they would break passes through another one."""
        loop = recorder.loop
        loop.problem.unknowns.write(loop.stepper.values)
