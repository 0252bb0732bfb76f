"""What can be told of a light that is given, before anything is lit by it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...config.photographs import PhotosConfig
from ...runtime import images
from .camera import Camera

# Of its height, how far a picture's width may be from twice that; and pixels.
_OFF, _PIXELS = 0.2, 2
# Cameras, at least; how far their mean up reaches along an axis about which they stand upright, and
# along another that is asked for, at most; how far they roll, in the mean; and their mean right,
# which is shorter the more they stand around.
_FEWEST, _UP, _OTHER, _ROLL, _AROUND = 3, 0.5, 0.3, 0.2, 0.7
_OURS = "isas "  # what writes the lights that a run has found, in the axes that it had


def doubts(settings: PhotosConfig, cameras: list[Camera]) -> list[str]:
    """What should be said of ``photos.environment``. Raises InputError where it is no picture."""
    if settings.environment is None:
        return []
    file, found = Path(settings.environment), []
    width, height = images.size(file)
    if abs(width - 2 * height) > max(_PIXELS, _OFF * height):
        found.append(
            f"photos.environment={file}: {width}×{height} pixels are read as longitude and "
            "latitude, of which a picture is twice as wide as high: convert a light probe's "
            "angular map or a cube's sides to that"
        )
    if images.counted(file):
        full = images.load(file).brightest >= 1
        if full.any() and not full.all():
            found.append(
                f"photos.environment={file}: {np.count_nonzero(full)} of its {full.size} pixels "
                "are as bright as whole numbers can say: light beyond that is cut off, and the "
                "object is found brighter instead: take one of floating-point numbers (EXR, HDR)"
            )
    up = _upright(cameras, settings.up)
    if up is not None and not images.made_by(file).startswith(_OURS):
        found.append(
            f"photos.environment={file}: its up is photos.up={settings.up}, but the cameras stand "
            f"upright about {up}: if that is the world's up, take photos.up={up}"
        )
    return found


def _upright(cameras: list[Camera], asked: str) -> str | None:
    """The axis about which cameras all around stand upright, if it is another than ``asked``."""
    if len(cameras) < _FEWEST:
        return None
    rights, downs = (np.array([c.to_world[:3, axis] for c in cameras]) for axis in (0, 1))
    mean = -downs.mean(axis=0)
    axis = int(np.abs(mean).argmax())
    own = float(mean["xyz".index(asked[-1])]) * (-1 if asked[0] == "-" else 1)
    around = np.linalg.norm(rights.mean(axis=0)) < _AROUND
    upright = abs(mean[axis]) > _UP and np.abs(rights[:, axis]).mean() < _ROLL
    if not (around and upright and own < _OTHER):
        return None
    return ("-" if mean[axis] < 0 else "") + "xyz"[axis]
