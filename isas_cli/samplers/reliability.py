"""Whether one look's density can be trusted: what it shares with that of many looks."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .gradient import Gradient
from .sampler import OnImages

# Share of the draws that a density of one look sends elsewhere than that of LOOKS looks. Single
# measurements at the start of five scenes, at two sizes and two batches: `ours` 0.1 to 0.3; on
# caustic_failure 0.8 to 1.
LARGEST = 0.4
LOOKS = 32
_SINGLE = 4  # of them, each by itself against all


def warning(sampler: OnImages, values: dict, seed: int, first: int) -> str | None:
    """A line for the reader where stage 1 of ``sampler`` at ``values`` finds something else with
    every look; None where it does not, or where it has no statistics to tell.

    ``seed``, ``first``: the random streams, of iterations from ``first`` on.
    """
    share = disagreement(sampler, values, seed, first)
    own = getattr(sampler.settings, "base", sampler.settings)
    instead = " or sampler=gradient, whose density rests on means and not on squares"
    if share is None or not share > LARGEST:
        return None
    return (
        f"the sampling density is not to be trusted: {LOOKS} looks together would send {share:.0%} "
        f"of the draws elsewhere than one does (reliable up to {LARGEST:.0%}), as where paths from "
        "the camera find some of the light, such as a small lamp's caustic, only by chance; take "
        f"more paths a cell (stage1.spp){'' if type(own) is Gradient else instead}"
    )


def disagreement(sampler: OnImages, values: dict, seed: int, first: int) -> float | None:
    """Total variation distance between the pmf over cells of one look and that of LOOKS whose
    measurements are averaged, in [0, 1]; the median over some single looks. The uniform share
    (``floor``) is in both."""
    looks = []
    for i in range(LOOKS):
        images = sampler.measured(values, seed, first + i)
        if images is None:
            return None
        looks.append(images)
    pooled = [sum(same, mi.Color3f(0)) / LOOKS for same in zip(*looks)]
    dr.eval(pooled)
    all_ = _pmf(sampler.weighed(pooled))
    distances = [0.5 * np.abs(_pmf(sampler.weighed(i)) - all_).sum() for i in looks[:_SINGLE]]
    return float(np.median(distances)) * (1 - sampler.settings.floor)


def _pmf(weights: mi.Float) -> np.ndarray:
    found = np.array(weights, np.float64)
    found = np.where(np.isfinite(found) & (found > 0), found, 0)
    return found / found.sum() if found.sum() > 0 else np.full(found.shape, 1 / found.size)
