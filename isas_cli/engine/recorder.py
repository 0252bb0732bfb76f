"""One loop and the folder that its record goes to."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from omegaconf import DictConfig, OmegaConf

from ..config.schema import Config, OptimizerConfig
from ..effects.settings import Effects
from ..filters import Laplacian, Nothing
from ..records import KEY_PREFIX, VALUE_PREFIX, RunWriter, manifest, safe_name, trackers
from ..rendering.renderer import Renderer
from ..runtime.errors import InputError, NumericalError
from . import ends, floor, held_out
from .loop import Hooks, Loop
from .pictures import Pictures
from .resumption import Continuation

if TYPE_CHECKING:
    from .profiling import Profile

# Written besides the billed time; a kill loses about this much work, or, where writing is slow
# (large textures), as much as keeps writing below this share of the time, up to the most.
_CHECKPOINT_SECONDS, _CHECKPOINT_MOST = 5.0, 600.0
_CHECKPOINT_SHARE = 0.01
# Of the images' error, what is much to be left out of them.
_MUCH = 0.5
# What other commands make of a result, below its record.
_DERIVED = "result/scene.xml", "relit/scores.json", "landscape.csv"


class Recorder:
    """Writes what a loop does: begin with ``open`` or ``reopen``, hand ``hooks`` to the loop, end
    with ``close`` and ``illustrate``, whatever ended the loop. ``display`` has ``evaluated(row)``,
    ``stepped(loop, spent)`` and ``phase(name)``.
    """

    def __init__(
        self,
        cfg: DictConfig,
        typed: Config,
        loop: Loop,
        folder: Path,
        display,
        renderer: Renderer | None = None,
    ):
        self.cfg, self.typed, self.loop, self.display = cfg, typed, loop, display
        self.folder, self._renderer = Path(folder), renderer
        self._first: dict = {}
        self._resumed: list[dict] = []
        self._begun: dict = {}  # the manifest of a run that goes on
        self._saved, self._status = 0.0, ""
        self._pause = _CHECKPOINT_SECONDS
        self._costs: list[float] = []  # of the last three checkpoints, seconds
        self._snapshots = 0
        # Of what may be doubted, the last row and value that were not.
        self._good: dict[str, tuple[dict, np.ndarray]] = {}
        self._doubted: set[str] = set()  # at the last evaluation
        self.held_out: dict | None = None  # errors of views held out, once pictured
        self.left_out: float | None = None  # by the plan of effects, once the run has ended
        self.profile: Profile | None = None  # once made, where the configuration asks for it

    def claimed(self) -> RunWriter:
        """The folder, empty of what an earlier run wrote there. Raises InputError when it holds a
        run that is not to be replaced."""
        return RunWriter(self.folder, overwrite=self.typed.overwrite)

    def open(self, machine, writer: RunWriter | None = None) -> None:
        """Begin the record: configuration, manifest, a checkpoint of the start, and the pictures
        that are known by now. ``writer``: of a folder that is ``claimed``; None claims it."""
        loop, typed = self.loop, self.typed
        with loop.clock.unbilled("writing"):
            self._take(writer or self.claimed())
            self._config(self.cfg)
            self.writer.manifest(
                manifest.describe(
                    machine,
                    loop.whole,
                    typed.seed,
                    typed.target.seed,
                    loop.plan.statements,
                    loop.plan.record(),
                    floor.told(loop.whole, loop.floor),
                )
            )
        self._checkpoint()
        with loop.clock.unbilled("writing"):
            self.pictures.targets()

    def reopen(self, machine, earlier: Continuation) -> None:
        """Go on with a record from its checkpoint. Raises InputError where that does not fit or
        another process writes the record. Takes its arrays away from ``earlier``."""
        loop, state = self.loop, earlier.state
        try:
            loop.restore(earlier.arrays, state)
        except (KeyError, ValueError, TypeError) as error:
            what = "/checkpoint/state.npz does not fit this run"
            raise InputError(f"{self.folder}{what}: {error!r}") from error
        earlier.arrays.clear()  # of large textures it is much, and the caller holds it to the end
        with loop.clock.unbilled("writing"):
            # The row of this iteration stays; trackers drop what comes after it.
            writer = RunWriter.reopen(self.folder, state["iteration"], state)
            self._take(writer, purge_step=state["iteration"] + 1)
            rows = self.writer.rows
            if rows:
                self._first, loop.last = rows[0], rows[-1]
            self._config(earlier.recorded)
            entry = manifest.continuation(
                *(machine, state["iteration"], loop.clock.seconds),
                *(earlier.earlier_budget, earlier.failed),
            )
            if earlier.earlier_budget and (turned := loop.turned_from(earlier.earlier_budget)):
                entry["turned"] = turned
            self._resumed = [*earlier.manifest.get("resumed", []), entry]
            self._begun = earlier.manifest
            self.writer.manifest({**earlier.manifest, "resumed": self._resumed})
            self.pictures.targets()  # a kill may have come before they were whole
        self._snapshots = self._snapshots_due(loop.position.evaluations)
        self._saved = self._own_seconds()

    def _take(self, writer: RunWriter, purge_step: int | None = None) -> None:
        typed = self.typed
        self.writer = writer
        text = OmegaConf.to_yaml(self.cfg, resolve=True)
        self.tracker = trackers.open(typed.tracker, self.folder, text, purge_step)
        self.pictures = Pictures(
            self.loop.whole,
            writer,
            typed.frames.views,
            typed.frames.spp,
            typed.seed,
            {
                "scene": typed.scene.name,
                "scene_hash": self.loop.problem.content_hash,
                "target_hash": self.loop.problem.target_hash,
                "sampler": self.cfg.sampler.name,
                "loss": self.cfg.loss.name,
                "seed": typed.seed,
            },
            self._renderer,
        )

    def _config(self, cfg: DictConfig) -> None:
        self.writer.config(OmegaConf.to_yaml(cfg, resolve=True))

    def hooks(self, stop) -> Hooks:
        return Hooks(self._evaluated, self._stepped, stop)

    def _evaluated(self, row: dict) -> None:
        self._first = self._first or row
        loop = self.loop
        with loop.clock.unbilled("evaluation"):
            doubted = set()
            for unknown in (u for u in loop.problem.unknowns if u.kind.doubtful):
                array = unknown.kind.whole(loop.stepper.values[unknown.key])
                if unknown.kind.doubt(array):
                    doubted.add(unknown.key)
                else:
                    self._good[unknown.key] = row, array
        with loop.clock.unbilled("writing"):
            if doubted != self._doubted:  # a kill leaves no time for it later
                self._doubted = doubted
                self._keep_good()
            self.writer.evaluation(row)
            self.tracker.evaluation(row)
        due = self._snapshots_due(loop.position.evaluations)
        if due > self._snapshots or (due and loop.spent >= 1):
            self._snapshots = due
            with loop.clock.unbilled("pictures"):
                image = self.pictures.snapshot(
                    loop.stepper.values, row["iteration"], row["seconds"]
                )
                self.tracker.image("snapshot", image, row["iteration"], self.pictures.exposure)
        self.display.evaluated(row)

    def _snapshots_due(self, evaluations: int) -> int:
        """How many snapshots there should be after so many evaluations, evenly spread."""
        wanted, total = self.typed.frames.snapshots, self.typed.evaluation.count
        return min(wanted, -(-evaluations * wanted // total))

    def _stepped(self, loop: Loop, spent: float) -> None:
        self.display.stepped(loop, spent)
        if self._own_seconds() - self._saved > self._pause:
            self._checkpoint()

    def _own_seconds(self) -> float:
        """Time that this loop has had: in a race, the others' turns do not count."""
        clock = self.loop.clock
        return clock.seconds + sum(clock.unbilled_seconds.values())

    def _checkpoint(self) -> None:
        begun = self._own_seconds()
        with self.loop.clock.unbilled("writing"):
            arrays, state = self.loop.export()
            self.writer.checkpoint(arrays, state)
        self._saved = self._own_seconds()
        # The least: one may have met a disk that stood still.
        self._costs = [*self._costs[-2:], self._saved - begun]
        wanted = max(_CHECKPOINT_SECONDS, min(self._costs) / _CHECKPOINT_SHARE)
        self._pause = min(wanted, _CHECKPOINT_MOST)

    def close(self, status: str) -> None:
        """Checkpoint and summary: what was dear to compute. ``illustrate`` completes the record."""
        self._status = status
        self._checkpoint()
        with self.loop.clock.unbilled("writing"):
            self._keep_good()
        self.left_out = self.loop.left_out()
        self._summary(status, complete=False)

    def illustrate(self, given_up: Callable[[], bool] = lambda: False) -> Path:
        """Profile (of a run that is done), pictures and report, after ``close``. Returns the path
        of the report's page, or the folder where the configuration wants no report.

        ``given_up``: asked now and then; what is not made yet is left to a continuation.
        """
        try:
            return self._illustrated(given_up)
        finally:
            self.writer.release()

    def _illustrated(self, given_up: Callable[[], bool]) -> Path:
        loop = self.loop
        done = self._status == "done" and loop.position.iteration > 0
        if self.typed.profile and done and not given_up():
            self._measure()
        self.display.phase("pictures")
        # The start as well: rendered before the loop it would only delay it.
        score = partial(self._held_out, given_up)
        for make in (self._result, self._start, self._density, score):
            if not given_up():
                with loop.clock.unbilled("pictures"):
                    make()
        self._summary(self._status, complete=not given_up())
        self.tracker.close()
        page = self.folder
        if self.typed.report:
            from ..report import write

            self.display.phase("report")
            page = write(self.folder)
        return page

    def _measure(self) -> None:
        from . import profiling

        self.display.phase("profile")
        with self.loop.clock.unbilled("profile"):
            self.profile = profiling.measure(self.loop, self.cfg.estimator.freeze)
            profiling.write(self.profile, self.folder)

    def _start(self) -> None:
        self.pictures.values("start", self.loop.problem.unknowns.starts(), 0)

    def _result(self) -> None:
        loop = self.loop
        self.pictures.values("result", loop.stepper.values, loop.position.iteration)

    def _density(self) -> None:
        density = self.loop.density()
        if density is not None:
            self.pictures.density(density, self.loop.position.iteration)

    def _held_out(self, given_up: Callable[[], bool]) -> None:
        problem, typed = self.loop.whole, self.typed
        if problem.held_out is not None:
            self.held_out = held_out.measure(
                problem.held_out,
                self.loop.stepper.values,
                typed.frames.spp,
                typed.seed,
                self.writer,
                given_up,
                lambda number, count: self.display.phase(f"held-out views {number} of {count}"),
            )

    @property
    def warnings(self) -> list[str]:
        """What a reader of the figures should know."""
        warnings = self.loop.problem.warnings + self.loop.warnings
        lost = self.loop.lost + self.pictures.renderer.nonfinite
        if lost:
            warnings.append(f"{lost} paths of evaluations and pictures were not finite: left out")
        if self.loop.lost_in_steps:
            paths = self.loop.lost_in_steps
            warnings.append(f"{paths} residuals of steps were not finite: left out of gradients")
        if self.loop.position.iteration:
            warnings += [
                f"'{key}': {count:,} entries of its gradients were not finite, and taken for 0: "
                "look for values at the edge of their range; isas replay takes a step again"
                for key, count in self.loop.stepper.lost.items()
                if count
            ]
            warnings += [
                f"'{key}' had no gradient in any step: the images do not depend on it where it is"
                for key in self.loop.stepper.untouched
            ]
            for key, doubt in self._doubts().items():
                kept = f"meshes/good_{safe_name(key)}.*"
                if key in self._good:
                    doubt += f"; {kept} is as of iteration {self._good[key][0]['iteration']}"
                elif any(self.folder.glob(kept)):
                    doubt += f"; {kept} is as it was before this run went on"
                warnings.append(doubt)
            warnings += ends.astray(*self.ends)
            warnings += ends.underway(self.loop.stepper)
            warnings += ends.stuck(*self.ends, self.loop.position.iteration)
        plan, last = self.loop.plan, self.loop.last or {}
        if self.left_out and plan and not plan.finish:
            # Where unknowns make up for all of it, the images are off by as much.
            if self.left_out > _MUCH * last.get("image_rmse", math.inf):
                warnings.append(
                    f"paths as they are simulated leave {self.left_out:.2g} out of the images, "
                    f"which are off by {last['image_rmse']:.2g}: results make up for it; take "
                    "effects=full, or effects.finish=0.3"
                )
        if not self.loop.evaluator.loss.linear:
            warnings.append(f"loss={self.cfg.loss.name} is biased with single samples")
        blurs = " and the blurs' widths" if self.loop.estimator.blurs else ""
        before = self._begun.get("machine", {}).get("device"), self._begun.get("threads")
        versions = manifest.versions(self._begun)
        for entry in self._resumed:
            if (newer := manifest.versions(entry)) != versions:
                told = (
                    f"{name} {newer.get(name, '–')} (before {versions.get(name, '–')})"
                    for name in sorted({*newer, *versions})
                    if newer.get(name) != versions.get(name)
                )
                warnings.append(f"from iteration {entry['iteration']} on with {', '.join(told)}")
            versions = newer
            if (now := (entry["device"], entry["threads"])) != before:
                warnings.append(
                    f"from iteration {entry['iteration']} on it ran on {now[0]} with {now[1]} "
                    f"threads, before on {before[0]} with {before[1]}: billed seconds add up both"
                )
            before = now
            if entry.get("failed") and self._status != NumericalError.ended:
                warnings.append(
                    "it had ended in a numerical failure, and went on from iteration "
                    f"{entry['iteration']}, before that"
                )
            if entry.get("earlier_budget") and self.loop.stepper.paced:
                turned = [
                    f", and '{key}' {'began to move' if moves else 'came to rest'}"
                    for key, moves in entry.get("turned", {}).items()
                ]
                warnings.append(
                    f"the budget was {entry['earlier_budget']} up to iteration "
                    f"{entry['iteration']}: the learning rate{blurs} followed another schedule"
                    f"{''.join(turned)}"
                )
        return warnings

    @property
    def notes(self) -> list[str]:
        """What a reader may want to know, and need not worry about."""
        notes = ends.reached(self.loop.problem.unknowns, self.loop.stepper.values)
        chosen = self.typed.optimizer.lr
        if chosen != OptimizerConfig().lr and all(u.lr for u in self.loop.problem.unknowns):
            notes.append(
                f"optimizer.lr={chosen:g} has no effect: every unknown has a rate of its own; "
                "optimizer.factor=… scales them"
            )
        notes += ends.unheeded(self.loop.stepper)
        chosen = self.loop.stepper.filter
        if chosen not in (Nothing(), Laplacian()) and not self.loop.stepper.filtering:
            notes.append(
                f"optimizer.filter={chosen.name} has no effect: no unknown has as many entries "
                "side by side as it takes"
            )
        if not self.loop.estimator.heeds_blurs:
            notes += [
                f"'{u.key}': its blur has no effect on the gradients of this estimator; its rate "
                f"falls as it would with it, by schedule {self.loop.stepper.falls[u.key]}"
                for u in self.loop.problem.unknowns
                if u.blur is not None
            ]
        if self.loop.prior is not None:
            notes += self.loop.prior.unheeded
        plan, finish = self.loop.plan, self.cfg.effects.get("finish")
        if finish and not (plan and plan.staged(self.loop.whole)):
            notes.append(
                f"effects.finish={finish:g} has no effect: nothing is left out of paths before it"
            )
        for name in ("tolerance", "derivative_tolerance"):
            asked = self.cfg.effects.get(name, usual := getattr(Effects(), name))
            if asked != usual and not self.loop.plan.seconds:
                notes.append(
                    f"effects.{name}={asked:g} has no effect: nothing was measured that it decides "
                    "on, which takes effects=auto and a budget of 10 seconds or more, of time alone"
                )
        if self._resumed and (old := [x for x in _DERIVED if (self.folder / x).exists()]):
            notes.append(f"made before this run went on, and not anew: {', '.join(old)}")
        if self.loop.converged:
            notes.append(
                "what is left is the targets' noise: a fit to them ends at an image_rmse of "
                f"{self.loop.floor.image_rmse:.2g}; target.noise=… lowers it"
            )
        if self.loop.unresolved:
            notes.append(
                "image_rmse ends at 0, which is no perfect fit: it is less than the "
                f"{self.cfg.evaluation.spp} paths a pixel of an evaluation can tell; "
                "evaluation.spp=… takes more"
            )
        return notes

    def _doubts(self) -> dict[str, str]:
        """By unknown, why its result is not to be trusted."""
        values = self.loop.stepper.values
        found = {
            u.key: u.kind.doubt(u.kind.whole(values[u.key]))
            for u in self.loop.problem.unknowns
            if u.kind.doubtful
        }
        return {key: doubt for key, doubt in found.items() if doubt}

    def _keep_good(self) -> None:
        """Of what is doubted, files of the last value that was not; those of an earlier end, where
        there has been none since."""
        doubts = self._doubts()
        for unknown in (u for u in self.loop.problem.unknowns if u.kind.doubtful):
            if unknown.key not in doubts:
                self.writer.good(safe_name(unknown.key), {})
            elif unknown.key in self._good:
                _, array = self._good[unknown.key]
                self.writer.good(safe_name(unknown.key), unknown.kind.files(array))

    @property
    def ends(self) -> tuple[dict, dict]:
        """First and last row of the history."""
        return self._first, self.loop.last or {}

    def _summary(self, status: str, complete: bool) -> None:
        """``complete``: pictures and report are there as well."""
        errors = ("loss", "image_rmse", "parameter_rmse")

        def of(row: dict) -> dict:
            prefixes = KEY_PREFIX, VALUE_PREFIX
            return {k: v for k, v in row.items() if k in errors or k.startswith(prefixes)}

        loop = self.loop
        self.writer.summary(
            {
                "status": status,
                "complete": complete,
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
                "left_out_rmse": self.left_out,
                **held_out.of_views(loop.whole, loop.stepper.values),
                **({} if self.held_out is None else {"held_out": self.held_out}),
                "warnings": self.warnings,
                "notes": self.notes,
            }
        )
