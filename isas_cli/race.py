"""Contestants of one process taking turns, until each has had the same billed budget."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from . import backend, interrupt, manifest, records, resumption
from .budget import Budget
from .config import Config
from .display import RaceDisplay
from .errors import InputError, NumericalError
from .experiment import Phases, built, checked


@dataclass
class Entry:
    """One contestant with one seed: ``label`` names what it is, ``folder`` where it is recorded."""

    label: str
    cfg: DictConfig
    folder: Path
    earlier: dict | None = None  # the manifest of a run that goes on

    def __post_init__(self) -> None:
        self.typed: Config
        self.budget: Budget
        self.typed, self.budget = checked(self.cfg)

    @property
    def name(self) -> str:
        return f"{self.label} seed {self.cfg.seed}"

    @property
    def problem_key(self) -> str:
        """Equal for entries that share scene and targets."""
        return OmegaConf.to_yaml({"scene": self.cfg.scene, "target": self.cfg.target}, resolve=True)


def continued(label: str, folder: Path, changes: dict) -> Entry | None:
    """The entry that goes on in ``folder``; None where its budget is spent or it failed."""
    run = records.load(folder)
    if (run.summary or {}).get("status") == "numerical failure":
        return None
    if manifest.alive(run.manifest):
        raise InputError(f"{folder} is still being written: its process has not ended")
    if resumption.is_spent(folder, changes):
        return None
    cfg, earlier = resumption.prepare(folder, changes)
    return Entry(label, cfg, folder, earlier)


def run(entries: list[Entry], slice_seconds: float, begin: Callable[[], None]) -> int:
    """Race ``entries`` in slices of about ``slice_seconds`` billed. Each leaves an ordinary run.

    ``begin`` is called once, when everything is known to work and before any record.

    All share one process and, where scene and targets are the same, these and every compiled
    kernel. Each round every entry gets one slice, the order rotating by one, so that a drift of
    the machine falls on all alike. One that fails numerically is recorded as such and the others
    go on. Returns 0, the first failure's status, or 130 after Ctrl-C.
    """
    first = entries[0].typed
    machine = backend.start(first.variant, first.threads)
    with RaceDisplay(len(entries)) as display:
        lanes = _Lanes(entries, display)
        with interrupt.graceful(display.interrupted) as stop:
            begin()
            lanes.open(machine)
            status = lanes.run(slice_seconds, stop)
    return status


class _Lanes:
    """The loops of a race and their records, side by side."""

    def __init__(self, entries: list[Entry], display: RaceDisplay):
        from .recorder import Recorder
        from .workshop import Workshop

        self.entries, self.display = entries, display
        phases = Phases(display)
        problems = {}
        # All scenes before the first kernel: a material that comes later compiles all anew.
        for entry in entries:
            if entry.problem_key not in problems:
                problems[entry.problem_key] = built(entry.typed, phases)
        phases.begin("prepare")
        workshops = {key: Workshop(problem) for key, problem in problems.items()}
        self.recorders: list[Recorder] = []
        for entry in entries:
            interrupt.check()
            workshop = workshops[entry.problem_key]
            if entry.earlier is not None:
                resumption.check_same_problem(workshop.problem, entry.earlier, entry.folder)
            loop = workshop.loop(entry.cfg, entry.typed, entry.budget)
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

    def open(self, machine) -> None:
        """Begin all records before any loop, so that a kill leaves each of them."""
        self.display.phase("pictures")
        for entry, recorder in zip(self.entries, self.recorders):
            if entry.earlier is None:
                recorder.open(machine)
            else:
                recorder.reopen(entry.earlier)

    def run(self, slice_seconds: float, stop) -> int:
        """Slices in turn until all have ended; then their records."""
        hooks = [recorder.hooks(stop) for recorder in self.recorders]
        ends: dict[int, str] = {}
        failures = []
        for number in range(len(hooks)):
            self._guarded(number, ends, failures, lambda n: self._loop(n).begin(hooks[n]))
        turn = 0
        while len(ends) < len(hooks) and not stop():
            order = [(turn + i) % len(hooks) for i in range(len(hooks))]
            for number in order:
                if number in ends or stop():
                    continue

                def advance(n: int) -> None:
                    if self._loop(n).advance(hooks[n], slice_seconds):
                        ends[n] = "done"

                self._guarded(number, ends, failures, advance)
            turn += 1
        for number, recorder in enumerate(self.recorders):
            if number not in ends:
                ends[number] = recorder.loop.halt(hooks[number])
        for number, recorder in enumerate(self.recorders):
            recorder.finish(ends[number])
            self.display.ended(self.entries[number].name, ends[number], *recorder.ends)
        if "interrupted" in ends.values():
            return interrupt.STATUS
        return failures[0].status if failures else 0

    def _loop(self, number: int):
        return self.recorders[number].loop

    def _guarded(self, number: int, ends: dict, failures: list, act) -> None:
        """``act(number)``; a numerical failure ends this entry and no other."""
        try:
            act(number)
        except NumericalError as error:
            ends[number] = "numerical failure"
            failures.append(error)
            self.display.say(f"{self.entries[number].name}: {error}")
        finally:
            self._detach(self.recorders[number])

    @staticmethod
    def _detach(recorder) -> None:
        """Leave no gradients on the scene: they would break passes through another one."""
        loop = recorder.loop
        loop.problem.unknowns.write(loop.stepper.values)
