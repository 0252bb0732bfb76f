"""What the census of derivatives (benchmarks/derivatives.md) says of a plugin's parameter.

``verdicts.csv`` has a row for each: ``class`` (Mitsuba's, of the object that has the parameter),
``plugin``, ``word`` (the parameter's own name), ``verdict``, and a ``note``. The verdicts:
``right``; ``right, wrong in Mitsuba`` (by ``isas``, not by each of Mitsuba's integrators);
``right inside its range`` (not at an end of it);
``wrong (isas)``; ``never differentiated (isas)``; ``refused``; ``moves`` (geometry: other
estimators); ``no effect``; ``unsure``; ``fails (isas)``.
"""

from __future__ import annotations

import csv
from functools import cache
from importlib import resources

import mitsuba as mi

from .ranges import fed

UNKNOWN = "not in the census"
WRONG = ("wrong (isas)", "never differentiated (isas)")


@cache
def _table() -> dict[tuple[str, str], tuple[str, str]]:
    """(verdict, note) by class or plugin, and word."""
    text = resources.files(__package__).joinpath("verdicts.csv").read_text(encoding="utf-8")
    found = {}
    for row in csv.DictReader(text.splitlines()):
        for name in (row["class"], row["plugin"]):
            found[name, row["word"]] = row["verdict"], row["note"]
    return found


def verdict(plugin: str, word: str) -> str:
    """Of the parameter ``word`` of a ``plugin``, or of a class of Mitsuba's."""
    return _table().get((plugin, word), (UNKNOWN, ""))[0]


def note(plugin: str, word: str) -> str:
    """Where the verdict does not hold, and what to do; empty where there is nothing to say."""
    return _table().get((plugin, word), (UNKNOWN, ""))[1]


def place(params: mi.SceneParameters, key: str) -> tuple[str, str]:
    """The class that a parameter of the scene belongs to, and the parameter's name there: of a
    colour's numbers that of the material, light, medium or mesh that has the colour."""
    holder, words = params.properties[key][2], key.split(".")
    word = words[-1]
    climbed = 1
    while isinstance(holder, (mi.Texture, mi.Volume)):
        parent = params.hierarchy[holder][0]
        if parent is None or isinstance(parent, mi.Scene):
            # Of a shared one that of the first that takes it.
            holder, word, _ = (fed(params, key) or [(holder, word, 1.0)])[0]
            break
        climbed += 1
        word = words[-climbed] if climbed <= len(words) else word
        holder = parent
    # What vertices hold is the same for files of all formats.
    return "Mesh" if isinstance(holder, mi.Mesh) else holder.class_name(), word
