"""`isas run`: one configuration here; sweeps, and the flags that only print, through Hydra."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, open_dict
from omegaconf.errors import OmegaConfBaseException

from .. import config, interrupt
from ..compose import compose, explain, translate
from ..errors import InputError, IsasError


def main(arguments: list[str]) -> int:
    """Run what ``arguments`` (as typed) say. Raises IsasError; else returns the exit status."""
    flags, overrides = _split(arguments)
    overrides = translate(overrides)
    # So that the record's command line is the one typed, however this was called.
    with _argv(["isas", "run", *arguments]), interrupt.prompt():
        if flags:
            return _by_hydra(flags, overrides)
        cfg = compose(overrides, hydra=True)
        if cfg.hydra.mode == RunMode.MULTIRUN:
            return _by_hydra(["--multirun"], overrides)
        HydraConfig.instance().set_config(cfg)
        folder = cfg.hydra.run.dir
        with open_dict(cfg):
            del cfg["hydra"]
        return _run(cfg, folder)


def _split(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Hydra's flags and the overrides among them. Raises InputError for flags that Hydra lacks."""
    from hydra._internal.utils import get_args_parser

    parser = get_args_parser()

    def refuse(message: str) -> None:
        raise InputError(f"{message}; see isas run --help")

    parser.error = refuse
    overrides = parser.parse_intermixed_args(arguments).overrides
    remaining = list(overrides)
    flags = []
    for argument in arguments:
        if argument in remaining:
            remaining.remove(argument)
        else:
            flags.append(argument)
    return flags, overrides


@contextlib.contextmanager
def _argv(arguments: list[str]) -> Iterator[None]:
    saved, sys.argv = sys.argv, arguments
    try:
        yield
    finally:
        sys.argv = saved


def _run(cfg: DictConfig, name: str) -> int:
    if not name:
        raise InputError("hydra.run.dir is empty: give hydra.run.dir=DIR")
    folder = Path(name)
    _check_folder(folder, cfg.overwrite)

    from ..experiment import run

    return run(cfg, folder)


def _check_folder(folder: Path, overwrite: bool) -> None:
    """Refuse an unusable output folder before anything is computed, and leave nothing there."""
    existing = folder.absolute()
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    try:
        tempfile.TemporaryFile(dir=existing).close()
    except OSError as error:
        raise InputError(
            f"cannot write to the output folder {folder}: {existing}: "
            f"{error.strerror or error}; choose another with hydra.run.dir=DIR"
        ) from error
    if (folder / "manifest.json").exists() and not overwrite:
        raise InputError(
            f"{folder} already holds a run: choose another folder with hydra.run.dir=DIR, "
            "or replace it with overwrite=true"
        )


def _by_hydra(flags: list[str], overrides: list[str]) -> int:
    """Leave a sweep, or a flag that prints something, to Hydra.

    A job of a sweep that fails has its line on stderr and the others go on; the status is then
    the first failure's. Ctrl-C ends the sweep.
    """
    import hydra

    config.register()
    failures: list[int] = []

    def task(job: DictConfig) -> None:
        settings = HydraConfig.get()
        folder = settings.runtime.output_dir
        try:
            status = _run(job, folder)
        except IsasError as error:
            status = error.status
            label = " ".join(settings.overrides.task)
            print(f"isas: {label}: {error}", file=sys.stderr)
        if status == interrupt.STATUS:
            raise KeyboardInterrupt
        if status:
            failures.append(status)
            with contextlib.suppress(OSError):  # Hydra made it; what holds anything stays
                os.removedirs(folder)

    entry = hydra.main(version_base="1.3", config_path=config.folder(), config_name="config")(task)
    with _argv(["isas run", *overrides, *flags]), _errors_raised():
        try:
            entry()
        except (HydraException, OmegaConfBaseException) as error:
            raise InputError(explain(error, overrides)) from error
        except OSError as error:
            raise InputError(f"cannot write to the sweep's folder: {error}") from error
        except ValueError as error:  # flags that exclude each other
            raise InputError(str(error)) from error
        except SystemExit as ended:  # after --hydra-help and its like
            return int(ended.code or 0)
    return failures[0] if failures else 0


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
