"""Textures and environment maps without detail: held as few texels, whatever their files' size."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..unknowns.parameters import as_numpy, owner, read
from ..unknowns.ranges import fed

# Rows and columns of what is left. Mitsuba draws directions of a map by its texels, of which there
# must be some at every height; a map's columns stand beside copies of the first and the last.
_TEXTURE, _MAP = (1, 1), (16, 34)


def reduce(params: mi.SceneParameters, unknown: set[str]) -> list[str]:
    """Give every texture and map that holds one colour, but for those ``unknown``, the fewest
    texels, in the scene of ``params``. Returns their keys. Lookups give what they gave; they and
    the search for a bright texel touch a few bytes instead of a picture."""
    found = []
    for key in list(params.keys()):
        value = read(params, key)
        if key in unknown or getattr(value, "ndim", 0) != 3:
            continue
        least = _least(owner(params, key))
        # A projector's picture is as wide and high as what it shines on.
        if any(taker.class_name() == "Projector" for taker, _, _ in fed(params, key)):
            continue
        if least is None or value.shape[0] * value.shape[1] <= least[0] * least[1]:
            continue
        if min(value.shape[:2]) < 2:  # which Mitsuba does not change
            continue
        texels = as_numpy(value)
        if np.all(texels == texels[0, 0]):
            params[key] = type(value)(np.broadcast_to(texels[0, 0], (*least, texels.shape[2])))
            found.append(key)
    params.update()
    return found


def _least(holder) -> tuple[int, int] | None:
    """None for what holds no picture: grids of volumes, vertices."""
    if isinstance(holder, mi.Emitter):
        return _MAP
    return _TEXTURE if isinstance(holder, mi.Texture) else None
