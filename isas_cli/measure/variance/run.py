"""One measurement of variances, from its configurations to its folder."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from omegaconf import DictConfig, OmegaConf

from ...config.schema import Config
from ...engine.choices import Choices
from ...engine.display import Display, Stderr
from ...engine.experiment import Phases, built, checked
from ...estimators import two_path
from ...runtime import backend, interrupt
from ...runtime.errors import InputError, IsasError

if TYPE_CHECKING:
    from ...scene.problem import Problem
    from .best import Best
    from .rounds import Bench, Contestant

_MADE = ("variance.csv", "variance.png", "variance.svg")
_MADE += ("density_*_v[0-9]*.exr", "density_*_v[0-9]*.png", "densities_v[0-9]*.png")
_WIDTH = 160  # columns where there is no terminal: no figure may be cut


@dataclass
class Plan:
    """``cfgs``: the configuration of each sampler by its label, alike but for the sampler;
    ``repeats``: estimates with each; ``at``: the point, 0 the start values and 1 the truth;
    ``best``: paths per pixel for the best pmf, 0 to leave it out; ``asked``: whether the samplers
    were named, so that one that cannot be measured is refused and not left out."""

    cfgs: dict[str, DictConfig]
    folder: Path
    repeats: int
    at: float
    best: int
    asked: bool = True

    @property
    def common(self) -> DictConfig:
        return next(iter(self.cfgs.values()))


def _told(display: Display, done: int, total: int, what: str) -> None:
    """How far the brute force and the rounds have come."""
    interrupt.check()
    text = f"{done} of {total} {what}"
    display.advanced(done / total, text, text)


def run(plan: Plan) -> int:
    """Measure and record. Returns 0, or 130 after Ctrl-C: all whole rounds are then recorded.

    Raises InputError before anything is computed where that is possible.
    """
    typed, _ = checked(plan.common)
    machine = backend.start(typed.variant, typed.threads)
    made = {label: Choices.of(cfg) for label, cfg in plan.cfgs.items()}
    estimator = next(iter(made.values())).estimator
    if type(estimator) is not two_path.Settings:
        raise InputError(
            f"{estimator.chosen}: variances are measured of path replay's gradient with each "
            "sampler: take estimator=two_path and a scene in which nothing moves"
        )
    if not plan.asked:
        made = {label: c for label, c in made.items() if c.sampler.needs <= estimator.gives}
        plan = replace(plan, cfgs={label: plan.cfgs[label] for label in made})
    for choices in made.values():
        choices.check(typed)
    with Display(None) as display:
        phases = Phases(display)
        if estimator.blurred:
            raise InputError(
                "estimator.blurred=true: isas variance measures the gradient of the sharp loss: "
                "leave it out"
            )
        if any(choices.loss.windows for choices in made.values()):
            raise InputError(
                "isas variance measures what single pixels contribute: take loss=l2, relative_l2 "
                "or l1"
            )
        # The papers' estimator: what a pixel contributes, and so the best pmf, is known of it.
        estimator = replace(estimator, crossed=False)
        problem = estimator.differentiated(built(typed, phases, made.values()))
        for unknown in problem.unknowns:
            unknown.doubled = ()  # at a fixed point all are whole
        if problem.views.altered:
            raise InputError(
                "exposures, poses and lenses of views have derivatives that no path carries, and "
                "isas variance measures those of paths: take photos.exposure=fixed, "
                "photos.refine=false, photos.lens=[]"
            )
        if aside := [u.key for u in problem.unknowns if u.kind.aside]:
            raise InputError(
                f"scene.unknowns: '{aside[0]}' is found by differences, and isas variance measures "
                "derivatives of paths: leave it out"
            )
        bench, contestants, best = _prepared(plan, made, typed, problem, phases)
        with interrupt.graceful(display.interrupted) as stop:
            return _Record(plan, typed, machine, bench, contestants, best, display).make(stop)


def _prepared(
    plan: Plan, made: dict[str, Choices], typed: Config, problem: "Problem", phases: Phases
):
    """Everything up to the first round; no folder is written yet."""
    from . import best as best_pmf
    from . import moments
    from .rounds import Bench
    from .table import BEST

    phases.begin("prepare")
    values = point(problem, plan.at)
    first = next(iter(made.values()))
    loss, freeze = first.loss, first.estimator.freeze
    how = first.estimator.batch, typed.seed, typed.optimizer, freeze
    bench = Bench(problem, loss, values, *how)
    best: Best | None = None
    if plan.best:
        phases.begin("moments")

        def done(paths, total):
            _told(phases.display, paths, total, "paths per pixel for the best pmf")

        measured = moments.measure(problem, loss, values, plan.best, typed.seed, freeze, done)
        bench.second_moment = measured.second_moment
        best = best_pmf.find(measured)
    contestants = []
    for label, choices in made.items():
        phases.begin(f"compile {label}")
        contestants.append(bench.sampled(label, choices.sampler))
    if best:
        contestants.append(bench.fixed(BEST, best.distribution))
    phases.begin(None)
    return bench, contestants, best


def point(problem: "Problem", at: float) -> dict:
    """The values between start (0) and truth (1). Raises InputError where no truth is known."""
    if at and not problem.truth_known:
        raise InputError(f"at={at:g}: the truth is not known, so only the start values, at=0")
    values = {}
    for unknown in problem.unknowns:
        values[unknown.key] = unknown.start
        if at:
            way = unknown.truth.astype(np.float64) - unknown.start
            values[unknown.key] = (unknown.start + at * way).astype(np.float32)
    return problem.unknowns.values_of(values)


@dataclass
class _Record:
    """Writes what the rounds give."""

    plan: Plan
    typed: Config
    machine: object
    bench: "Bench"
    contestants: "list[Contestant]"
    best: "Best | None"
    display: Display

    def make(self, stop) -> int:
        from .table import Results, rows, write

        self.table: list[dict] = []
        self._open()
        paths = self.bench.estimator.paths_per_step
        results = Results(self.typed.estimator["batch"], paths, self.best)

        def finished(rounds: list[int]) -> None:
            self.table = rows(self.contestants, rounds, results)
            write(self.table, self.plan.folder)
            _told(self.display, sum(rounds), self.plan.repeats, "repeats")

        self.display.phase("rounds")
        done = self.bench.run(self.contestants, self.plan.repeats, finished, stop)
        self.bench.problem.unknowns.write(self.bench.values)
        if not self.table:
            self.display.say("interrupted before the first round was finished: nothing is known")
            return interrupt.STATUS
        self.display.phase("pictures")
        self._draw()
        self._announce()
        return 0 if done else interrupt.STATUS

    def _open(self) -> None:
        from ... import effects  # imports Mitsuba
        from ...records import manifest
        from ...records.files import write_json, write_text

        plan, typed = self.plan, self.typed
        try:
            plan.folder.mkdir(parents=True, exist_ok=True)
            # An earlier measurement's, and no file of anyone else's.
            earlier = (plan.folder / "manifest.json").exists()
            if (plan.folder / "history.csv").exists():
                raise InputError(f"{plan.folder} holds a run: choose another hydra.run.dir=DIR")
            for old in (o for made in _MADE for o in plan.folder.glob(made) if earlier):
                old.unlink()
        except OSError as error:
            raise IsasError(f"{plan.folder}: cannot be written: {error.strerror}") from error
        asked = {"repeats": plan.repeats, "at": plan.at, "best": plan.best}
        cfg = OmegaConf.to_container(plan.common, resolve=True)
        del cfg["sampler"]
        samplers = {
            label: OmegaConf.to_container(own.sampler, resolve=True)
            for label, own in plan.cfgs.items()
        }
        text = OmegaConf.to_yaml(OmegaConf.create({**asked, "samplers": samplers, **cfg}))
        write_text(plan.folder / "config.yaml", text)
        problem = self.bench.problem
        simulated = effects.statements(problem, problem.integrator.derivatives)
        described = manifest.describe(
            self.machine, problem, typed.seed, typed.target.seed, simulated
        )
        if self.best:
            asked["best_pmf"] = {"neighbours": self.best.share, "width": self.best.width}
        write_json(plan.folder / "manifest.json", {**described, "variance": asked})

    def _draw(self) -> None:
        from . import pictures

        problem, plan = self.bench.problem, self.plan
        pictures.bars(self.table, plan.folder, self._title)
        pictures.densities(
            problem,
            {c.label: c.distribution for c in self.contestants},
            pictures.chosen(problem, self.typed.frames.views),
            plan.folder,
            {
                "scene": self.typed.scene.name,
                "scene_hash": problem.content_hash,
                "loss": plan.common.loss.name,
                "seed": self.typed.seed,
                "at": plan.at,
            },
        )

    @property
    def _title(self) -> str:
        where = {0.0: "at the start values", 1.0: "at the truth"}
        at = where.get(self.plan.at, f"{self.plan.at:g} of the way from start to truth")
        repeats = self.table[0]["repeats"]
        batch = self.typed.estimator["batch"]
        return f"{self.typed.scene.name}, gradient {at}, {repeats} estimates of {batch} pixels each"

    def _announce(self) -> None:
        from .table import BEST, biased, shown

        self.display.stop()
        console = self.display.console
        if not console.is_terminal:
            console = Stderr(stderr=True, width=_WIDTH)
        console.print(shown(self.table, self._title), highlight=False)
        for row in self.table:
            if row["sampler"] == BEST:
                self.display.say(
                    f"independent draws: best pmf {row['variance_iid']:.3g} in closed form, no pmf "
                    f"constant in a tile below {row['variance_iid_bound']:.3g} "
                    "(variance_iid in variance.csv)"
                )
            if row["nonfinite"]:
                count = row["nonfinite"]
                self.display.say(
                    f"warning: {row['sampler']}: {count} entries not finite, taken as 0"
                )
            if biased(row):
                self.display.say(f"warning: {row['sampler']}: its mean is not that of uniform")
        # The one line on standard output: where the result is.
        print(f"variance: {self.plan.folder}")
