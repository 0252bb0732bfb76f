"""Where a key is looked at in the census of derivatives, and along which directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isas_cli.unknowns.kind import Kind

# Of a range: half of the longer step inside, and the longer one at an end.
_INSIDE, _AT_END, _WELL_INSIDE = 0.04, 0.03, 0.2
_WIDEST = 10.0  # of the value
# Low and high for parameters of which ``isas`` knows no bound, by the key's words.
_ENDS = {
    "opacity": (0.0, 1.0),
    "weight": (0.0, 1.0),
    "specular_transmittance": (0.0, 1.0),
    "transmittance": (0.0, 1.0),
    "clearcoat": (0.0, 1.0),
    "clearcoat_gloss": (0.0, 1.0),
    "anisotropic": (0.0, 1.0),
    "sheen": (0.0, 1.0),
    "sheen_tint": (0.0, 1.0),
    "spec_tint": (0.0, 1.0),
    "flatness": (0.0, 1.0),
    "diff_trans": (0.0, 2.0),
    "alpha_u": (0.03, 1.0),
    "alpha_v": (0.03, 1.0),
    "eta": (1.1, 2.2),
    "color0": (0.0, 1.0),
    "color1": (0.0, 1.0),
    "vertex_color": (0.0, 1.0),
    "vertex_grey": (0.0, 1.0),
    "face_color": (0.0, 1.0),
    "longitudinal_roughness": (0.1, 0.9),
    "azimuthal_roughness": (0.1, 0.9),
    "cutoff_angle": (20.0, 40.0),
    "beam_width": (5.0, 20.0),
    "normalmap": (0.3, 0.7),
    "nested_texture": (0.0, 1.0),
}
# Keys whose generic value alone says nothing at ends: a point of a map, not of a number.
_GENERIC_ALONE = ("sun_direction", "normalmap", "nested_texture", "S", "theta", "delta")


@dataclass(frozen=True)
class Point:
    """``label``: generic, low or high; ``side``: 0 inside, 1 or -1 where only larger or smaller
    values are legal; ``step``: the longer one; ``span``: what the parameter ranges over."""

    label: str
    value: np.ndarray
    side: int
    step: float
    span: float


def points(key: str, kind: Kind, ends: bool) -> list[Point]:
    """Where a key is looked at."""
    low, high = bounds(key, kind)
    here = kind.present
    # A density may be as high as 1e4, where none would be looked at.
    high = min(high, _WIDEST * float(np.abs(here).max())) if here.any() else high
    span = high - low
    short = _AT_END * span
    # Near 0 a number that is to stay positive means more by its ratios.
    least = min(short, 0.25 * low) if low > 0.01 * span else short
    if not (low < np.min(here) and np.max(here) < high):
        # The file has it at an end, or Mitsuba's default beyond one: generic is inside.
        here = np.clip(here, low + _WELL_INSIDE * span, high - _WELL_INSIDE * span)
    room = min(float(np.min(here)) - low, high - float(np.max(here)))
    found = [Point("generic", here, 0, min(_INSIDE * span, room), span)]
    if ends and not set(key.split(".")) & set(_GENERIC_ALONE):
        found.append(Point("low", np.full_like(here, low), 1, least, span))
        found.append(Point("high", np.full_like(here, high), -1, short, span))
    return found


def bounds(key: str, kind: Kind) -> tuple[float, float]:
    """Lowest and highest value at which a key is looked at: its range, or what is sensible."""
    known = next((_ENDS[word] for word in reversed(key.split(".")) if word in _ENDS), None)
    if known and not (known[0] <= np.min(kind.present) and np.max(kind.present) <= known[1]):
        known = None  # of another plugin: metals have indices below those of glass
    size = float(np.abs(kind.present).max()) or 1.0
    low, high = known or (-size, size)
    if known is None and np.all(kind.present > 0):
        low, high = size / 4, size * 2
    return tuple(
        float(own) if np.isfinite(own) else float(other)
        for own, other in zip(kind.kept(*kind.range), (low, high))
    )


def directions(key: str, kind: Kind) -> dict[str, np.ndarray]:
    """All entries alike, and of arrays each by another amount."""
    found = {"all": np.ones_like(kind.present)}
    if kind.present.size > 3 or key.endswith("_direction"):
        random = np.random.default_rng(kind.present.size)
        found["random"] = random.uniform(0, 2, kind.present.shape).astype(np.float32)
    return found
