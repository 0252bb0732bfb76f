"""What a plot shows, said once: `static` draws it as a picture, `interactive` for a page.

A chart is a grid of panels, a panel two axes and marks. Positions are data; NaN is a gap.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.ticker import EngFormatter, MaxNLocator

GREY = "#666666"
COST_LABELS = {"seconds": "billed seconds", "paths": "light paths"}


@dataclass(frozen=True)
class Style:
    """How all that belongs to one entry of a legend is drawn.

    kind: 0, or 1 to 3 for another dash of lines and fill of bars where colours run out.
    """

    colour: str
    kind: int = 0


@dataclass(frozen=True)
class Axis:
    """limits: the ends, the left or lower one first; None: what the marks need. ticks: text by
    place; None: the drawer's own."""

    label: str = ""
    limits: tuple[float, float] | None = None
    log: bool = False
    ticks: dict[float, str] | None = None
    grid: bool = True


@dataclass(frozen=True)
class Points:
    """Points (n,) of one entry, joined where ``line``, their width, is above 0.

    low, high: interval (n,) of y (of x where ``sideways``), as a band or as bars. symbol: "", "o"
    or "x". steps: each value holds until the next. words: what the page says of each.
    """

    entry: str
    x: np.ndarray
    y: np.ndarray
    low: np.ndarray | None = None
    high: np.ndarray | None = None
    band: bool = False
    sideways: bool = False
    line: float = 1.6
    symbol: str = ""
    steps: bool = False
    words: Sequence[str] | None = None


@dataclass(frozen=True)
class Bars:
    """Bars of one entry at places (n,), from ``base`` on, ``length`` (n,) upwards (to the right
    where ``sideways``); ``instead`` stands where there is none, NaN. low, high, words: see Points.
    """

    entry: str
    at: np.ndarray
    length: np.ndarray
    base: np.ndarray
    width: float
    low: np.ndarray | None = None
    high: np.ndarray | None = None
    instead: Sequence[str] = ()
    words: Sequence[str] = ()
    sideways: bool = False


@dataclass(frozen=True)
class Rule:
    """A line across the panel at a value of y (of x where ``upright``), with a text at its end."""

    at: float
    text: str = ""
    colour: str = "#999999"
    dotted: bool = False
    upright: bool = False


@dataclass(frozen=True)
class Panel:
    """height: in inches."""

    x: Axis
    y: Axis
    marks: list[Points | Bars | Rule]
    title: str = ""
    height: float = 3.2

    @property
    def placed(self) -> list[Points | Bars | Rule]:
        """The marks without rules that have no place on a logarithmic axis."""

        def lies(mark: Rule) -> bool:
            return mark.at > 0 or not (self.x if mark.upright else self.y).log

        return [mark for mark in self.marks if not isinstance(mark, Rule) or lies(mark)]


@dataclass(frozen=True)
class Chart:
    """A plot. name: of its file; title, note: its heading and how to read it.

    grid: rows of panels, of one length; equal axes move together. alternatives: the panels of a row
    show the same against different costs, so a page shows one of them at a time. styles: by entry,
    in the legend's order.
    """

    name: str
    title: str
    note: str
    grid: list[list[Panel]]
    styles: dict[str, Style] = field(default_factory=dict)
    alternatives: bool = False


def log_axis(label: str, values: np.ndarray, margin: float = 0.06) -> Axis:
    """A logarithmic axis that shows ``values``, with a share of its length as margin; values that
    are not positive are left out, and without any positive one the axis is linear."""
    known = values[np.isfinite(values) & (values > 0)]
    if known.size == 0:
        return Axis(label)
    low, high = float(known.min()), float(known.max())
    room = max((high / low) ** margin, 1.02)
    low, high = low / room, high * room
    return Axis(label, (low, high), True, log_ticks(low, high))


def cost_axis(name: str, cost: np.ndarray) -> Axis:
    """An axis of ``seconds`` or ``paths``, logarithmic over more than two decades.

    The start costs nothing and has no place on a logarithmic axis: draw it as a rule.
    """
    positive = cost[cost > 0]
    if not positive.size:  # stopped after the evaluation of the start
        return Axis(COST_LABELS[name], (-0.05, 1.0), ticks={0.0: "0"})
    if positive.max() > 100 * positive.min():
        return log_axis(COST_LABELS[name], cost, 0.03)
    return _linear(COST_LABELS[name], (-0.03, 1.03), positive.max(), MaxNLocator(6))


def count_axis(values: np.ndarray) -> Axis:
    """An axis of whole numbers from 0."""
    return _linear("", (0, 1.1), max(1.0, values.max()), MaxNLocator(5, integer=True))


def names_axis(names: Sequence[str], label: str = "", least: int = 1) -> Axis:
    """A place for each name, 0, 1, 2 …, and room for ``least`` of them."""
    limits = (-0.6, max(len(names), least) - 0.4)
    return Axis(label, limits, ticks=dict(enumerate(names)), grid=False)


def rows_axis(names: Sequence[str]) -> Axis:
    """A place for each name from the top down."""
    limits = (len(names) - 0.5, -0.5)
    return Axis(limits=limits, ticks=dict(enumerate(names)), grid=False)


def _linear(label: str, ends: tuple[float, float], top: float, locator: MaxNLocator) -> Axis:
    limits = (ends[0] * top, ends[1] * top)
    return Axis(label, limits, ticks={x: _short(x) for x in locator.tick_values(0, limits[1])})


def log_ticks(low: float, high: float) -> dict[float, str]:
    """Texts at 1, 2 and 5 (over three decades and more at powers of ten, eight at most) and beyond
    both ends, as a zoomed-out axis shows these too. Less than half a decade gets evenly spaced
    ones, as these would leave it without any."""
    if high < 3 * low:
        return {x: f"{x:.4g}" for x in MaxNLocator(5).tick_values(low, high) if x > 0}
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    steps = (1, 2, 5) if high < 1e3 * low else (1,)
    every = 1 + (last - first) // 9
    places = [step * 10.0**p for p in range(first - 1, last + 2, every) for step in steps]
    return {place: _short(place) for place in places}


def _short(value: float) -> str:
    """0.002, 50, 200k, 5M, or a power of ten."""
    return EngFormatter(sep="", usetex=False)(value) if 1e3 <= value < 1e12 else f"{value:g}"
