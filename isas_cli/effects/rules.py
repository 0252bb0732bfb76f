"""What follows from what a probe measured: each rule gives what is simulated, and why."""

from __future__ import annotations

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
        told = f"longer ones are up to {bound:.2%} of a gradient (95 % bound)"
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
    return whole, f"longer than {last.depth} are up to {worst(last):.0%} of a gradient"


def lights(samples: Sequence[Lights]) -> tuple[tuple[int, int], str]:
    """The number with the least noise × time of those that are surely (95 %) better than one each:
    more samples make fewer steps, and a run needs steps as well. Of those that are as good within
    their errors, the most: noise is what the residual is at a run's end, and earlier the
    derivative's own noise counts for more."""
    if len(samples) < 2:
        return (1, 1), "not measured"
    sure = [s for s in samples[1:] if (s.noise + Z * s.error) * s.time < 1]
    if not sure:
        least = min(s.noise * s.time for s in samples[1:])
        return (1, 1), f"more would not surely pay, noise × time {least:.2f} of that with one each"
    least = min(s.noise * s.time for s in sure)
    alike = [s for s in sure if (s.noise - s.error) * s.time <= least]
    best = max(alike, key=lambda s: sum(s.samples))
    return best.samples, f"noise × time {best.noise * best.time:.2f} of that with one each"


def caustics(without: Cut, tolerance: float) -> tuple[bool, str]:
    """Whether they are simulated."""
    bound = worst(without)
    if bound < tolerance and without.lost > LOST:
        return True, f"up to {without.lost:.0%} of the entries may be met by them alone"
    return not bound < tolerance, f"up to {bound:.2%} of a gradient (95 % bound)"
