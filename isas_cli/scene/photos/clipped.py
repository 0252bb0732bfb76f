"""Light that is cut off in pictures of floating-point numbers, which say nothing of it."""

from __future__ import annotations

import numpy as np

# Of a picture's pixels the share that has its largest number where light is cut off, at least and
# at most; and what is just below that number, as a share of it.
_NOTABLE, _NEARLY_ALL, _JUST = 0.01, 0.9, 0.02


def cut_off(image: np.ndarray) -> np.ndarray:
    """Where light is cut off in a picture of floating-point numbers, ``(H, W, 3)``: where a channel
    has the largest number that it has anywhere, if more pixels share that than lie just below it
    while their other channels differ, or if it is another's such number; ``(H, W) bool``. A flat
    face or background, all of whose channels are alike, is not."""
    most = image.max(axis=(0, 1))
    full, near = image == most, image >= (1 - _JUST) * most
    cut = []
    for channel in range(image.shape[2]):
        count = np.count_nonzero(full[..., channel])
        share = count / full[..., channel].size
        if (
            not _NOTABLE <= share <= _NEARLY_ALL
            or np.count_nonzero(near[..., channel]) >= 2 * count
        ):
            continue
        others = np.delete(image[full[..., channel]], channel, axis=1)
        low, high = np.percentile(others, (10, 90), axis=0)
        if (high - low).max() > _JUST * most[channel]:
            cut.append(most[channel])
    return full[..., np.isin(most, cut)].any(axis=2)
