"""How much each view counts: PBDR's several views need not count alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..runtime.errors import InputError

EQUAL = "equal"


def of_views(given, masks: list[np.ndarray], names: Sequence[str] = ()) -> np.ndarray:
    """A factor on the loss of each view, mean 1. ``given``: a number above 0 for each view, or
    `equal`: one over the sum of its mask, so that a view that shows little of the object counts as
    much as one that it fills. ``masks``: the pixels' weights, view by view; ``names``: of the
    views, where they have any. Raises InputError for other numbers, and where a view has no pixel
    that counts."""
    valid = f"{EQUAL}, or a number above 0 for each of the {len(masks)} views"
    if given == EQUAL:
        sums = np.array([mask.sum(dtype=np.float64) for mask in masks])
        if not sums.all():
            number = int(np.flatnonzero(sums == 0)[0])
            view = names[number] if names else number
            raise InputError(f"scene.weights={EQUAL}: nothing of view {view} counts: leave it out")
        weights = 1 / sums
    else:
        try:
            weights = np.array([float(x) for x in given])
        except (TypeError, ValueError):
            raise InputError(f"scene.weights={given}: must be {valid}") from None
        if isinstance(given, str) or weights.size != len(masks):
            raise InputError(f"scene.weights={given}: must be {valid}")
        if not (np.isfinite(weights) & (weights > 0)).all():
            raise InputError(f"scene.weights={list(given)}: must be {valid}")
    return weights / weights.mean()
