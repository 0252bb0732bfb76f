"""hydra/sweeper=optuna: the settings with the least final error, searched for by Optuna."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import yaml
from hydra.core.override_parser.types import IntervalSweep, Override
from omegaconf import DictConfig

from ...records import files
from .outcome import Outcome

_RESULT = "optimization_results.yaml"


def search(
    settings: DictConfig,
    spaces: list[Override],
    launch: Callable[[list[list[str]]], list[Outcome]],
    stop: Callable[[], bool],
) -> None:
    """As many trials as ``settings`` say, each a job; a failed job is a failed trial.

    spaces: what is searched. launch: does the jobs of these settings and says how they ended. stop:
    whether Ctrl-C came, after which nothing more is tried. What was found goes into
    optimization_results.yaml beside the jobs.
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(
        study_name=settings.study_name,
        storage=settings.storage,
        direction=settings.direction,
        sampler=optuna.samplers.TPESampler(seed=settings.sampler.seed),
        load_if_exists=True,
    )
    folders = []
    for begun in range(0, settings.n_trials, settings.n_jobs):
        if stop():
            break
        trials = [study.ask() for _ in range(min(settings.n_jobs, settings.n_trials - begun))]
        ended = launch([[_suggested(trial, space) for space in spaces] for trial in trials])
        for trial, job in zip(trials, ended):
            states = optuna.trial.TrialState
            study.tell(trial, job.value, states.FAIL if job.value is None else states.COMPLETE)
            folders.append(job.folder.parent)
    if any(trial.value is not None for trial in study.trials):
        found = {"best_params": study.best_params, "best_value": study.best_value}
        files.write_text(Path(os.path.commonpath(folders)) / _RESULT, yaml.safe_dump(found))


def _suggested(trial, space: Override) -> str:
    """A setting with the value that the trial is to have."""
    name, values = space.get_key_element(), space.value()
    if isinstance(values, IntervalSweep):
        log = "log" in values.tags
        whole = isinstance(values.start, int) and isinstance(values.end, int)
        suggest = trial.suggest_int if whole else trial.suggest_float
        return f"{name}={suggest(name, values.start, values.end, log=log)}"
    return f"{name}={trial.suggest_categorical(name, list(space.sweep_string_iterator()))}"
