"""How far above a surface rays begin that leave it.

Without Mitsuba, which `isas photos` does not load.
"""

from __future__ import annotations

# Mitsuba's RayEpsilon; and of an object's size, how far above it rays may begin that leave it.
_EPSILON, _ABOVE = 1500 * 2.0**-24, 0.01


def above(size: float, far: float, what: str) -> tuple[float, str] | None:
    """Of what is ``size`` units large and lies up to ``far`` from the origin, how far above it rays
    begin that leave it, as a share of its size, and what should be said of that: Mitsuba has them
    begin so far along the normal. None where that is little. ``what``: all that is to be moved."""
    size = max(size, 1e-30)
    offset = (1 + far) * _EPSILON
    if offset <= _ABOVE * size:
        return None
    how = (
        f"take one offset from {what}, so that it lies around the origin"
        if far * _EPSILON > _ABOVE * size
        else f"scale {what} up alike"
    )
    return offset / size, (
        f"is {size:.2g} units large and up to {far:.2g} from the origin: its shadows and bounces "
        f"begin {offset:.2g} units above it, {offset / size:.0%} of its size: {how}"
    )
