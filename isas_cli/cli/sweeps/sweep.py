"""Sweeps, and the flags that only print something, which are left to Hydra.

Hydra reads what was typed and composes each job's configuration; a launcher does the jobs.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import time
from collections.abc import Iterator
from pathlib import Path

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, open_dict
from omegaconf.errors import OmegaConfBaseException

from ...config import dropped, schema
from ...config.compose import complete, compose, explain, initialized, named
from ...runtime import interrupt
from ...runtime.errors import InputError, nearest
from .. import one
from . import fingerprint, launchers, outcome
from .launch import Sweep, planned, say
from .outcome import Outcome, shown
from .search import search, setting

MULTIRUN = {"-m", "--multirun"}
_TOLD_SECONDS = 5.0  # between lines while many jobs are composed


def by_hydra(flags: list[str], overrides: list[str]) -> int:
    """A sweep, or a flag that prints something. Returns the exit status.

    A sweep's job that fails is recorded in its folder, and the others go on; the status is then
    the first failure's. What is done already is skipped, what was interrupted goes on from its
    checkpoint. Ctrl-C ends the sweep. Raises InputError for a sweep that cannot be begun.
    """
    schema.register()
    fingerprint.register()
    launchers.prepare(overrides)
    return _sweep(overrides) if set(flags) <= MULTIRUN else _other(flags, overrides)


def _sweep(typed: list[str]) -> int:
    for override in typed:
        if override.startswith("hydra.run.dir="):
            raise InputError("hydra.run.dir is for single runs: give hydra.sweep.dir=DIR")
    with explained(typed):
        settings = compose([_first(o) for o in parsed(typed)], hydra=True).hydra
        params = settings.sweeper.get("params") or {}
        listed = [f"{name}={value}" for name, value in params.items()]
        overrides = _last(parsed([*listed, *typed]))
    sweeper = f"hydra/sweeper={settings.runtime.choices['hydra/sweeper']}"
    # A file of one's own may have another name.
    searching = "n_trials" in settings.sweeper
    if searching:
        launchers.check_installed(sweeper, "optuna", "optuna")
    elif not settings.sweeper.get("_target_", "BasicSweeper").endswith("BasicSweeper"):
        raise InputError(f"{sweeper}: none of isas's: take basic or optuna, or have it in defaults")
    with interrupt.graceful() as stop:
        sweep = Sweep(launchers.launcher(settings), stop)

        def launch(combinations: list[list[str]]) -> list[Outcome]:
            with explained(typed):
                jobs, told = [], time.monotonic()
                for number, own in enumerate(combinations, len(sweep.jobs)):
                    if stop() and not searching:  # which has something to write yet
                        raise KeyboardInterrupt
                    if time.monotonic() - told > _TOLD_SECONDS:
                        say(f"{len(jobs)} of {len(combinations)} jobs composed")
                        told = time.monotonic()
                    jobs.append(planned(own, _label(own, typed), number))
            return sweep.launch(jobs)

        try:
            if searching:
                spaces = [o for o in overrides if o.is_sweep_override()]
                fixed = [o.input_line for o in overrides if not o.is_sweep_override()]
                search(
                    settings.sweeper,
                    spaces,
                    lambda own: launch([[*fixed, *each] for each in own]),
                    stop,
                )
            else:
                launch(_combinations(overrides))
            if stop():
                raise KeyboardInterrupt
        finally:
            if sweep.jobs:
                outcome.show(sweep.outcomes)
                if searching:
                    _show_best(sweep.outcomes, settings.sweeper.direction)
    return outcome.exit_status(sweep.outcomes)


def parsed(overrides: list[str]) -> list[Override]:
    with initialized():
        parser = OverridesParser.create(GlobalHydra.instance().config_loader())
        return parser.parse_overrides(overrides)


def _last(overrides: list[Override]) -> list[Override]:
    """The last word on each setting, and all words on those that hold names of their own."""
    found = {}
    for number, override in enumerate(overrides):
        setting = override.get_key_element()
        several = setting.lstrip("+~") in dropped.SETTINGS
        found[(setting, number if several else 0)] = override
    return list(found.values())


def _first(override: Override) -> str:
    """One value of a setting that has several."""
    if not override.is_sweep_override():
        return override.input_line
    discrete = override.is_discrete_sweep()
    value = next(override.sweep_string_iterator()) if discrete else override.value().start
    return setting(override, value)


def _combinations(overrides: list[Override]) -> list[list[str]]:
    """The settings of each job: every value with every other."""
    return [list(chosen) for chosen in itertools.product(*map(choices, overrides))]


def choices(override: Override) -> list[str]:
    """The settings that it stands for, one for each value. Raises InputError for an interval."""
    if not override.is_sweep_override():
        return [override.input_line]
    if not override.is_discrete_sweep():
        raise InputError(f"{override.input_line}: for a search: isas run -m hydra/sweeper=optuna")
    return [f"{override.get_key_element()}={each}" for each in override.sweep_string_iterator()]


def _label(overrides: list[str], typed: list[str]) -> str:
    """What tells a job from the others."""
    own = [o for o in overrides if o not in typed and not o.startswith("hydra")]
    return " ".join(own or overrides)


def _show_best(outcomes: list[Outcome], direction: str) -> None:
    found = [o for o in outcomes if o.value is not None]
    if found:
        best = {"minimize": min, "maximize": max}[direction](found, key=lambda o: o.value)
        say(f"best: {best.label}: {best.value:.4g}: {shown(best.folder)}")


def _other(flags: list[str], overrides: list[str]) -> int:
    """Flags that print something; or --run."""
    ends: list[int | Exception] = []

    def run(cfg: DictConfig) -> None:
        folder = HydraConfig.get().runtime.output_dir
        try:
            with open_dict(cfg):
                named(cfg, HydraConfig.get().runtime.choices)
            ends.append(one.run(dropped.settled(cfg), folder))
        except Exception as error:  # Hydra would add lines of its own, or take it for its own
            ends.append(error)
            one.remove_empty(Path(folder))

    main = hydra.main(version_base="1.3", config_path=schema.folder(), config_name="config")
    overrides = complete(overrides)
    with one.argv(["isas run", *overrides, *flags]), _errors_raised(), explained(overrides):
        try:
            main(run)()
        except BrokenPipeError:  # whoever reads what is printed has gone
            raise
        except OSError as error:
            raise InputError(f"cannot write to the run's folder: {error}") from error
        except ValueError as error:  # flags that exclude each other
            raise InputError(str(error)) from error
        except SystemExit as ended:  # after --hydra-help and its like
            return int(ended.code or 0)
    for end in ends:
        if isinstance(end, Exception):
            raise end
    return max(ends, default=0)


@contextlib.contextmanager
def explained(overrides: list[str]) -> Iterator[None]:
    """What Hydra refuses within the context becomes one line; ``compose.explain`` does not know
    Hydra's own groups."""
    try:
        yield
    except (HydraException, OmegaConfBaseException) as error:
        raise InputError(_of_hydra(error) or explain(error, overrides)) from error
    except InputError as error:
        text = _of_hydra(error.__cause__)
        if text:
            raise InputError(text) from error
        raise


def _of_hydra(error: BaseException | None) -> str | None:
    """One line for an error about Hydra's own settings; None for others."""
    text = str(error)
    unknown = re.search(r"Could not override '(hydra\.[^']+)'", text)
    if unknown:
        return f"{unknown.group(1)}: no such setting; isas run … --cfg hydra prints them"
    missing = re.search(r"Could not find '(hydra/\S+)/([^'/]+)'", text)
    if not missing:
        return None
    group, name = missing.groups()
    valid = re.findall(r"^\t(\S+)$", text, re.MULTILINE)
    return f"{group}={name}: no such {group}; {nearest(name, valid)}"


@contextlib.contextmanager
def _errors_raised() -> Iterator[None]:
    """Hydra raises its errors instead of printing them and exiting."""
    name = "HYDRA_FULL_ERROR"
    saved = os.environ.get(name)
    os.environ[name] = "1"
    try:
        yield
    finally:
        if saved is None:
            del os.environ[name]
        else:
            os.environ[name] = saved
