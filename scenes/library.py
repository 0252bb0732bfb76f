"""The asset files that travel with the scenes, and the pictures among them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..runtime.errors import InputError

ASSETS = Path(__file__).resolve().parent / "assets"

# No dielectric or painted surface reflects less or more than this; it also keeps a texture off
# the ends of its legal range, where projection would hide an error.
DARKEST, BRIGHTEST = 0.02, 0.95


def asset(relative: str) -> Path:
    """Path of a file below the assets folder; InputError when the installation lacks it."""
    path = ASSETS / relative
    if not path.is_file():
        raise InputError(f"asset {relative} is missing from {ASSETS}: install isas again")
    return path


def environment(relative: str, turn: float = 0.0) -> dict[str, Any]:
    """An environment map at its own resolution, turned about the y axis by `turn` degrees.

    Values are clamped to at least 0: resampling left slightly negative pixels around the suns
    of some maps, which would make negative radiance and negative sampling weights.
    """
    import mitsuba as mi

    pixels = _read_linear(asset(relative))
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(np.maximum(pixels, 0.0)),
        "to_world": mi.ScalarTransform4f().rotate([0, 1, 0], turn),
    }


def picture(relative: str, width: int, height: int) -> np.ndarray:
    """An 8-bit picture as linear albedo (height, width, 3) float32, resized by a Lanczos filter."""
    import mitsuba as mi

    bitmap = mi.Bitmap(_read_linear(asset(relative)))
    if (width, height) != tuple(bitmap.size()):
        bitmap = bitmap.resample([width, height])
    return np.clip(np.array(bitmap), DARKEST, BRIGHTEST)


def texture(albedo: np.ndarray) -> dict[str, Any]:
    """A differentiable texture of linear values (H, W, 3) float32."""
    import mitsuba as mi

    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(albedo, dtype=np.float32)),
        # raw: the values are linear already, and float32 data can be differentiated.
        "raw": True,
        "wrap_mode": "clamp",
    }


def _read_linear(path: Path) -> np.ndarray:
    """(H, W, 3) float32, linear: 8-bit pictures are decoded from sRGB."""
    import mitsuba as mi

    bitmap = mi.Bitmap(str(path))
    return np.array(bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False))
