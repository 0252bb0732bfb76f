"""Results that are more often a way lost than found: at an end of a range, or off the outline."""

from __future__ import annotations

import numpy as np

from ..unknowns.unknowns import Unknowns
from .evaluate import OUTLINE

# Numbers of an unknown at most, of which this is said: of a texture some texels are black.
_FEW = 16
_NEAR = 1e-6
# Of an outline's distance from alpha or masks, as a share of their area: what is said.
_OFF = 0.05


def reached(unknowns: Unknowns, values: dict) -> list[str]:
    """What is to be said of ``values``, the leaves by key. Nothing of a truth that lies there."""
    said = []
    for unknown in unknowns:
        if unknown.start.size > _FEW:
            continue
        found = unknown.kind.whole(values[unknown.key]).reshape(-1)
        begun = unknown.start.reshape(-1)
        for word, end in (("low", unknown.low), ("high", unknown.high)):
            if not np.isfinite(end):
                continue
            there = _at(found, end)
            if unknown.truth is not None:
                there &= ~_at(unknown.truth.reshape(-1), end)
            if not there.any():
                continue
            which = "" if there.all() else f", {there.sum()} of its {there.size} numbers"
            stayed = _at(begun, end)[there].all()
            more = (
                ", where it began: there may be a better place that no small step leads to, "
                "which a start inside may find"
            )
            said.append(
                f"'{unknown.key}' ended at the {word} end of its range, {end:.4g}{which}"
                f"{more if stayed else ''}"
            )
    return said


def astray(first: dict, last: dict) -> list[str]:
    """What is to be said of the rows of the start and the end, where alpha or masks are known."""
    before, after = (row.get(OUTLINE, 0.0) for row in (first, last))
    if not after > max(_OFF, 0.5 * before):
        return []
    return [
        f"the object's outline is off alpha or masks by {after:.0%} of their area ({before:.0%} "
        "at the start): shape or pose went astray, or took too small steps; or poses of views, or "
        "masks, are wrong"
    ]


def _at(numbers: np.ndarray, end: float) -> np.ndarray:
    return np.abs(numbers - end) <= 2 * _NEAR * max(1.0, abs(end))
