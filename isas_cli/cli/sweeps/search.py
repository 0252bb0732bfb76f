"""hydra/sweeper=optuna: the settings with the least final error, searched for by Optuna."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import yaml
from hydra.core.override_parser.types import IntervalSweep, Override
from omegaconf import DictConfig

from ...config.compose import translate
from ...engine.display import say
from ...records import files
from ...runtime.errors import InputError
from .outcome import Outcome

_RESULT = "optimization_results.yaml"
# Before a KEY that has dots, which Hydra takes for levels.
_KEYED = "scene.unknowns.", "scene.poses."


def search(
    settings: DictConfig,
    spaces: list[Override],
    launch: Callable[[list[list[str]]], list[Outcome]],
    stop: Callable[[], bool],
) -> None:
    """As many trials as ``settings`` say, each a job; a failed job is a failed trial.

    spaces: what is searched. launch: does the jobs of these settings and says how they ended. stop:
    whether Ctrl-C came, after which nothing more is tried. What was found goes into
    optimization_results.yaml beside the jobs. Trials that a storage keeps from an earlier start
    count; those that were not done go first. Raises InputError for settings that cannot be.
    """
    import optuna

    for name in ("n_trials", "n_jobs"):
        if not isinstance(settings[name], int) or settings[name] < 1:
            raise InputError(f"hydra.sweeper.{name}={settings[name]}: give a number, at least 1")
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    states = optuna.trial.TrialState
    with _explained():
        study = optuna.create_study(
            study_name=settings.study_name,
            storage=settings.storage,
            direction=settings.direction,
            load_if_exists=True,
        )
        earlier, seed = study.trials, settings.sampler.seed
        # Its first proposals were made by an earlier start.
        seed = None if seed is None else seed + len(earlier)
        study.sampler = optuna.samplers.TPESampler(seed=seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Optuna 2 calls it experimental
            done = sum(trial.state == states.COMPLETE for trial in earlier)
            for params in _undone(earlier) if done < settings.n_trials else ():
                study.enqueue_trial(params)
    if done:
        say(f"{done} of {settings.n_trials} trials were done by earlier starts")
    folders = []
    for begun in range(done, settings.n_trials, settings.n_jobs):
        if stop():
            break
        trials = [study.ask() for _ in range(min(settings.n_jobs, settings.n_trials - begun))]
        ended = launch([[_suggested(trial, space) for space in spaces] for trial in trials])
        for trial, job in zip(trials, ended):
            study.tell(trial, job.value, states.FAIL if job.value is None else states.COMPLETE)
            folders.append(job.folder.parent)
    if any(trial.value is not None for trial in study.trials):
        found = {"best_params": study.best_params, "best_value": study.best_value}
        if folders:
            files.write_text(Path(os.path.commonpath(folders)) / _RESULT, yaml.safe_dump(found))
        if any(t.number == study.best_trial.number and t.state == states.COMPLETE for t in earlier):
            best = " ".join(f"{name}={value}" for name, value in study.best_params.items())
            say(f"best, by an earlier start: {best}: {study.best_value:.4g}")


@contextlib.contextmanager
def _explained() -> Iterator[None]:
    """What Optuna or its storage refuses within the context becomes one line."""
    try:
        yield
    except Exception as error:  # each storage has its own kinds
        text = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"optuna: {text}") from error


def _undone(trials: list) -> Iterator[dict]:
    """What was tried and did not end well, or did not end: its folder has what it began."""
    known = [
        trial.params if trial.state.name == "COMPLETE" else trial.system_attrs["fixed_params"]
        for trial in trials
        if trial.state.name in ("COMPLETE", "WAITING")
    ]
    for trial in trials:
        if trial.params and trial.params not in known:
            known.append(trial.params)
            yield trial.params


def setting(space: Override, value) -> str:
    """What is searched, with one value."""
    name = space.get_key_element()
    made = f"{name}={value}"
    return translate([made])[0] if name.startswith(_KEYED) else made


def _suggested(trial, space: Override) -> str:
    """A setting with the value that the trial is to have."""
    name, values = space.get_key_element(), space.value()
    if isinstance(values, IntervalSweep):
        log = "log" in values.tags
        whole = isinstance(values.start, int) and isinstance(values.end, int)
        suggest = trial.suggest_int if whole else trial.suggest_float
        return setting(space, suggest(name, values.start, values.end, log=log))
    return setting(space, trial.suggest_categorical(name, list(space.sweep_string_iterator())))
