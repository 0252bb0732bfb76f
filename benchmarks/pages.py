"""Writes the pages of results from the tables in results/.

adaptive_sampling.md and plateau.md, a page a paper, cost.md, what steps and records cost,
effects.md, what leaving out light transport saves, derivatives.md, which derivatives can be
trusted, exports.md, which results can be written, shapes.md, volumes.md, pbdr.md and filters.md,
what races on them say, and the table in the README. What measures calls this at its end; all
numbers in the text are filled in from the tables, by the templates in templates/.

    python benchmarks/pages.py
"""

from __future__ import annotations

import operator
import statistics
from collections.abc import Iterable
from pathlib import Path

import _page_adaptive
import _page_cost
import _page_derivatives
import _page_effects
import _page_exports
import _page_filters
import _page_pbdr
import _page_photographs
import _page_plateau
import _page_shapes
import _page_volumes
import jinja2

HERE = Path(__file__).parent
RESULTS = HERE / "results"
README = HERE.parent / "README.md"
# Between these two lines the README's table stands.
BEGIN, END = "<!-- written by benchmarks/pages.py -->", "<!-- end -->"
PAGES = {
    "adaptive_sampling": _page_adaptive.facts,
    "plateau": _page_plateau.facts,
    "cost": _page_cost.facts,
    "derivatives": _page_derivatives.facts,
    "effects": _page_effects.facts,
    "shapes": _page_shapes.facts,
    "volumes": _page_volumes.facts,
    "pbdr": _page_pbdr.facts,
    "exports": _page_exports.facts,
    "filters": _page_filters.facts,
    "photographs": _page_photographs.facts,
}


def listed(names: Iterable, mark: str = "") -> str:
    """'a, b and c', each between ``mark``; 'none' of none."""
    marked = [f"{mark}{name}{mark}" for name in names]
    return " and ".join(filter(None, [", ".join(marked[:-1]), *marked[-1:]])) or "none"


def span(values: Iterable[float], form: str = ".2f") -> str:
    """'least to largest', or the one number that both are when written so."""
    ordered = sorted(values)
    ends = [format(end, form) for end in (ordered[0], ordered[-1])]
    return ends[0] if ends[0] == ends[1] else " to ".join(ends)


def _environment() -> jinja2.Environment:
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE / "templates"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters |= {
        "listed": listed,
        "span": span,
        "as": format,
        "multiply": operator.mul,
        "median": statistics.median,
    }
    return made


def rendered(results: Path = RESULTS) -> dict[Path, str]:
    """Every page's path and text."""
    environment = _environment()
    found = {name: facts(results) for name, facts in PAGES.items()}
    texts = {
        HERE / f"{name}.md": environment.get_template(f"{name}.md.j2").render(own)
        for name, own in found.items()
    }
    before, rest = README.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    template = environment.get_template("readme.md.j2")
    table = template.render(found["adaptive_sampling"], effects=found["effects"])
    texts[README] = f"{before}{BEGIN}\n{table}{END}{after}"
    return texts


def write() -> None:
    for path, text in rendered().items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write()
