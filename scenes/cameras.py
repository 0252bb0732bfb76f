"""Sensors around an object: positions on a sphere, all looking at one point."""

from __future__ import annotations

from typing import Any

import numpy as np

# Successive views turn by the golden angle, so that any number of them spreads evenly.
GOLDEN_ANGLE = 180.0 * (3.0 - 5.0**0.5)


def orbit(
    target: tuple[float, float, float], distance: float, azimuth: float, elevation: float
) -> list[float]:
    """A point at `distance` from `target`; angles in degrees, azimuth 0 on the +z side."""
    a, e = np.radians(azimuth), np.radians(elevation)
    direction = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    return (np.asarray(target) + distance * direction).tolist()


def perspective(
    origin: list[float],
    target: tuple[float, float, float],
    field_of_view: float,
    resolution: int,
) -> dict[str, Any]:
    """A pinhole camera with a square film of `resolution` pixels a side.

    `field_of_view` in degrees. The film has a box filter (a pixel is the plain mean of its
    samples, which sampling by pixels relies on) and keeps float32.
    """
    import mitsuba as mi

    return {
        "type": "perspective",
        "fov": field_of_view,
        "to_world": mi.ScalarTransform4f().look_at(
            origin=origin, target=list(target), up=[0, 1, 0]
        ),
        "film": {
            "type": "hdrfilm",
            "width": resolution,
            "height": resolution,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
    }


def spiral(
    views: int,
    resolution: int,
    target: tuple[float, float, float],
    distance: float,
    field_of_view: float,
    elevations: tuple[float, float],
    azimuth: float = 0.0,
) -> dict[str, Any]:
    """`views` sensors on a spiral, as entries of a scene dictionary.

    The first stands at `azimuth` and the lower of the two `elevations` (degrees), the last at
    the higher one; each next one turns by the golden angle.
    """
    rise = np.linspace(elevations[0], elevations[1], views)
    return {
        f"sensor_{view:03d}": perspective(
            orbit(target, distance, azimuth + view * GOLDEN_ANGLE, rise[view]),
            target,
            field_of_view,
            resolution,
        )
        for view in range(views)
    }
