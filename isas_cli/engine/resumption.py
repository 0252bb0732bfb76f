"""Going on with a run that ended early: what must be the same, and what may change."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from .. import records
from ..config import paths, schema
from ..config.roles import meaning, resuming
from ..config.schema import Config
from ..records import Run, manifest
from ..runtime.budget import Budget
from ..runtime.errors import InputError, NumericalError

if TYPE_CHECKING:
    from ..runtime.backend import Backend
    from ..scene.problem import Problem


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
        if override.is_delete() or override.is_sweep_override():
            raise InputError(f"{text}: a continued run takes one value: KEY=VALUE")
        # Everything else decides what is computed next; a run continued otherwise would be two.
        if not meaning(override.key_or_group).resumes:
            raise InputError(
                f"{text}: a continued run keeps its settings; only these may change: "
                f"{', '.join(resuming())}"
            )
        changes[override.key_or_group] = value
    return changes


class Spent(InputError):
    """There is nothing left to do for a run."""


@dataclass(frozen=True)
class Continuation:
    """A run to go on with: its configuration as changed, with files where they are found from
    here, and as it is recorded; its manifest, the budget it had so far where that has changed, and
    its checkpoint; whether it ``failed`` numerically."""

    folder: Path
    cfg: DictConfig
    recorded: DictConfig
    manifest: dict
    earlier_budget: Budget | None
    arrays: dict[str, np.ndarray]
    state: dict
    failed: bool

    @property
    def device(self) -> str | None:
        """What it was last computed on."""
        latest = [self.manifest.get("machine", {}), *self.manifest.get("resumed", [])][-1]
        return latest.get("device")


def prepare(folder: Path, changes: dict) -> Continuation:
    """What to go on with. Reads records only.

    Raises InputError, one line, when ``folder`` holds nothing that can be continued: also when
    all is done and the budget spent. A run that was killed after its last iteration and before
    the end of its record is finished by a continuation.
    """
    run = records.load(folder)
    # Of a complete one the process may live on, such as a notebook's.
    if not run.complete and manifest.alive(run.manifest):
        raise InputError(f"{folder} is still being written: its process has not ended")
    cfg, before = configuration(folder, run, changes)
    arrays, state = records.load_checkpoint(folder)
    if state["iteration"] > 0 and run.history.empty:
        # What was found so far would count as the start.
        raise InputError(
            f"{folder}: its history.csv is gone, or has no rows: put it back, or start a new run"
        )
    budget = _budget(cfg)
    spent = (sum(state["billed"].values()), state["iteration"], state["paths"])
    if run.complete and budget.spent(*spent) >= 1:
        raise Spent(f"{folder}: its budget is spent: {_larger(budget, *spent)}")
    if changes and budget.spent(*spent) >= 1 > before.spent(*spent):
        # Going on would drop the rows after the checkpoint and make none of them again.
        raise InputError(f"{folder}: more than that is spent: {_larger(budget, *spent)}")
    earlier = None if before == budget else before
    recorded = changed(_read(run.config), changes)
    failed = (run.summary or {}).get("status") == NumericalError.ended
    return Continuation(folder, cfg, recorded, run.manifest, earlier, arrays, state, failed)


def _larger(budget: Budget, seconds: float, iterations: int, paths: int) -> str:
    """The limits that have been reached, and what would lift them."""
    spent = {"seconds": seconds, "iterations": iterations, "paths": paths}
    reached = [name for name, used in spent.items() if used >= (getattr(budget, name) or math.inf)]
    limits = ", ".join(f"{name}={_written(getattr(budget, name))}" for name in reached)
    more = " ".join(f"budget.{name}={_written(2 * getattr(budget, name))}" for name in reached)
    return f"{limits}; give a larger one, such as {more}"


def _written(number: float) -> str:
    """As it can be typed: iterations take no exponent."""
    return str(number) if isinstance(number, int) else f"{number:g}"


def _budget(cfg: DictConfig) -> Budget:
    return Budget(cfg.budget.seconds, cfg.budget.iterations, cfg.budget.paths)


def result(folder: Path) -> tuple[Config, dict[str, np.ndarray]]:
    """The configuration of the run in ``folder``, and its unknowns' values by key. Raises
    InputError."""
    run = records.load(folder)
    arrays = run.parameters()
    return schema.typed(anywhere(folder, run)), arrays


def changed_since(folder: Path, typed: Config) -> str | None:
    """A line where the scene is not what it was when the run in ``folder`` began, which has
    ``typed`` settings; None where that cannot be told, as of starts whose files are gone."""
    from . import assemble

    if typed.scene.outside:  # which has no scene
        return None
    try:
        now = assemble.bare(typed.scene)[0].content_hash
    except InputError:
        return None
    before = records.load(folder).manifest.get("scene_hash")
    if before == now:
        return None
    return (
        f"warning: {folder}: its scene has changed since the run: what was found then is put into "
        "what is there now"
    )


def configuration(folder: Path, run: Run, changes: dict) -> tuple[DictConfig, Budget]:
    """The configuration of the ``run`` recorded in ``folder``, as changed, with files where they
    are found from here, and the budget before that."""
    try:
        cfg = _read(run.config)
        before = _budget(cfg)
        schema.typed(cfg)
    # The latter two: a number beyond all floats, and what is nested too deeply.
    except (OmegaConfBaseException, OverflowError, RecursionError) as error:
        reason = str(error).split("\n")[0]
        raise InputError(f"{folder}/config.yaml does not give a run: {reason}") from error
    paths.locate(cfg, run.manifest.get("folder"))
    # On a machine where a card works by now; a run that took one goes on by one alone.
    if cfg.variant == "auto" and str(run.manifest.get("variant")).startswith("llvm"):
        cfg.variant = run.manifest["variant"]
    return changed(cfg, changes), before


def anywhere(folder: Path, run: Run) -> DictConfig:
    """The configuration, for what goes by the result alone: the card that it was found on may be
    missing. Raises InputError."""
    cfg, _ = configuration(folder, run, {})
    if cfg.variant.startswith("cuda"):
        cfg.variant = "auto"
    return cfg


def _read(recorded: dict) -> DictConfig:
    return OmegaConf.merge(OmegaConf.structured(Config), recorded)


def changed(cfg: DictConfig, changes: dict) -> DictConfig:
    """``cfg`` with new values by key. Raises InputError for one that does not fit."""
    for key, value in changes.items():
        try:
            OmegaConf.update(cfg, key, value)
        except (OmegaConfBaseException, OverflowError) as error:
            raise InputError(f"{key}={value}: {str(error).splitlines()[0]}") from error
    return cfg


def check_variant(
    machine: "Backend",
    earlier: dict,
    folder: Path,
    why: str = "billed seconds of both would not be comparable",
) -> None:
    """Raises InputError unless the variant is that which it began with. ``why``: what another would
    change."""
    if earlier.get("variant") != machine.variant:
        raise InputError(
            f"{folder} began with variant={earlier.get('variant')}, and this machine takes "
            f"{machine.variant}: {why}"
        )


def check_same(problem: "Problem", earlier: dict, folder: Path) -> None:
    """Raises InputError unless scene, targets, starts and what parameter_rmse is are those that it
    began with; before there are targets, where that can be told already."""
    import mitsuba as mi

    now = {"scene_hash": problem.content_hash, "target_hash": problem.target_hash}
    now["start_hash"] = problem.unknowns.start_hash
    versions = (earlier.get("packages") or {}).get("mitsuba"), mi.__version__
    newer = "" if versions[0] == versions[1] else ", or is Mitsuba {1}'s and not {0}'s"
    if problem.targets is None:
        if problem.truth_known and versions[0] and newer:
            now["target_hash"] = "another"  # of what is rendered
        else:
            del now["target_hash"]
    for name, value in now.items():
        if earlier.get(name) != value:
            what = name.split("_")[0]
            raise InputError(
                f"{folder}: its {what} has changed since{newer.format(*versions)} (hash "
                f"{earlier.get(name)}, now {value}): start a new run"
            )
    said, unit = earlier.get("parameter_rmse_is"), manifest.headline(problem.unknowns.unit)
    if said not in (None, unit):
        raise InputError(
            f"{folder}: its parameter_rmse is in '{said}', and now it would be in '{unit}': start "
            "a new run"
        )
