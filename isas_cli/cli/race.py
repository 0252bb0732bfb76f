"""`isas race`: several configurations in one process, in turn, at equal billed time."""

from __future__ import annotations

import datetime
import json
import os
import re
from pathlib import Path
from typing import Any

import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

from ..config import paths
from ..config.compose import compose, options, translate
from ..config.grammar import override
from ..config.roles import meaning
from ..engine import resumption
from ..records import write_atomically
from ..runtime import interrupt
from ..runtime.errors import InputError, nearest
from . import one

_FILE = "race.yaml"
_SLICE_SECONDS = 1.0


def main(arguments: list[str]) -> int:
    """Race what ``arguments`` (as typed) say. Raises IsasError; else returns the exit status."""
    for argument in arguments:
        if argument.startswith("-"):
            raise InputError(f"{argument}: no such flag; see isas race --help")
    own, overrides = _own(arguments)
    with one.argv(["isas", "race", *arguments]), interrupt.prompt():
        turn = _slice(own)
        plan = _continued if "resume" in own else _fresh
        folder, entries, begin = plan(own, overrides)
        from ..engine import race

        return _compared(folder, race.run(entries, turn, begin))


def _own(arguments: list[str]) -> tuple[dict[str, str], list[str]]:
    """The race's own settings by name, and the overrides that all contestants share."""
    own, overrides = {}, []
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if equals and key in (
            "samplers",
            "contestants",
            "seed",
            "slice",
            "resume",
            "hydra.run.dir",
        ):
            if key in own:
                raise InputError(f"{argument}: {key} is given twice")
            own[key] = value
        else:
            overrides.append(argument)
    return own, overrides


def _slice(own: dict[str, str]) -> float:
    text = own.get("slice", str(_SLICE_SECONDS))
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0 < seconds < float("inf"):
        raise InputError(f"slice={text}: billed seconds per turn, above 0")
    return seconds


def _fresh(own: dict[str, str], overrides: list[str]):
    """Folder and entries of a new race, and what writes them down in race.yaml."""
    from ..engine.race import Entry

    for text in overrides:
        if text.split("=")[0] == "sampler":
            raise InputError(f"{text}: a race has several: samplers=[A,B] or contestants=[…]")
    differing = differences(own)
    seeds = _values("seed", own.get("seed", "1"))
    if not all(isinstance(seed, int) and not isinstance(seed, bool) for seed in seeds):
        raise InputError(f"seed={own['seed']}: whole numbers, such as seed=[1,2,3]")
    _distinct("seed", seeds)
    common = translate(overrides)
    if not any(each.lstrip("+").startswith("budget") for each in common):
        common.append("budget.seconds=null")  # equal time, and not the scene's iterations
    entries, folder, planned = [], None, []
    for difference in differing:
        more = translate([f"{key}={override(value)}" for key, value in difference.items()])
        for seed in seeds:
            settings = [*common, *more, f"seed={seed}", f"name=seed{seed}"]
            cfg = compose(settings)
            folder = folder or _folder(own, cfg.scene.name)
            label = _label(cfg, difference)
            place = folder / _slug(label) / f"seed{seed}"
            one.check_folder(place, cfg.overwrite)
            entries.append(Entry(label, cfg, place))
            relative = str(place.relative_to(folder))
            planned.append({"label": label, "folder": relative, "settings": settings})
    if (folder / _FILE).exists() and not cfg.overwrite:
        raise InputError(
            f"{folder} already holds a race: choose another folder with hydra.run.dir=DIR, go on "
            f"with it by resume={folder}, or replace it with overwrite=true"
        )
    _distinct("contestants: folder", [plan["folder"] for plan in planned])
    plan = {"schema": 1, "started_in": os.getcwd(), "entries": planned}
    written = yaml.safe_dump(plan, sort_keys=False)

    def begin() -> None:
        write_atomically(folder / _FILE, lambda path: path.write_text(written, encoding="utf-8"))

    return folder, entries, begin


def _continued(own: dict[str, str], overrides: list[str]):
    """Folder and unfinished entries of an earlier race; there is nothing to write down."""
    from ..engine.race import Entry, continued

    strange = sorted(set(own) - {"resume", "slice"})
    if strange:
        raise InputError(f"{strange[0]}={own[strange[0]]}: a continued race keeps its contestants")
    folder = Path(own["resume"].strip("\"'"))
    try:
        read = yaml.safe_load((folder / _FILE).read_text(encoding="utf-8"))
        home, planned = read.get("started_in"), read["entries"]
        places = [(plan["label"], folder / plan["folder"], plan["settings"]) for plan in planned]
    except (OSError, yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{folder} holds no race: {_FILE} is missing or damaged") from error
    changes = resumption.parse(overrides)
    entries = []
    for label, place, settings in places:
        if any((place / name).exists() for name in ("history.csv", "checkpoint/state.npz")):
            entry = continued(label, place, changes)
        else:  # killed before its record was whole, and before its first step
            cfg = compose([*settings, "overwrite=true"])
            paths.locate(cfg, home)
            entry = Entry(label, resumption.changed(cfg, changes), place)
        if entry is not None:
            entries.append(entry)
    if not entries:
        raise InputError(f"{folder}: every contestant has spent its budget: give a larger one")
    return folder, entries, lambda: None


def differences(own: dict[str, str]) -> list[dict[str, Any]]:
    """What each contestant changes, by key."""
    contestants = _contestants(own["contestants"]) if "contestants" in own else [{}]
    if "samplers" not in own:
        if contestants == [{}]:
            raise InputError("a race needs contestants: samplers=[A,B] or contestants=[{…},{…}]")
        return contestants
    samplers = _values("samplers", own["samplers"])
    _distinct("samplers", samplers)
    for sampler in samplers:
        if sampler not in options("sampler"):
            raise InputError(
                f"samplers: {sampler}: no such sampler; {nearest(str(sampler), options('sampler'))}"
            )
    if any("sampler" in contestant for contestant in contestants):
        raise InputError("samplers and a contestant's own sampler exclude each other")
    return [{"sampler": s, **contestant} for contestant in contestants for s in samplers]


def _contestants(text: str) -> list[dict[str, Any]]:
    found = _values("contestants", text)
    if not all(isinstance(contestant, dict) and contestant for contestant in found):
        raise InputError(
            f"contestants={text}: a list of differences, such as "
            "[{sampler:uniform,optimizer.lr:0.02},{sampler:ours}]"
        )
    for contestant in found:
        for key in contestant:
            # One process, one machine, one budget.
            if meaning(key.lstrip("+~")).shared:
                raise InputError(f"contestants: {key}: all contestants of a race share it")
    _distinct("contestants", [json.dumps(contestant, sort_keys=True) for contestant in found])
    return found


def _values(name: str, text: str) -> list[Any]:
    """A list in Hydra's notation or in JSON; a single value is a list of one."""
    try:
        value = json.loads(text)
    except json.JSONDecodeError:
        try:
            value = OverridesParser.create().parse_override(f"{name}={text}").value()
        except HydraException as error:
            raise InputError(f"{name}={text}: cannot be read as a list [A,B]") from error
    values = value if isinstance(value, list) else [value]
    if not values or not isinstance(values[0], (str, int, float, dict)):
        raise InputError(f"{name}={text}: give a list such as [A,B]")
    return [_plain(v) for v in values]


def _plain(value: Any) -> Any:
    """Hydra's quoted strings and nested values as plain Python."""
    if isinstance(value, dict):
        return {str(_plain(k)): _plain(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_plain(v) for v in value]
    return getattr(value, "text", value)


def _distinct(what: str, values: list) -> None:
    twice = {str(v) for v in values if values.count(v) > 1}
    if twice:
        raise InputError(f"{what}: given twice: {', '.join(sorted(twice))}")


def _label(cfg, difference: dict[str, Any]) -> str:
    """The sampler's name and whatever else makes this contestant what it is."""
    others = [f"{key}={value}" for key, value in difference.items() if key != "sampler"]
    return " ".join([str(cfg.sampler.name), *others])


def _slug(label: str) -> str:
    """A folder's name: readable, nothing that a shell would take apart."""
    return re.sub(r"[^\w.=+-]+", "_", label).strip("_.") or "contestant"


def _folder(own: dict[str, str], scene: str) -> Path:
    given = own.get("hydra.run.dir", "").strip("\"'")
    if given:
        return Path(given)
    if "hydra.run.dir" in own:
        raise InputError("hydra.run.dir is empty: give hydra.run.dir=DIR")
    return Path("runs") / scene / f"race-{datetime.datetime.now():%Y%m%d-%H%M%S}"


def _compared(folder: Path, status: int) -> int:
    """The comparison's page, which a race is run for. Returns the race's status."""
    from .compare import main as compare

    # Its own runs, not whatever else lies below its folder.
    planned = yaml.safe_load((folder / _FILE).read_text(encoding="utf-8"))["entries"]
    try:
        compare([folder / plan["folder"] for plan in planned], folder / "comparison", None)
    except InputError:  # nothing was reached that could be compared
        if not status:
            raise
    return status
