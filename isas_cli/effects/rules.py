"""What follows from what a probe measured: each rule gives what is simulated, and why."""

from __future__ import annotations

import math
from collections.abc import Sequence

from .probe import Cut, Lights, Z

# Of the entries that any view sees, the share that may lose all of their derivative.
LOST = 0.01


def worst(cut: Cut) -> float:
    """The 95 % bound of what the unknown that loses most loses of its gradient."""
    return max(share.bound for share in cut.gradient.values())


def depth(cuts: Sequence[Cut], tolerance: float, whole: int) -> tuple[int, str]:
    """The shallowest of the ladder beyond which nothing counts."""
    chosen, why = whole, "all that the scene has"
    for each in reversed(cuts):
        bound = worst(each)
        told = f"longer ones are {_of_gradient(bound)}"
        if bound < tolerance and each.lost > LOST:
            told = f"up to {each.lost:.0%} of the entries may be met by longer ones only"
        if not bound < tolerance or each.lost > LOST:
            return chosen, why if chosen != whole else told
        chosen, why = each.depth, told
    return chosen, why


def derivative(cuts: Sequence[Cut], tolerance: float, whole: int) -> tuple[int, str]:
    """The shallowest of the ladder whose derivative points nearly where the whole one does."""
    for each in cuts:
        if worst(each) < tolerance and each.lost <= LOST:
            return each.depth, f"longer ones are up to {worst(each):.0%} of a gradient"
    last = cuts[-1]
    if worst(last) < tolerance:
        return whole, f"up to {last.lost:.0%} of the entries may be met by longer ones only"
    return whole, f"longer than {last.depth} are {_of_gradient(worst(last))}"


def lights(samples: Sequence[Lights]) -> tuple[Lights, str]:
    """Of the fewest samples, what has the least noise × time; and more where that is surely (95 %)
    better: more samples make fewer steps, and a run needs steps as well. Of those that are as good
    within their errors, the most: noise is what the residual is at a run's end, and earlier the
    derivative's own noise counts for more. The first is what others are compared with, and taken
    where its noise is no number, as where nothing gives light."""
    first, samples = samples[0], [s for s in samples if math.isfinite(s.noise)]
    if first not in samples or len(samples) < 2:
        return first, "not measured"
    fewest, more = (
        [s for s in samples if (s.samples == samples[0].samples) == few] for few in (True, False)
    )
    single = min(fewest, key=_product)

    def surely_better(s: Lights) -> bool:
        error = math.hypot(s.error * s.time, single.error * single.time)
        return _product(s) + Z * error < _product(single)

    sure = list(filter(surely_better, more))
    best = single
    if sure:
        least = min(map(_product, sure))
        alike = [s for s in sure if (s.noise - s.error) * s.time <= least]
        best = max(alike, key=lambda s: sum(s.samples))
    others = "; ".join(f"{_named(s)}: {_product(s):.2f}" for s in samples if s is not best)
    return best, f"noise × time {_product(best):.2f} ({others})"


def _product(lights: Lights) -> float:
    return lights.noise * lights.time


def _named(lights: Lights) -> str:
    picked = f" picked from {lights.directions}" if lights.directions > 1 else ""
    return f"{lights.samples[0]} and {lights.samples[1]}{picked}"


def caustics(without: Cut, tolerance: float) -> tuple[bool, str]:
    """Whether they are simulated."""
    bound = worst(without)
    if bound < tolerance and without.lost > LOST:
        return True, f"up to {without.lost:.0%} of the entries may be met by them alone"
    return not bound < tolerance, _of_gradient(bound)


def _of_gradient(bound: float) -> str:
    if math.isinf(bound):
        return "an unknown part of a gradient"
    return f"up to {bound:.2%} of a gradient (95 % bound)"
