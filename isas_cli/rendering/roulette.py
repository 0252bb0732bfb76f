"""Russian roulette that leaves the derivatives of dark surfaces alone.

Where a surface scatters next to nothing, a path that meets it carries next to no light, and its
derivative by that surface may be as large as any: roulette by the throughput alone ends it next to
always, and no number of paths that anybody renders shows what is lost. So no surface makes a path
less likely to go on than one of the reflectance ``_DARK`` does.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

# The darkest surface as far as roulette is concerned, and below what a weight is taken for this.
_DARK, _NOTHING = 0.1, 1e-7
# The largest chance to go on.
_MOST = 0.95


def scaled(scale: mi.Float, weight: mi.Spectrum, eta: mi.Float) -> mi.Float:
    """``scale`` after a surface: the throughput times it is what roulette judges by.

    ``weight``: BSDF × cosine over the density; ``eta``: the quotient of the indices of refraction,
    whose square radiance grows with inside a dense body. ``scale`` begins at 1."""
    spared = dr.maximum(1, _DARK / dr.maximum(dr.max(weight), _NOTHING))
    return scale * dr.square(eta) * spared


def chance(throughput: mi.Spectrum, scale: mi.Float) -> mi.Float:
    """Of going on."""
    return dr.minimum(dr.max(throughput) * scale, _MOST)
