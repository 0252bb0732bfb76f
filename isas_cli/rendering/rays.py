"""Camera rays for any mix of views in one wavefront."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..runtime import streams
from ..scene.lenses import Lenses
from ..scene.views import Views
from .windows import Windows

_NEWTON = 4  # steps to undo a radial distortion: single precision, of a tenth and more of a picture


def spawn(
    sensors: mi.SensorPtr | Lenses,
    views: Views,
    view: mi.UInt32,
    column: mi.UInt32,
    row: mi.UInt32,
    sampler: mi.Sampler,
) -> tuple[mi.RayDifferential3f, mi.Color3f]:
    """One ray through a random point of each pixel, and its sensor weight.

    ``view``, ``column``, ``row``: ``(N,) uint32``. The point is uniform over the pixel's square,
    which is what a box reconstruction filter measures: a pixel's value is the mean over its own
    square, whatever filter the scene's film names, so pixels are independent and one path
    belongs to one pixel. Traced.
    """
    return through(sensors, views, view, column, row, sampler.next_2d(), sampler.next_2d())


def radiance(integrator, scene: mi.Scene, sensors, views: Views, place, sampler) -> mi.Color3f:
    """What a path through a random point of each pixel brings, times the sensor's weight;
    ``place``: view, column, row. Traced."""
    ray, weight = spawn(sensors, views, *place, sampler)
    return integrator.primal(scene, sampler, ray)[0] * weight


def masked(
    values, mask: mi.Float | None, pixel: mi.UInt32, windows: Windows | None = None
) -> mi.Color3f:
    """``values`` times what their pixels count, or their windows: as the least of their pixels.
    Traced."""
    if mask is None:
        return values
    weight = dr.gather(mi.Float, mask, pixel)
    return values * (weight if windows is None else dr.repeat(windows.least(weight), windows.count))


def sound(values: mi.Color3f, shown: mi.Color3f) -> mi.Color3f:
    """``values``, what a loss says of the radiance ``shown``, and NaN where that is not finite:
    bounded ones would pass for sound. Traced."""
    return dr.select(dr.all(dr.isfinite(shown)), values, dr.nan)


def through(
    sensors: mi.SensorPtr | Lenses,
    views: Views,
    view: mi.UInt32,
    column: mi.UInt32,
    row: mi.UInt32,
    within: mi.Point2f,
    aperture: mi.Point2f,
) -> tuple[mi.RayDifferential3f, mi.Color3f]:
    """The ray through the point ``within`` [0, 1)² of each pixel, and its weight: the sensor's
    times the view's brightness. Traced."""
    width = dr.gather(mi.UInt32, views.width, view)
    height = dr.gather(mi.UInt32, views.height, view)
    position = mi.Point2f(
        (mi.Float(column) + within.x) / mi.Float(width),
        (mi.Float(row) + within.y) / mi.Float(height),
    )
    if isinstance(sensors, Lenses):
        ray, weight = sensors.rays(view, position, aperture)
    else:
        sensor = dr.gather(mi.SensorPtr, sensors, view)
        ray, weight = sensor.sample_ray_differential(0.0, 0.0, position, aperture)
    weight = weight * views.brightness(view)
    if views.lens is not None:
        ray.d = _bent(ray.d, dr.detach(views.lens), views.axes, view)
    if views.motion is not None:
        ray.o, ray.d = _moved(ray, dr.detach(views.motion), view)
    return ray, weight


def _bent(way: mi.Vector3f, lens: mi.Float, axes: mi.Float, view: mi.UInt32) -> mi.Vector3f:
    """Directions of rays through lenses that are otherwise than the sensors' (``Views.lens``):
    where p (1 + k |p|²) (1 + a) + m is what the sensor has for p. Traced."""
    right, down, ahead = (
        mi.Vector3f(*[dr.gather(mi.Float, axes, view * 9 + first + n) for n in range(3)])
        for first in (0, 3, 6)
    )
    longer, across, along, radial = (dr.gather(mi.Float, lens, view * 4 + n) for n in range(4))
    depth = dr.dot(way, ahead)
    x, y = dr.dot(way, right) / depth - across, dr.dot(way, down) / depth - along
    x, y = x / (1 + longer), y / (1 + longer)
    wanted = dr.sqrt(dr.square(x) + dr.square(y))
    radius = mi.Float(wanted)
    for _ in range(_NEWTON):
        bent = radial * dr.square(radius)
        # Beyond where a lens turns round, which none does within a picture, no step goes wild.
        radius -= (radius * (1 + bent) - wanted) / dr.maximum(1 + 3 * bent, 0.1)
    part = dr.select(wanted > 0, radius / dr.maximum(wanted, 1e-20), 1)
    return dr.normalize(right * (x * part) + down * (y * part) + ahead)


def _moved(ray, motion: mi.Float, view: mi.UInt32) -> tuple[mi.Point3f, mi.Vector3f]:
    """Origin and direction of rays whose cameras are turned and shifted. Rays begin a thousandth of
    the way before the camera: that the turn is about there is below a pixel's thousandth. Traced.
    """
    turn, shift = turn_and_shift(motion, view)
    return ray.o + shift, turned(ray.d, turn)


def turn_and_shift(motion: mi.Float, view: mi.UInt32) -> tuple[mi.Vector3f, mi.Vector3f]:
    """Of each camera, from ``Views.motion``. Traced."""
    return tuple(
        mi.Vector3f(*[dr.gather(mi.Float, motion, view * 6 + first + n) for n in range(3)])
        for first in (0, 3)
    )


def turned(way: mi.Vector3f, turn: mi.Vector3f) -> mi.Vector3f:
    """``way`` after a rotation about ``turn`` by its length, radians. Traced and differentiable,
    also where that is 0 and there is no axis."""
    small = dr.squared_norm(turn) < 1e-8
    angle = dr.norm(dr.select(small, mi.Vector3f(1, 0, 0), turn))
    sine = dr.select(small, 1, dr.sin(angle) / angle)
    half = dr.select(small, 0.5, dr.sin(0.5 * angle) / angle)
    across = dr.cross(turn, way)
    return way + sine * across + 2 * dr.square(half) * dr.cross(turn, across)


def seeds(seed: int, iteration: int, *purposes: str) -> list[mi.UInt32]:
    """Of an iteration's streams, opaque: a kernel is not compiled for each."""
    return [dr.opaque(mi.UInt32, streams.seed(seed, iteration, each)) for each in purposes]


def stream(seed: mi.UInt32, count: int) -> mi.Sampler:
    """An independent random stream for ``count`` paths."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    return sampler
