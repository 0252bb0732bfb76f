"""How a method is drawn: one colour for it in every plot, page and scene."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ..figures import COLOURS
from .gather import Comparison, Method

# After Okabe and Ito's seven: those of Paul Tol's "muted" that are like none of them.
_COLOURS = (*COLOURS, "#332288", "#999933", "#882255", "#44AA99", "#DDCC77", "#CC6677")
_LINES = (("-", "solid"), ("--", "dash"), (":", "dot"), ("-.", "dashdot"))
_FILLS = (("", ""), ("//", "/"), ("..", "."), ("xx", "x"))


@dataclass(frozen=True)
class Look:
    """A colour and, where there are more methods than colours, another line and fill."""

    colour: str
    line: str  # matplotlib's line style
    dash: str  # the same in Plotly
    hatch: str  # matplotlib's fill of a bar
    pattern: str  # the same in Plotly


def looks(comparison: Comparison) -> dict[str, Look]:
    """A look for each label, in the order in which the methods first appear."""
    labels = dict.fromkeys(method.label for method in comparison.methods)
    return {label: _look(index) for index, label in enumerate(labels)}


def legend(
    canvas: Figure,
    methods: list[Method],
    look: dict[str, Look],
    others: list[Line2D],
    patches: bool = False,
) -> None:
    """One legend below all panels."""
    own = [(method.label, look[method.label]) for method in methods]
    if patches:
        handles = [
            Patch(facecolor=k.colour, hatch=k.hatch, edgecolor="white", label=n) for n, k in own
        ]
    else:
        handles = [Line2D([], [], color=k.colour, linestyle=k.line, label=n) for n, k in own]
    longest = max(len(method.label) for method in methods)
    columns = 6 if longest < 14 else 4 if longest < 22 else 2
    canvas.legend(handles=[*handles, *others], loc="outside lower center", ncols=columns)


def _look(index: int) -> Look:
    kind = index // len(_COLOURS) % len(_LINES)
    return Look(_COLOURS[index % len(_COLOURS)], *_LINES[kind], *_FILLS[kind])
