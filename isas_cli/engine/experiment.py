"""One run from its configuration to its record: the only place where all parts meet."""

from __future__ import annotations

import errno
import shlex
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from .. import records
from ..config import method, schema
from ..config.schema import Config
from ..records import trackers
from ..runtime import backend, interrupt, memory
from ..runtime.budget import Budget
from ..runtime.errors import InputError, NumericalError
from .choices import Choices
from .display import Display, say

if TYPE_CHECKING:
    from ..scene.problem import Problem
    from .recorder import Recorder
    from .replay import Replay

_LENSES = 4  # that are told one by one


def run(cfg: DictConfig, folder: Path) -> int:
    """Run ``cfg`` and leave its record in ``folder``. Returns 0, or 130 after Ctrl-C.

    Raises InputError before anything is computed where that is possible and before there is a
    record, and NumericalError after the record has been finished with the last good state.
    """
    typed, budget = checked(cfg)
    machine, (choices,) = started([cfg], typed)
    with _recorder(cfg, typed, budget, choices, Path(folder)) as recorder:
        return _go(recorder, lambda: recorder.open(machine))


def resume(folder: Path, changes: dict | None = None) -> int:
    """Go on with the run in ``folder`` from its last checkpoint. Returns 0, or 130 after Ctrl-C.

    ``changes``: new values by key, such as ``{"budget.seconds": 120}``; the budget is the whole
    run's, what was spent before included. Parameters, moments, the sampler's cells and the random
    streams continue as if there had been no stop. Raises InputError when there is nothing to
    continue, when the scene or its targets have changed since, or when the run is still going on.
    """
    from .resumption import check_variant, prepare

    earlier = prepare(Path(folder), changes or {})
    typed, budget = checked(earlier.cfg)
    machine, (choices,) = started([earlier.cfg], typed)
    check_variant(machine, earlier.manifest, earlier.folder)
    begun = earlier.manifest
    made = _recorder(earlier.cfg, typed, budget, choices, earlier.folder, begun)
    with memory.kept("isas run", earlier.folder), made as recorder:
        return _go(recorder, lambda: recorder.reopen(machine, earlier))


def replay(folder: Path, iteration: int | None = None) -> "Replay":
    """An iteration of the run in ``folder`` again, at the values of its checkpoint, by default the
    last. Raises InputError where there is no such run or its scene has changed since."""
    from .replay import again
    from .resumption import check_variant, configuration
    from .workshop import Workshop

    run = records.load(folder)
    arrays, state = records.load_checkpoint(folder)
    cfg, _ = configuration(folder, run, {})
    typed, budget = checked(cfg)
    machine, (choices,) = started([cfg], typed)
    why = "their random numbers differ, and with them every path"
    check_variant(machine, run.manifest, folder, why)
    with Display(budget) as display:
        phases = Phases(display)
        problem = built(typed, phases, [choices], [(run.manifest, folder)])
        phases.begin("replay")
        loop = Workshop(problem).loop(choices, typed, budget, run.manifest.get("plan"))
        try:
            loop.restore(arrays, state)
        except (KeyError, ValueError, TypeError) as error:
            raise InputError(f"{folder}/checkpoint does not fit this run: {error!r}") from error
        found = again(loop, max(0, state["iteration"] - 1) if iteration is None else iteration)
        phases.begin(None)
    return found


def checked(cfg: DictConfig) -> tuple[Config, Budget]:
    """The typed configuration and its budget. Raises InputError for what can be told without
    Mitsuba."""
    try:
        typed = schema.typed(cfg)
    except OmegaConfBaseException as error:  # of ${…}, which compose leaves as it stands
        raise InputError(f"{error.full_key}: {str(error).splitlines()[0]}") from error
    budget = Budget(typed.budget.seconds, typed.budget.iterations, typed.budget.paths)
    trackers.check(typed.tracker)
    return typed, budget


def started(cfgs: Iterable[DictConfig], typed: Config) -> tuple[backend.Backend, list[Choices]]:
    """The backend, started; then what each configuration chooses, which refuses its settings, and
    each other, before a scene is loaded."""
    machine = backend.start(typed.variant, typed.threads)
    made = [(Choices.of(cfg), schema.typed(cfg)) for cfg in cfgs]
    for choices, own in made:
        choices.check(own)
    if machine.left_out:
        say(f"variant={machine.variant}, as the GPU cannot be used: {machine.left_out}")
    return machine, [choices for choices, _ in made]


class Phases:
    """Unbilled phases before a loop has a clock of its own. Ctrl-C is heeded between them."""

    def __init__(self, display):
        self.display = display
        self.seconds: dict[str, float] = {}
        self._name, self._since = None, time.perf_counter()

    def begin(self, name: str | None) -> None:
        """End the phase that runs and begin the next."""
        interrupt.check()
        now = time.perf_counter()
        if self._name:
            spent = now - self._since
            self.seconds[self._name] = self.seconds.get(self._name, 0.0) + spent
        self._name, self._since = name, now
        if name:
            self.display.phase(name)

    def rendered(self, done: int, total: int) -> None:
        """Progress of the targets."""
        interrupt.check()
        self.display.targets(done, total)


def built(
    typed: Config,
    phases: Phases,
    choices: Iterable[Choices] = (),
    begun: Iterable[tuple[dict, Path]] = (),
) -> "Problem":
    """The problem of a configuration, its phases timed. Raises InputError before there are targets
    where one of ``choices``, which are to run on it, cannot; also, as early as it can be told,
    where it is not what runs have ``begun`` with: manifest and folder of each."""
    from . import assemble, floor
    from .resumption import check_same

    begun = list(begun)

    def check(problem: "Problem") -> None:
        for each in begun:
            check_same(problem, *each)
        if typed.budget.converged:
            floor.check(problem, typed.scene.weights)
        for each in choices:
            each.check_on(problem)

    made = assemble.problem(typed.scene, typed.target, phases.rendered, phases.begin, check)
    for each in begun:
        check_same(made, *each)
    return made


@contextmanager
def _recorder(
    cfg: DictConfig,
    typed: Config,
    budget: Budget,
    choices: Choices,
    folder: Path,
    begun: dict | None = None,
) -> Iterator["Recorder"]:
    """Everything up to the loop, compiled; no folder is written yet. ``begun``: the manifest of a
    run that goes on. Afterwards the scene, which a program may hold, has the values that it was
    loaded with, but for what unknowns rewrite, and no gradients."""
    with Display(budget) as display:
        phases = Phases(display)
        problem = built(typed, phases, [choices], [(begun, folder)] if begun else ())
        try:
            phases.begin("prepare")
            from .recorder import Recorder
            from .workshop import Workshop

            workshop = Workshop(problem)
            loop = workshop.loop(choices, typed, budget, (begun or {}).get("plan"))
            phases.begin(None)
            loop.clock.unbilled_seconds.update(phases.seconds)
            yield Recorder(cfg, typed, loop, folder, display, workshop.renderer)
        finally:
            # Gradients on it would break passes through another one. What failed is told, not this.
            with suppress(Exception):
                problem.unknowns.write(problem.unknowns.loaded())


def _go(recorder: "Recorder", begin: Callable[[], None]) -> int:
    """Rehearse, run, record. The record is finished when the budget, Ctrl-C or a numerical failure
    ends the loop; after any other end its checkpoint can be continued.

    There is no folder before everything is known to work, and from then on Ctrl-C waits.
    """
    loop, display = recorder.loop, recorder.display
    display.phase("compile")
    loop.rehearse()
    interrupt.check()
    full = memory.kept("isas run", recorder.folder)
    with interrupt.graceful(display.interrupted) as stop, full:
        display.phase("pictures")
        begin()
        _tell(recorder)
        display.phase(str(recorder.cfg.sampler.name))
        try:
            status = loop.run(recorder.hooks(stop))
        except NumericalError as error:
            recorder.close(NumericalError.ended)
            from .replay import again

            found = again(loop, loop.position.iteration - 1)
            _announce(recorder, NumericalError.ended, recorder.illustrate())
            where = shlex.quote(str(recorder.folder))
            raise NumericalError(f"{error}; {found}; isas replay {where}") from error
        recorder.close(status)
        # Stopped once, a run has its pictures made; stopped while they are made, it does not.
        given_up = stop if status == "done" else lambda: False
        _announce(recorder, status, recorder.illustrate(given_up))
        if given_up():
            status = "interrupted"
    return interrupt.STATUS if status == "interrupted" else 0


def _tell(recorder: "Recorder") -> None:
    """What the scene takes by itself, and what is simulated."""
    if of_scene := method.taken(recorder.cfg):
        recorder.display.say(f"scene={recorder.cfg.scene.name} takes {' '.join(of_scene)}")
    plan = recorder.loop.plan
    told = "paths", "views", "differentiated", "caustics", "roulette", "light samples", "finish"
    for effect in told:
        if not plan.statements.get(effect, "not met").startswith("not met"):
            recorder.display.say(f"{effect}: {plan.statements[effect]}")
    if plan.seconds:
        recorder.display.say(f"found by a probe of {plan.seconds:.1f} billed seconds")


def _announce(recorder: "Recorder", status: str, page: Path) -> None:
    from . import held_out

    first, last = recorder.ends
    recorder.display.stop()
    say = recorder.display.say
    for name in ("image_rmse", "parameter_rmse"):
        if name in first and name in last:
            say(f"{name}: {first[name]:.4g} → {last[name]:.4g}")
    if recorder.held_out is not None:
        mean = recorder.held_out["mean"]
        told = ", ".join(f"{k.upper()} {v:.4g}" for k, v in mean.items() if v is not None)
        left = recorder.held_out.get("left_out")
        more = f"; {left} more were not scored" if left else ""
        if (scale := recorder.held_out["scale"]) != 1:
            more += f"; pictures times {scale:.3g}, as they are all dark, or often beyond white"
        say(f"{len(recorder.held_out['views'])} views held out: {told}{more}")
    lenses = held_out.of_views(recorder.loop.whole, recorder.loop.stepper.values).get("lens", {})
    for name, numbers in list(lenses.items())[:_LENSES]:
        told = ", ".join(f"{what.replace('_', ' ')} {x:.4g}" for what, x in numbers.items())
        say(f"lens of {name}: {told}")
    if recorder.left_out is not None:
        left = f"{recorder.left_out:.2g}" if recorder.left_out else "less than can be told"
        say(f"left out of the images: {left} (root mean square)")
    if recorder.profile is not None:
        from .profiling import table

        recorder.display.console.print(table(recorder.profile), highlight=False)
    for warning in recorder.warnings:
        say(f"warning: {warning}")
    for note in recorder.notes:
        say(note)
    if status == "interrupted":
        say("interrupted: the record is complete up to here; go on with")
        say(f"  isas run {shlex.quote(f'resume={recorder.folder}')}")
    # The one line on standard output: where the result is.
    try:
        print(f"{'report' if recorder.typed.report else 'record'}: {page}", flush=True)
    except OSError as error:
        if error.errno != errno.EIO:  # of a terminal that is gone
            raise
