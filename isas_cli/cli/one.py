"""One run: what single runs and the jobs of sweeps have in common."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from omegaconf import DictConfig

from ..config import searchpath
from ..records.writer import RECORD_FILES
from ..runtime.errors import InputError

_OF_SWEEPS = ("hydra/launcher", "hydra/sweeper", "hydra.launcher", "hydra.sweeper", "hydra.sweep")


@contextlib.contextmanager
def argv(arguments: list[str]) -> Iterator[None]:
    # What the record says can be typed again; what Hydra is to read has its own order.
    places = searchpath.words() if arguments[0] == "isas" else []
    more = [each for each in places if each not in arguments]
    saved, sys.argv = sys.argv, [*arguments, *more]
    try:
        yield
    finally:
        sys.argv = saved


def no_flags(command: str, arguments: list[str], but: tuple[str, ...] = ()) -> None:
    """Raises InputError for an argument that is a flag, of those ``but`` some."""
    for argument in arguments:
        if argument.startswith("-") and argument not in but:
            raise InputError(f"{argument}: no such flag; see isas {command} --help")


def no_sweep(arguments: list[str], instead: str) -> None:
    """Raises InputError for an argument that is of several runs; ``instead``: what to do."""
    for argument in arguments:
        if argument.lstrip("+~").startswith(_OF_SWEEPS):
            raise InputError(f"{argument}: is for several runs: {instead}")


def run(cfg: DictConfig, name: str) -> int:
    if not name:
        raise InputError("hydra.run.dir is empty: give hydra.run.dir=DIR")
    folder = Path(name)
    check_folder(folder, cfg.overwrite)

    from ..engine import experiment

    return experiment.run(cfg, folder)


def check_folder(folder: Path, overwrite: bool) -> None:
    """Refuse an unusable output folder before anything is computed, and leave nothing there."""
    check_writable(folder, f"choose another than {folder} with hydra.run.dir=DIR")
    if any((folder / name).exists() for name in RECORD_FILES) and not overwrite:
        raise InputError(
            f"{folder} already holds a run: choose another folder with hydra.run.dir=DIR, "
            "or replace it with overwrite=true"
        )


def check_writable(folder: Path, cure: str) -> None:
    """Raises InputError where nothing can be written into ``folder``, or what there is above it,
    and says the ``cure``."""
    while not folder.exists():
        folder = folder.absolute().parent
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        told = error.strerror or error
        raise InputError(f"cannot write to the output folder {folder}: {told}; {cure}") from error


def remove_empty(folder: Path) -> None:
    """Remove a folder that is empty, and those above it that are, up to the present one."""
    folder = Path(os.path.abspath(folder))
    here = Path.cwd()
    with contextlib.suppress(OSError):
        folder.rmdir()
        for parent in folder.parents:
            if here not in parent.parents:
                break
            parent.rmdir()
