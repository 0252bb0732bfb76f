"""Between Hydra's sweeper and its launcher: which jobs are left to do, and how each ended."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn, JobStatus
from hydra.plugins.launcher import Launcher
from omegaconf import DictConfig, OmegaConf, open_dict

from ...runtime import interrupt
from ...runtime.errors import InputError, IsasError
from .. import one
from . import fingerprint, launchers
from .job import DONE, Job, Report, record_failure, stamp, supervise
from .outcome import Outcome, outcome, shown

# A launcher whose worker was killed from outside is started again for what is left.
_MOST_BREAKDOWNS = 3
_SEARCH = "optimization_results.yaml"  # of Hydra's Optuna sweeper

# Workers import this module when they are handed a Task, and resolve the configuration later.
fingerprint.register()


class Task:
    """What a launcher calls for each job, in this process or in a worker."""

    def __init__(self, command: list[str]) -> None:
        self.command, self.home = command, os.getcwd()
        self.threads: int | None = None
        self.quiet = False
        self.jobs: dict[str, Job] = {}
        self._process = os.getpid()

    def __call__(self, cfg: DictConfig) -> Outcome:
        """Do the job that was planned for Hydra's output folder."""
        job = self.jobs[HydraConfig.get().runtime.output_dir]
        if Path.cwd() != Path(self.home):  # a cluster's workers begin elsewhere
            os.chdir(self.home)
        if not self.quiet:
            _say(f"{job.label}: {shown(job.folder)}")
        result, stopped = supervise(job, self.command, self.threads, self.quiet)
        if self.quiet or not result.finished:
            _say(f"{job.label}: {result.status}")
        # A worker's outcome goes back to the sweep; here the jobs that follow must not begin.
        if (stopped or result.status == "interrupted") and os.getpid() == self._process:
            raise KeyboardInterrupt
        return result


class Sweep:
    """The jobs of one command and what became of them."""

    def __init__(self, task: Task, typed: list[str]) -> None:
        self.task, self.typed = task, typed
        self.jobs: list[Job] = []
        self.settled: dict[Path, Outcome] = {}
        self.stamps: dict[Path, int | None] = {}  # before the sweep
        self.config: DictConfig | None = None
        self.begun = False

    @contextlib.contextmanager
    def attached(self) -> Iterator[None]:
        """Within the context this stands between sweeper and launcher, for which Hydra has no
        hook; its own entry drops what jobs return."""
        original = Plugins.instantiate_launcher

        def instantiate(*arguments, **keywords) -> Launcher:
            return _Between(original(*arguments, **keywords), self)

        Plugins.instantiate_launcher = instantiate
        try:
            yield
        finally:
            Plugins.instantiate_launcher = original

    @property
    def outcomes(self) -> list[Outcome]:
        """One for each job, also after an interruption."""
        return [self.settled.get(job.folder) or self._unsettled(job) for job in self.jobs]

    @property
    def failed(self) -> bool:
        """Whether there were jobs, and none succeeded."""
        return bool(self.settled) and not any(o.finished for o in self.settled.values())

    def _unsettled(self, job: Job) -> Outcome:
        """Of a job that the sweep's interruption left."""
        begun = stamp(job.folder) != self.stamps[job.folder]
        status = "interrupted" if begun else "not begun"
        return self.finished(job) or outcome(job.label, job.folder, status, interrupt.STATUS)

    def finished(self, job: Job) -> Outcome | None:
        """Of a job that was done, though its worker did not live to say so; else None."""
        if stamp(job.folder) == self.stamps[job.folder] or job.found() != DONE:
            return None
        return outcome(job.label, job.folder, "done")

    def lost(self, job: Job, error: BaseException) -> Outcome:
        """Of a job whose worker was lost; recorded."""
        text = " ".join(str(error).split("\n")[0].split())
        report = Report(1, f"its worker was lost: {type(error).__name__}: {text}", killed=True)
        record_failure(job, report, begun=stamp(job.folder) != self.stamps[job.folder])
        return outcome(job.label, job.folder, "failed", 1, report.error)

    def result(self, job: Job, result: JobReturn | BaseException) -> Outcome:
        """Of a job for which the launcher gave back ``result``."""
        if isinstance(result, BaseException):
            return self.finished(job) or self.lost(job, result)
        if result.status == JobStatus.FAILED:  # outside of the job's own process
            return self.lost(job, result._return_value)
        return result.return_value

    def tidy(self) -> None:
        """Take away Hydra's note of the sweep, which the next would overwrite, and a folder that
        nothing went into; put the result of a search beside its jobs."""
        if self.config is None:
            return
        folder = Path(str(self.config.hydra.sweep.dir))
        with contextlib.suppress(OSError):
            (folder / "multirun.yaml").unlink()
        with contextlib.suppress(OSError, ValueError):
            place = Path(os.path.commonpath([job.folder.parent for job in self.jobs]))
            (folder / _SEARCH).replace(place / _SEARCH)
        one.remove_empty(folder)

    def show_best(self) -> None:
        """One line for a search: its best job."""
        choose = {"minimize": min, "maximize": max}
        direction = str(self.config.hydra.sweeper.get("direction", "")).rpartition(".")[2]
        found = [o for o in self.outcomes if o.value is not None]
        if found and direction in choose:
            best = choose[direction](found, key=float)
            _say(f"best: {best.label}: {best.value:.4g}: {shown(best.folder)}")

    def label(self, overrides: Sequence[str]) -> str:
        """What tells a job from the others."""
        own = [o for o in overrides if o not in self.typed and not o.startswith("hydra")]
        return " ".join(own or overrides)


class _Between(Launcher):
    def __init__(self, inner: Launcher, sweep: Sweep) -> None:
        self.inner, self.sweep = inner, sweep
        sweep.config = inner.config

    def setup(self, **unused) -> None:
        """The launcher inside has been set up."""

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        sweep, config = self.sweep, self.inner.config
        jobs = [self._planned(list(o), initial_job_idx + i) for i, o in enumerate(job_overrides)]
        _refuse_shared(jobs)
        sweep.jobs += jobs
        for job in jobs:
            sweep.stamps.setdefault(job.folder, stamp(job.folder))
        todo = {job.folder: job for job in jobs if job.folder not in sweep.settled}
        for folder, job in list(todo.items()):
            skipped = job.skipped()
            if skipped:
                _say(f"{job.label}: skipped: done in {shown(folder)}")
                sweep.settled[folder] = skipped
                del todo[folder]
        sweep.begun, task = True, sweep.task
        task.jobs = {str(folder): job for folder, job in todo.items()}
        task.threads = launchers.threads(config.hydra.launcher, len(jobs))
        task.quiet = launchers.parallel(config.hydra.launcher)
        if todo:
            if task.threads and not all(job.cfg.threads for job in jobs):
                _say(f"jobs: {len(todo)}, each with threads={task.threads}")
            self._do(list(todo.values()), initial_job_idx)
        return [_returned(job, sweep.settled[job.folder]) for job in jobs]

    def _planned(self, overrides: list[str], number: int) -> Job:
        loader = self.inner.hydra_context.config_loader
        before = HydraConfig.instance().cfg
        try:
            cfg = loader.load_sweep_config(self.inner.config, overrides)
            with open_dict(cfg):
                cfg.hydra.job.id = cfg.hydra.job.num = number
                HydraConfig.instance().set_config(cfg)
                parts = cfg.hydra.sweep.dir, cfg.hydra.sweep.subdir
                OmegaConf.resolve(cfg.scene)
                folder = Path(os.path.abspath(os.path.join(*map(str, parts))))
                del cfg["hydra"]
                OmegaConf.resolve(cfg)
        finally:
            HydraConfig.instance().cfg = before
        return Job(self.sweep.label(overrides), overrides, folder, cfg)

    def _do(self, todo: list[Job], number: int) -> None:
        """Have the jobs done; each is settled then."""
        sweep = self.sweep
        for _ in range(_MOST_BREAKDOWNS):
            try:
                with launchers.patient(self.inner):
                    results = self.inner.launch([_fixed(job) for job in todo], number)
            except BrokenExecutor as error:
                interrupt.check()
                reason = error
            except IsasError:
                raise
            except Exception as error:
                interrupt.check()  # it may come out as another exception
                name = self.inner.config.hydra.launcher._target_.rpartition(".")[2]
                text = " ".join(str(error).split()) or type(error).__name__
                raise InputError(f"{name} cannot launch the jobs: {text}") from error
            else:
                for job, result in zip(todo, results, strict=True):
                    sweep.settled[job.folder] = sweep.result(job, result)
                return
            sweep.settled |= {job.folder: done for job in todo if (done := sweep.finished(job))}
            todo = [job for job in todo if job.folder not in sweep.settled]
            if not todo:
                return
            _say(f"a worker was killed: begun again for the {len(todo)} jobs that are left")
        sweep.settled |= {job.folder: sweep.lost(job, reason) for job in todo}


def _refuse_shared(jobs: list[Job]) -> None:
    """Jobs that are the same are done once; others must not write to one folder."""
    first: dict[Path, Job] = {}
    for job in jobs:
        other = first.setdefault(job.folder, job)
        ours, theirs = (OmegaConf.to_container(j.cfg) | {"name": ""} for j in (job, other))
        if ours != theirs:
            raise InputError(
                f"'{other.label}' and '{job.label}' would share the folder {shown(job.folder)}: "
                "tell them apart by their name, such as name='threads${threads}'"
            )


def _fixed(job: Job) -> list[str]:
    """The overrides with the folder that was planned, wherever the job is composed."""
    parent, name = (
        QuotedString(text, Quote.single).with_quotes() for text in os.path.split(job.folder)
    )
    return [*job.overrides, f"hydra.sweep.dir={parent}", f"hydra.sweep.subdir={name}"]


def _returned(job: Job, result: Outcome) -> JobReturn:
    returned = JobReturn(overrides=job.overrides, cfg=job.cfg, status=JobStatus.COMPLETED)
    returned.return_value = result
    return returned


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
