"""What isas knows of the single launchers and sweepers of Hydra's."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import time
import types
from collections.abc import Iterator

from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from hydra.plugins.launcher import Launcher
from omegaconf import DictConfig

from ...runtime.errors import InputError

# Configured in configs/hydra, but brought by an extra: package of the plugin, name of the extra.
_EXTRAS = {
    ("launcher", "ray"): ("hydra_ray_launcher", "ray"),
    ("launcher", "submitit_local"): ("hydra_submitit_launcher", "slurm"),
    ("launcher", "submitit_slurm"): ("hydra_submitit_launcher", "slurm"),
    ("sweeper", "optuna"): ("hydra_optuna_sweeper", "optuna"),
}

_NOTICE_SECONDS = 2.0  # in which local jobs, which get the terminal's Ctrl-C as well, end by it


def prepare(overrides: list[str]) -> None:
    """Let our configurations of launchers and sweepers stand for those that the plugins bring
    under the same names. Raises InputError for one whose extra is not installed."""
    Plugins.instance()  # finds the plugins, which register their configurations then
    registered = ConfigStore.instance().repo.get("hydra", {})
    for (group, name), (package, extra) in _EXTRAS.items():
        # Hydra would otherwise take it for the schema of ours, and warn that it no longer should.
        registered.get(group, {}).pop(f"{name}.yaml", None)
        if f"hydra/{group}={name}" in overrides:
            if not _installed(package):
                install = f"pip install '.[{extra}]' in isas's source folder"
                raise InputError(f"hydra/{group}={name} is an extra: {install}")
            _quieten(extra)


def _quieten(extra: str) -> None:
    """Keep the libraries' own chatter from between the jobs' lines."""
    if extra == "ray":
        # It would take the lines of different jobs for repetitions of one.
        os.environ.setdefault("RAY_DEDUP_LOGS", "0")
    elif extra == "optuna":
        import optuna

        optuna.logging.set_verbosity(optuna.logging.WARNING)


def _installed(package: str) -> bool:
    try:
        return importlib.util.find_spec(f"hydra_plugins.{package}") is not None
    except ModuleNotFoundError:
        return False


def parallel(launcher: DictConfig) -> bool:
    """Whether jobs run side by side, so that their progress cannot be shown in one terminal."""
    return not launcher._target_.endswith(".BasicLauncher")


def threads(launcher: DictConfig, jobs: int) -> int | None:
    """Threads for each job where threads=0 leaves them open: its share of the machine's cores, or
    what was asked of the cluster; None for all cores."""
    if "n_jobs" in launcher:  # joblib
        import joblib

        workers = min(joblib.effective_n_jobs(launcher.n_jobs), max(jobs, 1))
        return max(1, joblib.cpu_count() // workers)
    if "cpus_per_task" in launcher:  # submitit
        return launcher.cpus_per_task
    if "ray" in launcher:
        return max(1, int(launcher.ray.remote.get("num_cpus") or 1))
    return None


@contextlib.contextmanager
def patient(launcher: Launcher) -> Iterator[None]:
    """Within the context a launcher waits for all jobs, and gives back an exception in place of
    the result of one whose worker was lost; submitit's and Ray's raise the first and drop the
    rest. joblib's cannot: a lost worker takes the others with it, and BrokenExecutor says so."""
    name = type(launcher).__module__
    if "hydra_submitit_launcher" in name:
        with _patient_submitit():
            yield
    elif "hydra_ray_launcher" in name:
        with _patient_ray():
            yield
    else:
        yield


@contextlib.contextmanager
def _patient_submitit() -> Iterator[None]:
    import submitit

    submitted = []

    class Patient(submitit.AutoExecutor):
        def map_array(self, *arguments):
            submitted.extend(super().map_array(*arguments))
            return [
                types.SimpleNamespace(results=lambda job=job: _results(job)) for job in submitted
            ]

    original, submitit.AutoExecutor = submitit.AutoExecutor, Patient
    try:
        yield
    except BaseException:  # Ctrl-C: what waits in a queue would begin after all
        time.sleep(_NOTICE_SECONDS)
        for job in submitted:
            if not job.done(force_check=True):
                job.cancel(check=False)
        raise
    finally:
        submitit.AutoExecutor = original


def _results(job) -> list:
    try:
        return job.results()
    except Exception as error:
        return [error]


@contextlib.contextmanager
def _patient_ray() -> Iterator[None]:
    import ray
    from hydra_plugins.hydra_ray_launcher import _core

    def get(reference):
        try:
            return ray.get(reference)
        except Exception as error:
            return error

    _core.ray = types.SimpleNamespace(get=get)
    try:
        yield
    finally:
        _core.ray = ray
