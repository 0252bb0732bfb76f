"""Sensors as a file has them: what they cut away, and whether 32 bits tell places apart there."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

# Rays along a side of a picture, the share of them that may be cut off, and pixels by which places
# may lie off.
_SIDE, _CUT, _OFF = 32, 0.01, 0.25


def doubts(scene: mi.Scene) -> list[str]:
    """What should be said of the sensors of ``scene``. Traces some rays."""
    found = []
    for number, sensor in enumerate(scene.sensors()):
        width = int(sensor.film().crop_size()[0])
        grid = (np.arange(_SIDE) + 0.5) / _SIDE
        place = mi.Point2f(*(each.ravel().astype(np.float32) for each in np.meshgrid(grid, grid)))
        ray, _ = sensor.sample_ray_differential(0.0, 0.5, place, mi.Point2f(0.5))
        beside, _ = sensor.sample_ray_differential(
            0.0, 0.5, place + mi.Point2f(1 / width, 0), mi.Point2f(0.5)
        )
        far = np.broadcast_to(np.array(ray.maxt), place.shape[1])
        ray.maxt = dr.inf
        hit = scene.ray_intersect_preliminary(ray)
        t = np.array(dr.select(hit.is_valid(), hit.t, dr.inf))
        cut = np.isfinite(t) & (t > far)
        name = sensor.id() or f"number {number}"
        if cut.mean() > _CUT:
            found.append(
                f"sensor {name}: its far_clip cuts off the surfaces that {cut.mean():.0%} of its "
                f"rays meet, up to {t[cut].max() / far[cut].min():.2g} times as far away: give it "
                "a larger far_clip"
            )
        points = np.abs(np.array(ray(hit.t))).max(axis=0)
        largest = np.maximum(points, np.abs(np.array(ray.o)).max(axis=0))
        near = np.where(np.isfinite(t), t, 0)
        apart = np.linalg.norm(np.array(ray.d) - np.array(beside.d), axis=0) * near
        apart += np.linalg.norm(np.array(ray.o) - np.array(beside.o), axis=0)
        # The rays of a meter are one, or all alike: its pixels have no width.
        seen = np.isfinite(t) & (apart > 0)
        step = np.spacing(largest[seen].astype(np.float32))
        off = step / np.maximum(apart[seen], 1e-30)
        if seen.any() and np.median(off) > _OFF:
            found.append(
                f"sensor {name}: what it sees lies {np.median(largest[seen]):.3g} units from the "
                f"origin, where numbers of 32 bits are {np.median(step):.2g} units apart, "
                f"{np.median(off):.2g} of its pixels: shapes and derivatives are off by as much; "
                "take one offset from all that the scene holds, so that it lies around the origin"
            )
    return found
