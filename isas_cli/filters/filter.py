"""What a filter of gradients is: settings, and of each unknown what it remembers.

Adam's step by an unknown whose entries have neighbours may take account of what these tell. A
filter sees the gradient before Adam does, and Adam's step before it is taken:

    g' = gradient(g),    m, v ← Adam's moments of g',    θ ← moved(θ, m, v, Adam's own new θ)

Entries that no view sees (``Unknown.told``) say nothing: a bitmap is laid out in charts, and the
texels between them belong to no surface. They have no weight in any mean over neighbours, and what
is found for the seen ones reaches them only by `laplacian`'s coarse levels. Charts that touch in
the bitmap are neighbours all the same, wherever they lie on the surface, and both sides of a seam
are none. Where entries hide each other and where objects move the start does not tell what is seen:
there all entries count.

Unknowns without neighbours (``Kind.axes``: numbers, vertices, values at vertices) are left alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.errors import InputError
from ..unknowns.parameters import own
from ..unknowns.unknowns import Unknown


class Layout(NamedTuple):
    """How the entries of an unknown lie: the ``shape`` of its array, which may be coarser than
    whole; ``axes`` as ``Kind.axes``; ``seen``: of each entry 1 where a view sees it, else 0, flat,
    or None where all count."""

    shape: tuple[int, ...]
    axes: tuple[tuple[int, bool], ...]
    seen: mi.Float | None = None

    @staticmethod
    def of(unknown: Unknown, shape: tuple[int, ...], moving: bool) -> Layout:
        """``moving``: whether something in the scene moves. Evaluates."""
        kind, seen = unknown.kind, unknown.seen if unknown.told is None else unknown.told
        if seen is None or seen.all() or kind.hides or moving:
            return Layout(tuple(shape), kind.axes)
        told = kind.coarse(seen.astype(np.float32), shape) > 0
        return Layout(tuple(shape), kind.axes, own(mi.Float, told.ravel().astype(np.float32)))

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))


class Step(NamedTuple):
    """Of one unknown, all flat: its values ``before``; ``after`` by Adam alone; the ``gradient``
    that Adam was given; Adam's moments ``first`` and ``second`` with it; ``corrected``: the rate,
    times what corrects the moments for their start at zero, ``(1,)``; ``share``: what the rate has
    fallen to."""

    before: mi.Float
    after: mi.Float
    gradient: mi.Float
    first: mi.Float
    second: mi.Float
    corrected: mi.Float
    share: float


def along(corrected: mi.Float, first: mi.Float, second: mi.Float) -> mi.Float:
    """``corrected`` m / √(v + ε²), ε as Dr.Jit's Adam has it. Traced."""
    return corrected * first * dr.rsqrt(second + 1e-16)


class OnUnknown:
    """A filter on one unknown. As it stands it changes nothing.

    ``moves``: whether it makes another step of Adam's. ``idle``: whether it changes nothing, as of
    so few entries. ``memory``: what it has of earlier steps, by
    name, flat float arrays; saved with the run. The caller evaluates it.
    """

    moves: bool = False

    def __init__(self, layout: Layout):
        self.layout = layout
        self.idle = type(self) is OnUnknown
        self.forget()

    def forget(self) -> None:
        """As if no step had been. Evaluates."""
        self.memory: dict[str, mi.Float] = {
            name: dr.opaque(mi.Float, 0, width) for name, width in self.remembers().items()
        }

    def remembers(self) -> dict[str, int]:
        """The entries of each array of ``memory``."""
        return {}

    def gradient(self, gradient: mi.Float, share: float) -> mi.Float:
        """What Adam is given for an estimated ``gradient``, finite, flat. Traced, or recorded."""
        return gradient

    def moved(self, step: Step) -> mi.Float:
        """Where it ``moves``: the new values, within no range yet. Traced, or recorded."""
        return step.after


@dataclass(frozen=True)
class Filter:
    """Base of the filters' settings. Each raises InputError, named as on the command line, for a
    setting that is out of range. ``layered``: whether its steps are of all resolutions, so that an
    unknown that passes through levels of its own is left alone."""

    name: ClassVar[str]
    layered: ClassVar[bool] = False

    def on(self, layout: Layout, β: tuple[float, float], masked: bool) -> OnUnknown:
        """The filter on one unknown that has neighbours. ``β``: Adam's, (β₁, β₂); ``masked``:
        whether entries without a gradient rest (``optimizer.mask_updates``). Evaluates."""
        raise NotImplementedError


def within(name: str, value: float, low: float, high: float) -> None:
    """Raises InputError for a setting outside (``low``, ``high``)."""
    if not low < value < high:
        raise InputError(f"optimizer.filter.{name}={value}: must lie in ({low:g}, {high:g})")


def at_least(least: int, name: str, value: int) -> None:
    """Raises InputError for a setting below ``least``."""
    if value < least:
        raise InputError(f"optimizer.filter.{name}={value}: at least {least}")
