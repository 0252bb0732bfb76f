"""How a method is drawn: one style for it in every plot, page and scene."""

from __future__ import annotations

from ..chart import Style
from ..figures import COLOURS
from .gather import Comparison

# After Okabe and Ito's seven: those of Paul Tol's "muted" that are like none of them.
_COLOURS = (*COLOURS, "#332288", "#999933", "#882255", "#44AA99", "#DDCC77", "#CC6677")
_KINDS = 4  # that `Style` knows


def styles(comparison: Comparison) -> dict[str, Style]:
    """A style for each label, in the order in which the methods first appear."""
    labels = dict.fromkeys(method.label for method in comparison.methods)
    return {label: _style(index) for index, label in enumerate(labels)}


def repeated(styles: dict[str, Style]) -> list[str]:
    """A warning where there are more methods than styles."""
    most = len(_COLOURS) * _KINDS
    if len(styles) <= most:
        return []
    return [f"{len(styles)} methods: after {most} their colours and dashes begin again"]


def _style(index: int) -> Style:
    return Style(_COLOURS[index % len(_COLOURS)], index // len(_COLOURS) % _KINDS)
