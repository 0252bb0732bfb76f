"""Finished runs side by side: what accuracy costs in time. Reads records only.

`compare` makes the tables, plots and page; `build` gives their numbers, `read_accuracy` reads them
back from a table.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path

from ...runtime.errors import InputError
from . import accuracy, across, bootstrap, curves, price, summary, tables
from .gather import Comparison, Method, gather
from .tables import read as read_accuracy

__all__ = ["Comparison", "Method", "build", "compare", "output_of", "read_accuracy", "write"]

_OUTPUT = "comparison"


def compare(folders: list[Path], output: Path | None = None, baseline: str | None = None) -> Path:
    """Compares the runs below ``folders`` and returns the path of the page.

    ``output``: where tables, plots and page go, see `output_of`; ``baseline``: the method that
    the others are compared with, by default uniform sampling where there is any. Raises InputError
    (see `gather`) and IsasError when the disk refuses.
    """
    folders = [Path(folder) for folder in folders]
    target = output_of(folders, output)
    return write(build(folders, baseline), target)


def build(
    folders: list[Path], baseline: str | None = None, known: Sequence[str] = ()
) -> Comparison:
    """The numbers of a comparison; nothing is written. ``known``: more that is to be warned of."""
    methods, chosen, warnings = gather([Path(folder) for folder in folders], baseline)
    over = across.problems(methods, chosen)
    warnings += [*_few_seeds(methods), *across.untold(methods, chosen), *_few_scenes(over)]
    return Comparison(
        methods=methods,
        baseline=chosen,
        curves=curves.table(methods),
        accuracy=accuracy.table(methods, chosen),
        price=price.table(methods),
        summary=summary.table(methods, chosen),
        warnings=[*known, *warnings],
        across=over,
    )


def write(comparison: Comparison, output: Path) -> Path:
    """Tables, plots and page into ``output``; returns the path of the page."""
    tables.write(comparison, output)
    from . import page

    return page.write(comparison, output)


def output_of(folders: list[Path], output: Path | None) -> Path:
    """``output``, else comparison/ in the one folder or in the folder that all lie in.

    Raises InputError where that is a file, or where they share nothing but the root.
    """
    if output is None:
        common = folders[0]
        if len(folders) > 1:
            common = Path(os.path.commonpath([folder.resolve() for folder in folders]))
            if common == Path(common.anchor):
                raise InputError("the folders lie in no common one: say where, with --output DIR")
        output = common / _OUTPUT
    if output.exists() and not output.is_dir():
        raise InputError(f"{output} is a file: give a folder with --output DIR")
    return output


def _few_scenes(over: list[across.Problems]) -> list[str]:
    """Where no difference of methods could be told from chance by the test over scenes."""
    if not over:
        return []
    scenes, methods = len(over[0].budgets), len(over[0].times)
    least = min(1.0, 2 * 0.5**scenes * math.comb(methods, 2))
    if least <= 0.05:
        return []
    return [
        f"with {scenes} scenes and {methods} methods no p over all scenes can be below "
        f"{least:.2g}, however far methods are apart: more scenes or fewer methods tell"
    ]


def _few_seeds(methods: list[Method]) -> list[str]:
    counts = sorted({len(m.runs) for m in methods})
    few = [n for n in counts if 1 < n and bootstrap.held(n) < bootstrap.CONFIDENCE]
    lines = []
    if 1 in counts:
        lines.append("methods with one run have no intervals: their seed may be a lucky one")
    if few:
        seeds = " and ".join(str(n) for n in few)
        held = " and ".join(f"{100 * bootstrap.held(n):.0f} %" for n in few)
        lines.append(
            f"with {seeds} seeds an interval is their range, which holds the true median in {held} "
            "of cases, not 95 %; six seeds or more make it what it is called"
        )
    return lines
