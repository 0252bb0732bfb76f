"""`isas race`: several configurations in one process, in turn, at equal billed time."""

from __future__ import annotations

import os
from pathlib import Path

from ..engine import race as engine
from ..engine import resumption
from ..runtime import interrupt, memory
from ..runtime.errors import InputError
from . import one
from .sweeps import race, races


def main(arguments: list[str]) -> int:
    """Race what ``arguments`` (as typed) say. Raises IsasError; else returns the exit status."""
    one.no_flags("race", arguments)
    own, overrides = race.options_of(arguments)
    with one.argv(["isas", "race", *arguments]), interrupt.prompt():
        if "resume" in own:
            folder = _resumed(own)
            if (folder / races.FILE).exists():
                return races.resume(folder, own, overrides)
            read, _ = race.read_yaml(folder / race.FILE, *race.LISTED)
            if launcher := next((o for o in overrides if o.startswith("hydra/launcher")), None):
                raise InputError(
                    f"{launcher}: one race goes on here: leave it out; several, of scenes or seeds "
                    "with commas, take a launcher"
                )
            turn = race.slice_seconds({"slice": str(read.get("slice", race.SLICE_SECONDS)), **own})
            left = race.unfinished(folder, resumption.parse(overrides))
            if not left:
                spent = "every contestant has spent its budget: give a larger one"
                raise InputError(f"{folder}: {spent}")
            with memory.kept("isas race", folder):
                return _compared(folder, engine.run(left, turn, lambda: None))
        several = races.expanded(own, overrides)
        if several:
            return races.main(own, several)
        plan = race.planned(own, overrides)
        plan.check()
        return _compared(plan.folder, engine.run(plan.entries, plan.turn, plan.begin))


def _resumed(own: dict[str, str]) -> Path:
    strange = sorted(set(own) - {"resume", "slice"})
    if strange:
        raise InputError(f"{strange[0]}={own[strange[0]]}: a continued race keeps its contestants")
    return Path(os.path.expanduser(own["resume"].strip("\"'")))


def _compared(folder: Path, status: int) -> int:
    """The comparison's page, which a race is run for. Returns the race's status."""
    # Its own runs, not whatever else lies below its folder.
    _, listed = race.read_yaml(folder / race.FILE, *race.LISTED)
    race.compared([folder / each["folder"] for each in listed], folder, status)
    return status
