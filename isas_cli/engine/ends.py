"""Results that are more often a way lost than found: at an end of a range, or off the outline; and
settings that had no part in them."""

from __future__ import annotations

import numpy as np

from ..config.schema import OptimizerConfig
from ..runtime.schedule import TO_FINAL
from ..unknowns.parameters import as_numpy
from ..unknowns.unknowns import Unknown, Unknowns
from .evaluate import OUTLINE
from .optimiser import FEW, Stepper

_NEAR = 2e-6  # of an unknown's size, what is at an end
# Of an outline's distance from alpha or masks, as a share of their area: what is said.
_OFF = 0.05
# Of the way that steps could have gone, all in one direction, what is said; after so many.
_STRAIGHT, _STEPS = 0.6, 50
# Of the images' error at the start, what is as much at the end.
_SAME = 0.99
_BRIGHTEST = 0.2  # of the texels that views see, what is said where they are as bright as can be


def reached(unknowns: Unknowns, values: dict) -> list[str]:
    """What is to be said of ``values``, the leaves by key. Nothing of a truth that lies there."""
    said = []
    for unknown in unknowns:
        if unknown.start.size > FEW:
            if unknown.kind.texture is not None and unknown.kind.role == "colour":
                said += _bright(unknown, unknown.kind.whole(values[unknown.key]))
            continue
        found = unknown.kind.whole(values[unknown.key]).reshape(-1)
        begun = unknown.start.reshape(-1)
        for word, end in (("low", unknown.low), ("high", unknown.high)):
            if not np.isfinite(end):
                continue
            there = _at(found, end, unknown)
            if unknown.truth is not None:
                there &= ~_at(unknown.truth.reshape(-1), end, unknown)
            if not there.any():
                continue
            which = "" if there.all() else f", {there.sum()} of its {there.size} numbers"
            stayed = _at(begun, end, unknown)[there].all()
            more = (
                ", where it began: there may be a better place that no small step leads to, "
                "which a start inside may find"
            )
            said.append(
                f"'{unknown.key}' ended at the {word} end of its range, {end:.4g}{which}"
                f"{more if stayed else ''}"
            )
    return said


def _bright(unknown: Unknown, found: np.ndarray) -> list[str]:
    """Where many texels ``(H, W, C)`` that views see came to the high end of their range."""
    high = unknown.high
    there = _at(found, high, unknown) & ~_at(unknown.start, high, unknown)
    if unknown.truth is not None:
        there &= ~_at(unknown.truth, high, unknown)
    seen = np.ones(found.shape, bool) if unknown.seen is None else unknown.seen
    share = (there & seen).any(axis=2).sum() / max(seen.any(axis=2).sum(), 1)
    if share <= _BRIGHTEST:
        return []
    return [
        f"'{unknown.key}': {share:.0%} of its texels that views see ended at the high end of its "
        f"range, {high:.4g}: the light is probably too dark for the images, or in another "
        "unit than they are"
    ]


def underway(stepper: Stepper) -> list[str]:
    """What is to be said of few numbers that still moved as fast as their rates let them."""
    said, led = [], {each.size for each in stepper.unknowns.together}
    if stepper.steps - stepper.since < _STEPS:
        return []
    for key, begun in stepper.begun.items():
        unknown, reach = stepper.unknowns[key], stepper.reach[key]
        now = as_numpy(stepper.values[key])
        moved = float(np.abs(now - begun).max())
        # A way that is shorter the other way round, or that ended at an end, is another matter.
        period = unknown.kind.period
        both = [x for x in (unknown.low, unknown.high) if np.isfinite(x)]
        ended = any(_at(now, x, unknown).any() for x in both)
        if (period and moved > period / 2) or ended or key in led:
            continue
        if moved > _STRAIGHT * reach > 0:
            said.append(
                f"'{key}' moved by {moved:.3g}, of the {reach:.3g} that its rate allows, in one "
                "direction: it was still on its way, or came to its end just now; give it a larger "
                "lr, or more time"
            )
    return said


def unheeded(stepper: Stepper) -> list[str]:
    """Settings of how rates fall that no rate follows."""
    every = [(u, stepper.falls[u.key]) for u in stepper.unknowns]
    by = f"rates fall by schedule {' and '.join(sorted({name for _, name in every}))}"
    heeded = {
        "half": (any(name == "inverse" for _, name in every), by),
        "final": (
            any(name in TO_FINAL and u.final is None for u, name in every),
            f"{by}, or to a final of their own",
        ),
        "schedule": (
            any(u.schedule is None for u, _ in every),
            "every unknown has a schedule of its own",
        ),
    }
    said = []
    for name, (heeds, why) in heeded.items():
        asked = getattr(stepper.settings, name)
        if asked != getattr(OptimizerConfig, name) and not heeds:
            said.append(f"optimizer.{name}={asked} has no effect: {why}")
    return said + [
        f"'{u.key}': its final={u.final:g} has no effect: its rate falls by schedule {name}"
        for u, name in every
        if u.final is not None and name not in TO_FINAL
    ]


def stuck(first: dict, last: dict, steps: int) -> list[str]:
    """What is to be said of the rows of the start and the end where images came no nearer."""
    before, after = (row.get("image_rmse", 0.0) for row in (first, last))
    if steps < _STEPS or not after > _SAME * before > 0:
        return []
    return [
        f"image_rmse did not fall ({before:.3g} → {after:.3g}): no step led to images more like "
        "the targets; start nearer to them, blur more widely, or take another rate"
    ]


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


def _at(numbers: np.ndarray, end: float, unknown: Unknown) -> np.ndarray:
    """Which ``numbers`` are at an end of the unknown's range, by the size of that, or of what is
    known of the unknown, where that is less."""
    known = (each for each in (unknown.start, unknown.truth) if each is not None)
    sizes = unknown.high - unknown.low, max(float(np.abs(each).max()) for each in known)
    size = min((each for each in sizes if 0 < each < np.inf), default=0.0)
    return np.abs(numbers - end) <= _NEAR * max(size, abs(end))
