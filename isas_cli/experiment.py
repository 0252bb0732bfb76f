"""One run from its configuration to its record: the only place where all parts meet."""

from __future__ import annotations

import time
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from . import backend, interrupt
from .budget import Budget
from .compose import instantiate
from .display import Display
from .errors import NumericalError
from .records import RunWriter

# Written besides the billed time; a kill loses at most this much work.
_CHECKPOINT_SECONDS = 10.0


def run(cfg: DictConfig, folder: Path) -> int:
    """Run ``cfg`` and leave its record in ``folder``. Returns 0, or 130 after Ctrl-C.

    Raises InputError before anything is computed where that is possible and before there is a
    record, and NumericalError after the record has been finished with the last good state.
    """
    typed = OmegaConf.to_object(cfg)
    budget = Budget(typed.budget.seconds, typed.budget.iterations, typed.budget.paths)
    machine = backend.start(typed.variant, typed.threads)
    loss, sampler = instantiate(cfg.loss, "loss"), instantiate(cfg.sampler, "sampler")
    with Display(budget) as display:
        experiment = _Experiment(cfg, typed, budget, loss, sampler, display)
        return experiment.go(folder, machine)


class _Experiment:
    """The state that the phases of one run share."""

    def __init__(self, cfg, typed, budget, loss, sampler, display):
        # Mitsuba's types exist only once the backend has started.
        from . import build
        from .adam import Stepper
        from .clock import Clock
        from .evaluate import Evaluator
        from .optimise import Loop

        self.cfg, self.typed, self.display = cfg, typed, display
        self.clock, self._phase, self._since = Clock(), None, time.perf_counter()
        self.problem = build.problem(typed.scene, typed.target, self._rendered, self._begin)
        self._begin("prepare")
        self.stepper = Stepper(self.problem.unknowns, typed.optimizer)
        evaluator = Evaluator(
            self.problem, loss, typed.evaluation.pixels, typed.evaluation.spp, typed.seed
        )
        self.loop = Loop(
            self.problem,
            loss,
            sampler,
            self.stepper,
            evaluator,
            budget,
            typed.estimator.batch,
            typed.seed,
            typed.evaluation.count,
            typed.estimator.freeze,
        )
        self.loop.clock.unbilled_seconds.update(self.clock.unbilled_seconds)
        self._begin(None)

    def _begin(self, name: str | None) -> None:
        """End the running unbilled phase and begin the next."""
        interrupt.check()
        now = time.perf_counter()
        if self._phase:
            self.clock.unbilled_seconds[self._phase] += now - self._since
        self._phase, self._since = name, now
        if name:
            self.display.phase(name)

    def _rendered(self, done: int, total: int) -> None:
        interrupt.check()
        self.display.targets(done, total)

    def go(self, folder: Path, machine) -> int:
        """Rehearse, run, record. The record is finished whatever ends the loop.

        There is no folder before everything is known to work, and from then on Ctrl-C waits.
        """
        from .optimise import Hooks

        loop, display = self.loop, self.display
        display.phase("compile")
        loop.rehearse()
        interrupt.check()
        with interrupt.graceful(display.interrupted) as stop:
            display.phase("pictures")
            with loop.clock.unbilled("writing"):
                self._open(folder, machine)
            self._first: dict | None = None
            self._saved = time.monotonic()
            display.phase(str(self.cfg.sampler.name))
            try:
                status = loop.run(Hooks(self._evaluated, self._stepped, stop))
            except NumericalError:
                self._finish("numerical failure")
                raise
            self._finish(status)
        return interrupt.STATUS if status == "interrupted" else 0

    def _open(self, folder: Path, machine) -> None:
        """Begin the record: configuration, manifest, and the pictures that are known by now."""
        from .manifest import describe
        from .pictures import Pictures

        typed = self.typed
        self.writer = RunWriter(folder, overwrite=typed.overwrite)
        self.writer.config(OmegaConf.to_yaml(self.cfg, resolve=True))
        self.writer.manifest(describe(machine, self.problem, typed.seed, typed.target.seed))
        tags = {"scene": typed.scene.name, "sampler": self.cfg.sampler.name}
        self.pictures = Pictures(
            self.problem, self.writer, typed.frames.views, typed.frames.spp, tags
        )
        self.pictures.targets()

    def _evaluated(self, row: dict) -> None:
        self._first = self._first or row
        with self.loop.clock.unbilled("writing"):
            self.writer.evaluation(row)
        self.display.evaluated(row)

    def _stepped(self, loop, progress: float) -> None:
        self.display.stepped(loop, progress)
        if time.monotonic() - self._saved > _CHECKPOINT_SECONDS:
            self._checkpoint()

    def _checkpoint(self) -> None:
        with self.loop.clock.unbilled("writing"):
            arrays, state = self.loop.export()
            self.writer.checkpoint(arrays, state)
        self._saved = time.monotonic()

    def _finish(self, status: str) -> None:
        """Checkpoint, pictures, summary, report, in this order: the dearest first."""
        loop = self.loop
        self._checkpoint()
        self._summary(status)
        self.display.phase("pictures")
        with loop.clock.unbilled("writing"):
            # The start as well: rendered before the loop it would only delay it.
            self.pictures.values("start", self.problem.unknowns.starts(), self.typed.seed, 0)
            self.pictures.values(
                "result", self.stepper.values, self.typed.seed, loop.position.iteration
            )
            density = loop.density()
            if density is not None:
                self.pictures.density(density, loop.position.iteration)
        self._summary(status)
        from .report import write

        self.display.phase("report")
        page = write(self.writer.folder)
        self._announce(status, page)

    def _warnings(self) -> list[str]:
        """What a reader of the figures should know."""
        warnings = list(self.problem.warnings)
        renderers = (self.loop.evaluator.renderer, self.pictures.renderer)
        lost = sum(r.nonfinite for r in renderers)
        if lost:
            warnings.append(f"{lost} paths of evaluations and pictures were not finite: left out")
        if not self.loop.estimator.loss.linear:
            warnings.append(f"loss={self.cfg.loss.name} is biased with single samples")
        return warnings

    def _summary(self, status: str) -> None:
        errors = ("loss", "image_rmse", "parameter_rmse")

        def of(row: dict) -> dict:
            return {k: v for k, v in row.items() if k in errors or k.startswith("parameter_rmse/")}

        loop = self.loop
        self.writer.summary(
            {
                "status": status,
                "scene": self.typed.scene.name,
                "sampler": self.cfg.sampler.name,
                "loss": self.cfg.loss.name,
                "seed": self.typed.seed,
                "iterations": loop.position.iteration,
                "paths": loop.position.paths,
                "seconds_billed": loop.clock.seconds,
                "seconds_by_phase": dict(loop.clock.billed_seconds),
                "seconds_unbilled": dict(loop.clock.unbilled_seconds),
                "start": of(self._first),
                "final": of(loop.last),
                "warnings": self._warnings(),
            }
        )

    def _announce(self, status: str, page: Path) -> None:
        first, last = self._first, self.loop.last
        self.display.stop()
        say = self.display.say
        for name in ("image_rmse", "parameter_rmse"):
            if name in last:
                say(f"{name}: {first[name]:.4g} → {last[name]:.4g}")
        for warning in self._warnings():
            say(f"warning: {warning}")
        if status == "interrupted":
            say("interrupted: the record is complete up to here")
        # The one line on standard output: where the result is.
        print(f"report: {page}")
