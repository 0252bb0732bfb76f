"""`isas run`: compose, check, and hand over to Hydra, which calls the run itself."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from omegaconf import DictConfig

from .. import config
from ..compose import compose, translate
from ..errors import InputError, IsasError


def main(arguments: list[str]) -> int:
    """Run one configuration. Raises IsasError; returns the exit status otherwise."""
    import hydra

    config.register()
    arguments = translate(arguments)
    # With a flag of Hydra's (--cfg job, …) the call may mean something else: left to Hydra.
    if not any(a.startswith("-") for a in arguments):
        cfg = compose(arguments, hydra=True)
        _check_folder(Path(cfg.hydra.run.dir), cfg.overwrite)

    outcome: dict = {"status": 0}

    def task(job: DictConfig) -> None:
        # Hydra would print a traceback and exit with 1: keep the error and raise it outside.
        try:
            outcome["status"] = _run(job)
        except (IsasError, KeyboardInterrupt, Exception) as error:
            outcome["error"] = error

    saved = sys.argv
    sys.argv = ["isas run", *arguments]
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")
    try:
        hydra.main(version_base="1.3", config_path=config.folder(), config_name="config")(task)()
    finally:
        sys.argv = saved
    if "error" in outcome:
        raise outcome["error"]
    return outcome["status"]


def _run(job: DictConfig) -> int:
    from hydra.core.hydra_config import HydraConfig

    from ..experiment import run

    return run(job, Path(HydraConfig.get().runtime.output_dir))


def _check_folder(folder: Path, overwrite: bool) -> None:
    """Refuse an unusable output folder before Hydra makes it and before anything is computed."""
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir() or not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(
            f"cannot write to the output folder {folder}: {existing} is not a writable folder; "
            "choose another with hydra.run.dir=DIR"
        )
    if (folder / "manifest.json").exists() and not overwrite:
        raise InputError(
            f"{folder} already holds a run: choose another folder with hydra.run.dir=DIR, "
            "or replace it with overwrite=true"
        )
