"""Where the jobs of a sweep are done: on this machine, on a cluster, or through Ray.

Not by Hydra's own launchers: before these is no place where a job that is done could be skipped or
one that was stopped go on, and where one job's worker is lost they drop the results of all.
"""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Callable, Iterator
from typing import Any, Protocol

from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from omegaconf import DictConfig, OmegaConf

from ...runtime import interrupt
from ...runtime.errors import InputError, extra
from .job import Job
from .outcome import Outcome

# Configured in configs/hydra; the packages that they need, and the extras that bring these.
_EXTRAS = {
    ("launcher", "ray"): ("ray", "ray"),
    ("launcher", "submitit_local"): ("submitit", "slurm"),
    ("launcher", "submitit_slurm"): ("submitit", "slurm"),
    ("sweeper", "optuna"): ("optuna", "optuna"),
}
_OURS = [*_EXTRAS, ("launcher", "joblib")]
# What submitit asks of every kind of cluster; all else it asks of SLURM alone.
_OF_ALL = ("name", "timeout_min", "mem_gb", "nodes", "cpus_per_task", "gpus_per_node")
_OF_ALL += ("tasks_per_node", "stderr_to_stdout")
_ARRAY = 1000  # jobs that SLURM takes in one array, unless MaxArraySize says otherwise
_POLL_SECONDS = 0.5
_LAST_SECONDS = 60.0  # for what has been told to stop
_PREEMPTED_SECONDS = 600.0  # between SIGTERM and what SLURM does then

Stop = Callable[[], bool]
Do = Callable[[Job, Stop | None], Outcome]


class Launcher(Protocol):
    quiet: bool  # jobs run side by side: one terminal cannot show how each goes on

    def threads(self, jobs: int) -> int | None:
        """Of each of so many jobs, where threads=0 leaves them open; None: all cores."""

    def launch(self, do: Do, jobs: list[Job], stop: Stop) -> Iterator[Outcome | Exception]:
        """Does all jobs and yields what became of each, in their order; an exception where its
        process was lost. ``stop``: whether Ctrl-C came, after which none may begin."""


def prepare(overrides: list[str]) -> None:
    """Raises InputError for an extra that is not installed, and lets our configurations stand for
    those that Hydra's plugins of the same names would bring, where somebody has these."""
    Plugins.instance()  # finds the plugins, which register their configurations then
    registered = ConfigStore.instance().repo.get("hydra", {})
    for group, name in _OURS:
        # Hydra would take it for the schema of ours, and warn that it no longer should.
        registered.get(group, {}).pop(f"{name}.yaml", None)
    for (group, name), needed in _EXTRAS.items():
        if f"hydra/{group}={name}" in overrides:
            check_installed(f"hydra/{group}={name}", *needed)


def check_installed(chosen: str, package: str, bringing: str) -> None:
    if not _installed(package):
        raise InputError(f"{chosen} is an extra: {extra(bringing)}")


def _installed(package: str) -> bool:
    return importlib.util.find_spec(package) is not None


def launcher(hydra: DictConfig) -> Launcher:
    """The launcher that was chosen, with its settings, which tell which one it is: a file of one's
    own may have another name. Raises InputError for one that is none of these."""
    chosen = f"hydra/launcher={hydra.runtime.choices['hydra/launcher']}"
    settings = OmegaConf.to_container(hydra.launcher, resolve=True)
    if "ray" in settings:
        check_installed(chosen, *_EXTRAS["launcher", "ray"])
        return Ray(**settings["ray"])
    if {"cluster", "submitit_folder"} <= settings.keys():
        check_installed(chosen, *_EXTRAS["launcher", "submitit_slurm"])
        return Submitit(**settings)
    basic = settings.pop("_target_", "BasicLauncher").endswith("BasicLauncher")
    if not basic or settings.keys() - {"n_jobs"}:
        ours = ", ".join(["basic", *(name for group, name in _OURS if group == "launcher")])
        raise InputError(f"{chosen}: none of isas's: take one, or have it in its defaults: {ours}")
    return Here(settings.get("n_jobs", 1))


class Here:
    """This machine: jobs in turn, or ``n_jobs`` side by side. Each has a process of its own:
    threads are enough to wait for them."""

    def __init__(self, n_jobs: int):
        if not isinstance(n_jobs, int) or n_jobs == 0:
            raise InputError(f"hydra.launcher.n_jobs={n_jobs}: give a number of jobs, or -1")
        self.n_jobs, self.quiet = n_jobs, n_jobs != 1

    def threads(self, jobs: int) -> int | None:
        import joblib

        if not self.quiet:
            return None
        workers = min(joblib.effective_n_jobs(self.n_jobs), max(jobs, 1))
        return max(1, joblib.cpu_count() // workers)

    def launch(self, do: Do, jobs: list[Job], stop: Stop) -> Iterator[Outcome | Exception]:
        import joblib

        do_one = joblib.delayed(lambda job: _result(lambda: do(job, stop)))
        side_by_side = joblib.Parallel(self.n_jobs, backend="threading", return_as="generator")
        yield from side_by_side(do_one(job) for job in jobs)


class Submitit:
    """SLURM, or (``local``) as if there were one, by submitit: all jobs begin as soon as they can.

    A job that meets its time limit or is preempted is queued again and goes on from its checkpoint.
    """

    quiet = True

    def __init__(
        self, cluster: str, submitit_folder: str, max_num_timeout: int = 0, **parameters: Any
    ):
        self.cluster, self.folder, self.most = cluster, submitit_folder, max_num_timeout
        known = {name: value for name, value in parameters.items() if value is not None}
        self.parameters = {n if n in _OF_ALL else f"slurm_{n}": v for n, v in known.items()}

    def threads(self, jobs: int) -> int | None:
        return self.parameters.get("cpus_per_task")

    def launch(self, do: Do, jobs: list[Job], stop: Stop) -> Iterator[Outcome | Exception]:
        import submitit

        most = {"slurm_max_num_timeout": self.most} if self.cluster == "slurm" else {}
        arrays, at_once = max(1, -(-len(jobs) // _ARRAY)), "slurm_array_parallelism"
        size = max(1, -(-len(jobs) // arrays))  # of each alike, or the last leaves others waiting
        asked, submitted = dict(self.parameters), []
        if at_once in asked:  # of all arrays together
            asked[at_once] = max(1, asked[at_once] // arrays)
        try:
            executor = submitit.AutoExecutor(self.folder, cluster=self.cluster, **most)
            executor.update_parameters(**asked)
            resumed = _Resumed(do, self.cluster == "slurm")
            for begin in range(0, len(jobs), size):
                submitted += executor.map_array(resumed, jobs[begin : begin + size])
        except Exception as error:
            for other in submitted:
                other.cancel(check=False)
            raise _refused("submitit", error) from error
        for job in submitted:
            while not job.done():
                if stop():  # what waits in a queue would begin after all
                    for other in submitted:
                        other.cancel(check=False)
                    return
                time.sleep(_POLL_SECONDS)
            yield _result(job.result)


class _Resumed:
    """What submitit calls for each job, and asks for what is to be queued again."""

    def __init__(self, do: Do, preemptable: bool):
        self.do, self.preemptable = do, preemptable

    def __call__(self, job: Job) -> Outcome:
        found = self.do(job, None)
        if self.preemptable and found.code == interrupt.STATUS:
            # SIGTERM comes first: with a result submitit would take the job for done before it is
            # queued again. After scancel it is killed here.
            time.sleep(_PREEMPTED_SECONDS)
        return found

    def checkpoint(self, job: Job):
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self, job)


class Ray:
    """A Ray cluster, or this machine as one. init, remote: arguments of ray.init, ray.remote."""

    quiet = True

    def __init__(self, init: dict[str, Any], remote: dict[str, Any]):
        self.init, self.remote = init, remote

    def threads(self, jobs: int) -> int | None:
        return max(1, int(self.remote.get("num_cpus") or 1))

    def launch(self, do: Do, jobs: list[Job], stop: Stop) -> Iterator[Outcome | Exception]:
        # It would take the lines of different jobs for repetitions of one.
        os.environ.setdefault("RAY_DEDUP_LOGS", "0")
        import ray

        try:
            if not ray.is_initialized():
                ray.init(**self.init)
            done = ray.remote(**self.remote)(_remotely)
            submitted = [done.remote(do, job) for job in jobs]
        except Exception as error:
            raise _refused("Ray", error) from error
        for reference in submitted:
            while not ray.wait([reference], timeout=_POLL_SECONDS)[0]:
                if stop():
                    for other in submitted:
                        ray.cancel(other)
                    # They finish their records, and end with Ray.
                    ray.wait(submitted, num_returns=len(submitted), timeout=_LAST_SECONDS)
                    return
            yield _result(lambda: ray.get(reference))


def _remotely(do: Do, job: Job) -> Outcome:
    return do(job, None)


def _result(get: Callable[[], Outcome]) -> Outcome | Exception:
    try:
        return get()
    except Exception as error:  # the process that did the job was lost
        return error


def _refused(name: str, error: Exception) -> InputError:
    text = " ".join(str(error).split()) or type(error).__name__
    return InputError(f"{name} cannot launch the jobs: {text}")
