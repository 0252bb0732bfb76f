"""`isas run`: one configuration here; sweeps, and the flags that only print, elsewhere."""

from __future__ import annotations

import os
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import open_dict

from ..config.compose import compose, translate
from ..runtime import backend, interrupt
from ..runtime.errors import InputError
from . import one
from .sweeps import sweep


def main(arguments: list[str]) -> int:
    """Run what ``arguments`` (as typed) say. Raises IsasError; else returns the exit status."""
    flags, typed = _split(arguments)
    continued = [o for o in typed if o.startswith("resume=")]
    if continued:
        if flags or len(continued) > 1:
            raise InputError("resume=DIR goes on with one run: give no flags and one folder")
        return _resume(arguments, continued[0], [o for o in typed if o not in continued])
    overrides = translate(typed)
    # So that the record's command line is the one typed, however this was called.
    with one.argv(["isas", "run", *arguments]), interrupt.prompt():
        if flags:
            return sweep.by_hydra(flags, overrides)
        cfg = compose(overrides, hydra=True)
        if cfg.hydra.mode == RunMode.MULTIRUN:
            return sweep.by_hydra(["--multirun"], overrides)
        one.no_sweep(typed, "add -m")
        return _one(cfg)[0]


def folder_of(settings: list[str]) -> str:
    """Run one configuration, given as typed, or go on with one (``resume=DIR``); returns the folder
    of its record. Raises IsasError."""
    continued = [each for each in settings if each.startswith("resume=")]
    if len(continued) == 1:
        with backend.lent():
            _resume(settings, continued[0], [each for each in settings if each not in continued])
        return os.path.expanduser(continued[0].partition("=")[2].strip("\"'"))
    if flags := [each for each in settings if each.startswith("-")]:
        raise InputError(f"{flags[0]}: a program makes one run at a time, of settings alone")
    with one.argv(["isas", "run", *settings]), interrupt.prompt(), backend.lent():
        cfg = compose(translate(settings), hydra=True)
        return _one(cfg)[1]


def _one(cfg) -> tuple[int, str]:
    """Exit status and folder of a run whose configuration has Hydra's own settings still."""
    before = HydraConfig.instance().cfg  # of a program that uses Hydra itself
    try:
        HydraConfig.instance().set_config(cfg)
        folder = cfg.hydra.run.dir
        with open_dict(cfg):
            del cfg["hydra"]
        return one.run(cfg, folder), folder
    finally:
        HydraConfig.instance().cfg = before


def _resume(arguments: list[str], wanted: str, overrides: list[str]) -> int:
    from ..engine import experiment, resumption

    folder = wanted.partition("=")[2].strip("\"'")
    if not folder:
        raise InputError("resume is empty: give resume=DIR, a run's folder")
    changes = resumption.parse(overrides)
    place = Path(os.path.expanduser(folder))
    if place.is_dir():
        one.check_writable(place, "a run goes on where it is: copy it")
    with one.argv(["isas", "run", *arguments]), interrupt.prompt():
        return experiment.resume(place, changes)


def _split(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Hydra's flags and the overrides among them. Raises InputError for flags that Hydra lacks, and
    for others beside -m."""
    from hydra._internal.utils import get_args_parser

    parser = get_args_parser()

    def refuse(message: str) -> None:
        raise InputError(f"{message}; see isas run --help")

    parser.error, parser.allow_abbrev = refuse, False
    given = parser.parse_intermixed_args(arguments)
    overrides = given.overrides
    remaining = list(overrides)
    flags = []
    for argument in arguments:
        if argument in remaining:
            remaining.remove(argument)
        else:
            flags.append(argument)
    others = [flag for flag in flags if flag not in sweep.MULTIRUN]
    if given.multirun and others:
        raise InputError(f"{others[0]}: not beside -m: leave one of them out")
    return flags, overrides
