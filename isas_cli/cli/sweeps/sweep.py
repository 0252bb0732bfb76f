"""Sweeps, and the flags that only print something: left to Hydra."""

from __future__ import annotations

import contextlib
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import hydra
from hydra._internal.utils import get_args_parser
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from ...config import schema
from ...config.compose import explain
from ...runtime.errors import InputError, nearest
from .. import one
from . import fingerprint, launchers, outcome
from .launch import Sweep, Task


def by_hydra(flags: list[str], overrides: list[str]) -> int:
    """Leave a sweep, or a flag that prints something, to Hydra. Returns the exit status.

    A sweep's job that fails is recorded in its folder, and the others go on; the status is then
    the first failure's. What is done already is skipped, what was interrupted goes on from its
    checkpoint. Ctrl-C ends the sweep. Raises InputError for a sweep that cannot be begun.
    """
    schema.register()
    fingerprint.register()
    launchers.prepare(overrides)
    if get_args_parser().parse_args(flags).multirun:
        return _sweep(flags, overrides)
    return _other(flags, overrides)


def _sweep(flags: list[str], overrides: list[str]) -> int:
    for override in overrides:
        if override.startswith("hydra.run.dir="):
            raise InputError("hydra.run.dir is for single runs: give hydra.sweep.dir=DIR")
    task = Task(sys.argv)
    sweep = Sweep(task, overrides)
    try:
        with sweep.attached():
            _enter(task, flags, overrides)
    except InputError as error:
        # A search all of whose trials failed has no best one: the table says why they did.
        if not isinstance(error.__cause__, ValueError) or not sweep.failed:
            raise
    finally:
        sweep.tidy()
        if sweep.begun:
            outcome.show(sweep.outcomes)
            sweep.show_best()
    return outcome.exit_status(sweep.outcomes)


def _other(flags: list[str], overrides: list[str]) -> int:
    """Flags that print something; or --run."""
    ends: list[int | Exception] = []

    def run(cfg: DictConfig) -> None:
        folder = HydraConfig.get().runtime.output_dir
        try:
            ends.append(one.run(cfg, folder))
        except Exception as error:  # Hydra would add lines of its own, or take it for its own
            ends.append(error)
            one.remove_empty(Path(folder))

    status = _enter(run, flags, overrides)
    for end in ends:
        if isinstance(end, Exception):
            raise end
        status = end
    return status


def _enter(task: Callable, flags: list[str], overrides: list[str]) -> int:
    """Hydra's own entry, with its errors as ours."""
    main = hydra.main(version_base="1.3", config_path=schema.folder(), config_name="config")
    with one.argv(["isas run", *overrides, *flags]), _errors_raised():
        try:
            main(task)()
        except (HydraException, OmegaConfBaseException) as error:
            raise InputError(_explained(error, overrides)) from error
        except OSError as error:
            raise InputError(f"cannot write to the sweep's folder: {error}") from error
        except ValueError as error:  # flags that exclude each other
            raise InputError(str(error)) from error
        except SystemExit as ended:  # after --hydra-help and its like
            return int(ended.code or 0)
    return 0


def _explained(error: Exception, overrides: list[str]) -> str:
    """``compose.explain``, which does not know Hydra's own groups."""
    text = str(error)
    unknown = re.search(r"Could not override '(hydra\.[^']+)'", text)
    if unknown:
        return f"{unknown.group(1)}: no such setting; isas run … --cfg hydra prints them"
    missing = re.search(r"Could not find '(hydra/\S+)/([^'/]+)'", text)
    if not missing:
        return explain(error, overrides)
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
