"""Sensors as a file has them: what they cut away, whether 32 bits tell places apart there, and
whether rays leave what they see near its surface."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .ray_offset import above

# Rays along a side of a picture, the share of them that may be cut off, and pixels by which places
# may lie off.
_SIDE, _CUT, _OFF = 32, 0.01, 0.25


def doubts(scene: mi.Scene) -> list[str]:
    """What should be said of the sensors of ``scene``. Traces some rays."""
    found, hits = [], []
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
        dr.eval(hit)
        hits.append([_numbers(each) for each in (hit.shape, hit.instance)])
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
    return found + _above(scene, hits)


def _above(scene: mi.Scene, hits: list[list[np.ndarray]]) -> list[str]:
    """Of the shapes that ``hits`` meet, what should be said of the one that rays leave farthest
    above its surface, by its own size."""
    worst = 0.0, ""
    for shape in scene.shapes():
        low, high = (np.array(each, float).ravel() for each in (shape.bbox().min, shape.bbox().max))
        size, far = float(np.linalg.norm(high - low)), np.abs([low, high]).max()
        if found := above(size, far, "all that the scene holds"):
            own = _numbers(mi.ShapePtr(shape))
            if any((np.stack(each) == own).any(axis=0).mean() > _CUT for each in hits):
                worst = max(worst, (found[0], f"shape {shape.id()} {found[1]}"))
    return [worst[1]] if worst[1] else []


def _numbers(shapes: mi.ShapePtr) -> np.ndarray:
    return np.array(dr.reinterpret_array(mi.UInt32, shapes))
