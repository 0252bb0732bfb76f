"""One race: what was typed of it, its contestants, and the file that it can go on from."""

from __future__ import annotations

import datetime
import hashlib
import json
import os
import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep
from hydra.core.utils import setup_globals
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from ...config import paths, searchpath
from ...config.compose import compose, options, translate
from ...config.grammar import override, plain
from ...config.roles import meaning
from ...engine import race, resumption
from ...engine.race import Entry
from ...records import write_text
from ...runtime.errors import InputError, nearest
from .. import one

FILE = "race.yaml"
_LONGEST = 120  # bytes of a folder's name: disks take 255
LISTED = "entries", "settings"  # in it
SLICE_SECONDS = 1.0
_OWN = ("samplers", "contestants", "seed", "slice", "resume", "hydra.run.dir")


@dataclass(frozen=True)
class Plan:
    """A race that is to be: its folder, its entries, what race.yaml says of these, and from where
    they name files."""

    folder: Path
    entries: list[Entry]
    written: list[dict[str, Any]]
    home: str
    turn: float

    def check(self) -> None:
        """Raises InputError where the folders cannot be used or hold something."""
        overwrite = self.entries[0].cfg.overwrite
        for entry in self.entries:
            one.check_folder(entry.folder, overwrite)
        if (self.folder / FILE).exists() and not overwrite:
            resume = shlex.quote(f"resume={self.folder}")
            raise InputError(
                f"{self.folder} already holds a race: choose another folder with "
                f"hydra.run.dir=DIR, go on with it by {resume}, or replace it with "
                "overwrite=true"
            )

    def begin(self) -> None:
        """Write race.yaml."""
        content = {"slice": self.turn, "entries": self.written}
        write_yaml(self.folder / FILE, {"started_in": self.home, **content})


def options_of(
    arguments: list[str], known: tuple[str, ...] = _OWN
) -> tuple[dict[str, str], list[str]]:
    """The command's own settings by name, those ``known``, and the overrides that all contestants
    share. Raises InputError."""
    own, overrides = {}, []
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if equals and key in known:
            if key in own:
                raise InputError(f"{argument}: {key} is given twice")
            own[key] = value
        else:
            overrides.append(argument)
    return own, overrides


def slice_seconds(own: dict[str, str]) -> float:
    """Billed seconds of a turn."""
    text = own.get("slice", str(SLICE_SECONDS))
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0 < seconds < float("inf"):
        raise InputError(f"slice={text}: billed seconds per turn, above 0")
    return seconds


def planned(own: dict[str, str], overrides: list[str], home: str | None = None) -> Plan:
    """A new race: every contestant with every seed; ``home``: where it was started, if not here.
    Raises InputError."""
    for text in overrides:
        if text.split("=")[0] == "sampler":
            raise InputError(f"{text}: a race has several: samplers=[A,B] or contestants=[…]")
        if text.split("=")[0] == "name":
            raise InputError(f"{text}: a race names its runs itself; hydra.run.dir=DIR names it")
        if text.lstrip("+~").startswith("hydra"):
            raise InputError(
                f"{text}: of Hydra's settings a race takes hydra/launcher, hydra.launcher.KEY and "
                "hydra.run.dir"
            )
    differing = differences(own)
    seeds = _values("seed", own.get("seed", "1"))
    if not all(isinstance(seed, int) and not isinstance(seed, bool) for seed in seeds):
        raise InputError(f"seed={own['seed']}: whole numbers, such as seed=[1,2,3]")
    _distinct("seed", seeds)
    common = translate(overrides)
    if not any(each.lstrip("+").startswith("budget") for each in common):
        common.append("budget.seconds=null")  # equal time, and not the scene's iterations
    entries, folder, written = [], None, []
    for difference in differing:
        more = translate([f"{key}={override(value)}" for key, value in difference.items()])
        for seed in seeds:
            settings = [*common, *more, f"seed={seed}", f"name=seed{seed}"]
            cfg = compose(settings)
            paths.locate(cfg, home)
            folder = folder or _folder(own, cfg.scene.name)
            label = _label(cfg, difference)
            place = folder / slug(label) / f"seed{seed}"
            entries.append(Entry(label, cfg, place))
            relative = str(place.relative_to(folder))
            written.append({"label": label, "folder": relative, "settings": settings})
    _distinct("contestants: folder", [each["folder"] for each in written])
    _check_unlike(entries)
    return Plan(folder, entries, written, home or os.getcwd(), slice_seconds(own))


def _check_unlike(entries: list[Entry]) -> None:
    """Raises InputError where two contestants are the same but for the name of their sampler."""
    found: dict[str, str] = {}
    for entry in entries:
        cfg = entry.cfg.copy()
        cfg.sampler.name = cfg.name = ""
        first = found.setdefault(OmegaConf.to_yaml(cfg, resolve=True), entry.label)
        if first != entry.label:
            raise InputError(
                f"{first} and {entry.label} differ in the name alone with scene={cfg.scene.name}: "
                f"both take estimator={cfg.estimator.name}, with the same settings: leave one out"
            )


def write_yaml(path: Path, content: dict[str, Any]) -> None:
    """What there is to go on with."""
    places = {"searchpath": searchpath.typed()} if searchpath.typed() else {}
    text = yaml.safe_dump({"schema": 1, **places, **content}, sort_keys=False)
    write_text(path, text)


def read_yaml(path: Path, key: str, told: str) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """What is there, with the list under ``key``, whose items have a folder and what they are
    ``told``, a list of texts of that name. Choices lie where they did when it was begun, from here
    on. Raises InputError."""
    try:
        read = yaml.safe_load(path.read_text(encoding="utf-8"))
        listed, places = read[key], read.get("searchpath", [])
        for each in listed:
            if not all(isinstance(text, str) for text in (each["folder"], *each[told])):
                raise TypeError
        searchpath.add(places)
    except (OSError, yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
        holds = f"{path.parent} holds no race: {path.name} is missing or damaged"
        raise InputError(holds) from error
    return read, listed


def unfinished(folder: Path, changes: dict[str, Any]) -> list[Entry]:
    """The entries of an earlier race that have not ended, or not with these ``changes``."""
    read, listed = read_yaml(folder / FILE, *LISTED)
    entries = []
    for each in listed:
        label, place, settings = each.get("label", ""), folder / each["folder"], each["settings"]
        if any((place / name).exists() for name in ("history.csv", "checkpoint/state.npz")):
            entry = race.continued(label, place, changes)
        else:  # killed before its record was whole, and before its first step
            cfg = compose([*settings, "overwrite=true"])
            paths.locate(cfg, read.get("started_in"))
            entry = Entry(label, resumption.changed(cfg, changes), place)
        if entry is not None:
            if entry.earlier is not None:
                one.check_writable(place, "a run goes on where it is: copy the race")
            entries.append(entry)
    return entries


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
            value = value.list if isinstance(value, ChoiceSweep) else value
        except HydraException as error:
            raise InputError(f"{name}={text}: cannot be read as a list [A,B]") from error
    values = value if isinstance(value, list) else [value]
    if not values or not isinstance(values[0], (str, int, float, dict)):
        raise InputError(f"{name}={text}: give a list such as [A,B]")
    return [plain(v) for v in values]


def _distinct(what: str, values: list) -> None:
    twice = {str(v) for v in values if values.count(v) > 1}
    if twice:
        raise InputError(f"{what}: given twice: {', '.join(sorted(twice))}")


def _label(cfg, difference: dict[str, Any]) -> str:
    """The sampler's name and whatever else makes this contestant what it is."""
    others = [f"{key}={value}" for key, value in difference.items() if key != "sampler"]
    return " ".join([str(cfg.sampler.name), *others])


def slug(label: str) -> str:
    """A folder's name: readable, nothing that a shell would take apart, no longer than disks take,
    of what is cut off with what tells it from others."""
    name = re.sub(r"[^\w.=+-]+", "_", label).strip("_.") or "contestant"
    if len(name.encode()) <= _LONGEST:
        return name
    whole = hashlib.blake2b(label.encode(), digest_size=6).hexdigest()
    return f"{name.encode()[: _LONGEST - 13].decode(errors='ignore')}_{whole}"


def _folder(own: dict[str, str], scene: str) -> Path:
    if "hydra.run.dir" in own:
        return folder_of(own["hydra.run.dir"])
    return Path("runs") / scene / f"race-{datetime.datetime.now():%Y%m%d-%H%M%S-%f}"


def folder_of(given: str) -> Path:
    """The folder that was ``given`` as hydra.run.dir, which may refer to the time and to the
    environment. Raises InputError where it is empty, and for what is not there."""
    setup_globals()
    try:
        folder = str(OmegaConf.create({"given": given.strip("\"'")}).given)
    except OmegaConfBaseException as error:
        told = str(error).splitlines()[0]
        raise InputError(f"hydra.run.dir={given}: {told}") from error
    if not folder:
        raise InputError("hydra.run.dir is empty: give hydra.run.dir=DIR")
    return Path(os.path.expanduser(folder))


def compared(folders: list[Path], output: Path, status: int) -> None:
    """Compare what there is of the runs in ``folders``, into ``output``/comparison. Raises
    InputError where nothing was reached that could be, unless a ``status`` tells why."""
    from ..compare import main as compare

    try:
        begun = [each for each in folders if (each / "manifest.json").is_file()]
        never = [str(each) for each in folders if each not in begun]
        told = [f"left out, as they never began: {', '.join(never)}"] if never else []
        compare(begun, output / "comparison", None, told)
    except InputError:
        if not status:
            raise
