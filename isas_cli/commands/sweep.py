"""Sweeps, and the flags that only print something: left to Hydra."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator

from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from .. import config, interrupt
from ..compose import explain
from ..errors import InputError, IsasError
from . import one


def by_hydra(flags: list[str], overrides: list[str]) -> int:
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
            status = one.run(job, folder)
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
    with one.argv(["isas run", *overrides, *flags]), _errors_raised():
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
