"""Unknowns whose result lies at an end of its range, which is more often a way lost than found."""

from __future__ import annotations

import numpy as np

from ..unknowns.unknowns import Unknowns

# Numbers of an unknown at most, of which this is said: of a texture some texels are black.
_FEW = 16
_NEAR = 1e-6


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


def _at(numbers: np.ndarray, end: float) -> np.ndarray:
    return np.abs(numbers - end) <= 2 * _NEAR * max(1.0, abs(end))
