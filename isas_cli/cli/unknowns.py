"""`isas unknowns`: what a scene offers to be found."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from ..config.compose import compose, translate
from ..engine import experiment
from ..runtime import backend, interrupt
from ..runtime.errors import InputError
from . import one

if TYPE_CHECKING:
    from ..engine.offers import Offer, Offers

_FEW = 4  # numbers of views that are listed
_WIDE, _OTHERS = 180, 100  # columns of text: of a row, and of what stands beside its key


def main(arguments: list[str]) -> int:
    """Print what the scene that ``arguments`` name offers. Raises IsasError; returns 0."""
    flags = [each for each in arguments if each.startswith("-")]
    one.no_flags("unknowns", arguments, ("--json",))
    one.no_sweep(arguments, "leave it out")
    settings = _settings([each for each in arguments if each not in flags])
    with interrupt.prompt():
        cfg = compose(translate(settings))
        typed, _ = experiment.checked(cfg)
        backend.start(typed.variant, typed.threads)
        # Mitsuba's types exist only once the backend has started.
        from ..engine import offers

        found = offers.of(typed.scene)
    if flags:
        print(json.dumps(_plain(found, list(typed.scene.unknowns)), indent=1))
    else:
        show(found, Console())
    return 0


def _settings(words: list[str]) -> list[str]:
    """A word alone is a file: short for ``scene=file scene.path=FILE``. A file's name may have =
    in it."""
    alone = [word for word in words if "=" not in word and not word.startswith("~")]
    files = [word for word in words if word in alone or os.path.isfile(word)]
    if len(files) > 1:
        raise InputError(f"{files[1]}: one file is enough; see isas unknowns --help")
    others = [word for word in words if word not in files]
    return [*(f"scene.path={file}" for file in files), *(["scene=file"] if files else []), *others]


def show(found: "Offers", console: Console) -> None:
    """A row a key."""
    needed = max((len(each.key) for each in found.found), default=0) + _OTHERS
    if not console.is_terminal or needed > console.width:
        # For files and other programs a line a row; narrow terminals wrap it.
        console.width = max(_WIDE, needed)
    # For copying: never cut.
    key = Column("scene.unknowns", no_wrap=True)
    others = "kind", "shape", "range", "estimator", "seen by", "derivative"
    table = Table(key, *others, box=box.SIMPLE_HEAD)
    for each in found.found:
        shape = " × ".join(map(str, each.shape))
        if each.refused:
            told = "", "", f"none: {each.refused}"
        else:
            told = _range(each), each.estimator, _seen(each, found.count), each.verdict
        table.add_row(*map(Text, (each.key, each.kind, shape, *told)))  # as ids are spelt
    console.print(table)
    taken = [each for each in found.found if not each.refused]
    for note in dict.fromkeys(each.note for each in taken if each.note):
        keys = ", ".join(each.key for each in taken if each.note == note)
        console.print(Text(f"{keys}: {note}"))
    if found.movable:
        console.print(Text(f"scene.poses can move: {', '.join(found.movable)}"))


def _range(offer: "Offer") -> str:
    low, high = offer.low, offer.high
    if math.isinf(low):
        told = "any" if math.isinf(high) else f"at most {high:g}"
    else:
        told = f"from {low:g}" if math.isinf(high) else f"{low:g} to {high:g}"
    return f"{told}, {offer.unit}" if offer.unit else told


def _seen(offer: "Offer", count: int) -> str:
    if offer.views is None:
        return "not asked"
    if not offer.views:
        return "none"
    if len(offer.views) == count:
        return f"all {count}" if count > 1 else "yes"
    listed = ", ".join(map(str, offer.views[:_FEW])) + ", …" * (len(offer.views) > _FEW)
    return f"{len(offer.views)} of {count}: {listed}"


def _plain(found: "Offers", chosen: list[str]) -> list[dict]:
    """For programs: what ``Offer`` has, no number where there is no bound."""
    rows = [dataclasses.asdict(each) for each in found.found]
    for row in rows:
        for bound in ("low", "high"):
            row[bound] = row[bound] if math.isfinite(row[bound]) else None
        row["chosen"] = row["key"] in chosen
    return rows
