"""What can be told of a light that is given, before anything is lit by it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...config.photographs import PhotosConfig
from ...runtime import images
from ...scenes.meshes import Surface
from . import brightness
from .camera import Camera

if TYPE_CHECKING:
    from .importing import Photograph

# Of its height, how far a picture's width may be from twice that; and pixels.
_OFF, _PIXELS = 0.2, 2
# Cameras, at least; how far their mean up reaches along an axis about which they stand upright, and
# along another that is asked for, at most; how far they roll, in the mean; and their mean right,
# which is shorter the more they stand around.
_FEWEST, _UP, _OTHER, _ROLL, _AROUND = 3, 0.5, 0.3, 0.2, 0.7
_OURS = "isas "  # what writes the lights that a run has found, in the axes that it had
# How bright an object is shown, the median, as a share of the light's mean: between these it may
# be, black, or white and before a sun that is most of the light; and about so much it usually is.
_SHOWN, _USUAL = (0.02, 4.0), 0.3


def doubts(
    file: Path, up: str | None, cameras: list[Camera], names=("photos.environment=", "photos.up=")
) -> list[str]:
    """What should be said of the light in a ``file``, whose up is the world's axis ``up`` (None:
    each camera's own). ``names``: of the settings that say both. Raises InputError where it is no
    picture."""
    found, (light, upwards) = [], names
    width, height = images.size(file)
    if abs(width - 2 * height) > max(_PIXELS, _OFF * height):
        found.append(
            f"{light}{file}: {width}×{height} pixels are read as longitude and latitude, of which "
            "a picture is twice as wide as high: convert a light probe's angular map or a cube's "
            "sides to that"
        )
    found += images.unheeded([file], [images.doubted(file)])
    if images.counted(file):
        full = images.load(file).brightest >= 1
        if full.any() and not full.all():
            found.append(
                f"{light}{file}: {np.count_nonzero(full)} of its {full.size} pixels are as bright "
                "as whole numbers can say: light beyond that is cut off, and how bright the object "
                "is comes out wrong: take one of floating-point numbers (EXR, HDR)"
            )
    other = None if up is None else _upright(cameras, up)
    if other is not None and not images.made_by(file).startswith(_OURS):
        found.append(
            f"{light}{file}: its up is {upwards}{up}, but the cameras stand upright about {other}: "
            f"if that is the world's up, take {upwards}{other}"
        )
    return found


def unit(
    settings: PhotosConfig, photographs: "list[Photograph]", surface: Surface | None
) -> list[str]:
    """That a light and the pictures are not in one unit, where an unknown base colour would make up
    for it. Raises InputError for a file that is no picture."""
    if settings.environment is None or settings.colour is not None or surface is None:
        return []
    rows = np.maximum(images.read(settings.environment), 0).mean(axis=(1, 2), dtype=np.float64)
    light = np.average(rows, weights=np.sin((np.arange(rows.size) + 0.5) * np.pi / rows.size))
    logs = brightness.shown(photographs, surface)
    if not (light > 0 and np.isfinite(logs).any()):
        return []
    share = float(np.exp(np.nanmedian(logs))) / light
    if _SHOWN[0] <= share <= _SHOWN[1]:
        return []
    how, by = ("multiply", share / _USUAL) if share > _USUAL else ("divide", _USUAL / share)
    return [
        f"photos.environment={settings.environment}: the pictures show the object {share:.2g} "
        "times as bright as the light is in its mean, and surfaces that it lights are between "
        f"{_SHOWN[0]:g} and {_SHOWN[1]:g}: it is probably in another unit than the pictures, and "
        f"the base colour would make up for that: {how} it by about {by:.0f}"
    ]


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
