"""Going on with a run that ended early: what must be the same, and what may change."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from . import manifest, records
from .budget import Budget
from .config import Config
from .errors import InputError

if TYPE_CHECKING:
    from .problem import Problem

# Everything else decides what is computed next; a run continued otherwise would be two runs.
_FREE = ("budget.seconds", "budget.iterations", "budget.paths", "threads", "tracker")


def parse(overrides: list[str]) -> dict:
    """``["budget.seconds=120"]`` → ``{"budget.seconds": 120}``. Raises InputError for a setting
    that a continuation cannot change."""
    changes = {}
    for text in overrides:
        try:
            override = OverridesParser.create().parse_override(text.lstrip("+"))
            value = override.value()
        except HydraException as error:
            raise InputError(f"{text}: cannot be read: give KEY=VALUE") from error
        if override.key_or_group not in _FREE:
            raise InputError(
                f"{text}: a continued run keeps its settings; only these may change: "
                f"{', '.join(_FREE)}"
            )
        changes[override.key_or_group] = value
    return changes


def prepare(folder: Path, changes: dict) -> tuple[DictConfig, dict]:
    """The configuration to go on with, and the run's manifest. Reads records only.

    Raises InputError, one line, when ``folder`` holds nothing that can be continued.
    """
    run = records.load(folder)
    if manifest.alive(run.manifest):
        raise InputError(f"{folder} is still being written: its process has not ended")
    cfg = _configuration(folder, changes)
    budget, spent = _budget(folder, cfg)
    if budget.progress(*spent) >= 1:
        seconds, iterations, paths = spent
        raise InputError(
            f"{folder}: its budget ({budget}) is spent ({seconds:.1f} s, {iterations} iterations, "
            f"{paths} paths); give a larger one, such as budget.seconds={2 * seconds:.0f}"
        )
    return cfg, run.manifest


def is_spent(folder: Path, changes: dict) -> bool:
    """Whether nothing of the run's budget is left. Raises InputError like ``prepare``."""
    budget, spent = _budget(folder, _configuration(folder, changes))
    return budget.progress(*spent) >= 1


def _budget(folder: Path, cfg: DictConfig) -> tuple[Budget, tuple[float, int, int]]:
    """The budget, and what the checkpoint says was spent of it."""
    _, state = records.load_checkpoint(folder)
    budget = Budget(cfg.budget.seconds, cfg.budget.iterations, cfg.budget.paths)
    return budget, (sum(state["billed"].values()), state["iteration"], state["paths"])


def _configuration(folder: Path, changes: dict) -> DictConfig:
    try:
        cfg = OmegaConf.merge(OmegaConf.structured(Config), OmegaConf.load(folder / "config.yaml"))
        for key, value in changes.items():
            OmegaConf.update(cfg, key, value)
        OmegaConf.to_object(cfg)
    except (OSError, OmegaConfBaseException) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{folder}/config.yaml does not give a run: {reason}") from error
    return cfg


def check_same_problem(problem: "Problem", earlier: dict, folder: Path) -> None:
    """Raises InputError unless scene and targets are those that the run began with."""
    now = {"scene_hash": problem.content_hash, "target_hash": problem.target_hash}
    for name, value in now.items():
        if earlier.get(name) != value:
            what = name.split("_")[0]
            raise InputError(
                f"{folder}: its {what} has changed since (hash {earlier.get(name)}, now {value}): "
                "start a new run"
            )
