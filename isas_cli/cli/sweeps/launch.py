"""Which jobs of a sweep are left to do, and how each ended."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf, open_dict

from ...config.compose import compose
from ...engine.display import say
from ...runtime import interrupt
from ...runtime.errors import InputError
from .job import DONE, Job, Report
from .launchers import Launcher
from .outcome import Outcome, outcome, read_summary, shown
from .worker import supervise


def planned(overrides: list[str], label: str, number: int) -> Job:
    """The job of these settings, the ``number``-th of its sweep. Raises InputError."""
    cfg = compose(overrides, hydra=True)
    before = HydraConfig.instance().cfg
    try:
        with open_dict(cfg):
            cfg.hydra.job.id = cfg.hydra.job.num = number
        HydraConfig.instance().set_config(cfg)
        folder = Path(cfg.hydra.sweep.dir, str(cfg.hydra.sweep.subdir))
        with open_dict(cfg):
            del cfg["hydra"]
        OmegaConf.resolve(cfg)
    finally:
        HydraConfig.instance().cfg = before
    return Job(label, overrides, Path(os.path.abspath(folder)), cfg)


class Task:
    """What a launcher calls for each job, in a thread of this process or in another process."""

    def __init__(self, command: list[str], threads: int | None, quiet: bool):
        self.command, self.threads, self.quiet = command, threads, quiet
        self.home = os.getcwd()

    def __call__(self, job: Job, stop: Callable[[], bool] | None) -> Outcome:
        """``stop``: whether Ctrl-C came; None in another process, which listens for itself."""
        if stop is None:
            os.chdir(self.home)  # a cluster's workers begin elsewhere
            with interrupt.graceful() as stop:
                return self(job, stop)
        if stop():
            return outcome(job.label, job.folder, "not begun", interrupt.STATUS)
        if not self.quiet:
            say(f"{job.label}: {shown(job.folder)}")
        result = supervise(job, self.command, self.threads, self.quiet, stop)
        if self.quiet or not result.finished:
            say(f"{job.label}: {result.status}")
        return result


class Sweep:
    """The jobs of one command and what became of them."""

    def __init__(self, launcher: Launcher, stop: Callable[[], bool]):
        self.launcher, self.stop = launcher, stop
        self.jobs: list[Job] = []
        self.settled: dict[Path, Outcome] = {}
        self.stamps: dict[Path, int | None] = {}  # before the sweep

    def launch(self, jobs: Sequence[Job]) -> list[Outcome]:
        """Does those jobs that are not done. Raises InputError where two would share a folder."""
        _refuse_shared(jobs)
        self.jobs += jobs
        todo = {}
        for job in jobs:
            self.stamps.setdefault(job.folder, job.stamp())
            skipped = None if job.folder in self.settled else job.skipped()
            if skipped:
                say(f"{job.label}: skipped: done in {shown(job.folder)}{job.doubt()}")
                self.settled[job.folder] = skipped
            elif job.folder not in self.settled:
                todo[job.folder] = job
        threads = self.launcher.threads(len(jobs))
        if todo and threads and not all(job.cfg.threads for job in jobs):
            say(f"jobs: {len(todo)}, each with threads={threads}")
        task = Task(sys.argv, threads, self.launcher.quiet)
        left = list(todo.values())
        for job, result in zip(left, self.launcher.launch(task, left, self.stop) if left else ()):
            if isinstance(result, Exception):
                result = self._finished(job) or self._lost(job, result)
            self.settled[job.folder] = result
        return [self.settled.get(job.folder) or self._unsettled(job) for job in jobs]

    @property
    def outcomes(self) -> list[Outcome]:
        """One for each job, also after an interruption."""
        return [self.settled.get(job.folder) or self._unsettled(job) for job in self.jobs]

    def _unsettled(self, job: Job) -> Outcome:
        """Of a job that the sweep's interruption left."""
        begun = job.stamp() != self.stamps[job.folder]
        status = "interrupted" if begun else "not begun"
        return self._finished(job) or outcome(job.label, job.folder, status, interrupt.STATUS)

    def _finished(self, job: Job) -> Outcome | None:
        """Of a job that was done, though its process did not live to say so; else None."""
        if job.stamp() == self.stamps[job.folder] or job.found() != DONE:
            return None
        return outcome(job.label, job.folder, "done")

    def _lost(self, job: Job, error: Exception) -> Outcome:
        """Of a job whose worker was lost; recorded, unless it had been told to stop before."""
        begun = job.stamp() != self.stamps[job.folder]
        if begun and (read_summary(job.folder) or {}).get("status") == "interrupted":
            return outcome(job.label, job.folder, "interrupted", interrupt.STATUS)
        text = " ".join(str(error).split("\n")[0].split())
        report = Report(1, f"its worker was lost: {type(error).__name__}: {text}", killed=True)
        if not job.written:
            job.record_failure(report, begun)
        return outcome(job.label, job.folder, "failed", 1, report.error)


def _refuse_shared(jobs: Sequence[Job]) -> None:
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
