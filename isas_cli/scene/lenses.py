"""Cameras whose rays are made here, from arrays.

Of thin lenses and orthographic cameras Dr.Jit finds no arrays, so kernels that call them cannot be
frozen. Their rays are short formulas, and a pinhole's is the thin lens's without an aperture.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..unknowns.parameters import own, owner

_PINHOLE, _THIN_LENS, _ORTHOGRAPHIC = "PerspectiveCamera", "ThinLensCamera", "OrthographicCamera"
_KNOWN = (_PINHOLE, _THIN_LENS, _ORTHOGRAPHIC)
_BATCH = "BatchSensor"


def of(scene: mi.Scene, views: range, written: Iterable[str] = ()) -> mi.SensorPtr | Lenses:
    """The cameras of a scene's sensors whose numbers are ``views``: as arrays where Mitsuba's
    cannot be frozen and all kinds are known here, else Mitsuba's. ``written``: the parameters that
    unknowns change; where a camera has one, all stay Mitsuba's."""
    sensors = [scene.sensors()[number] for number in views]
    films = [side_by_side(sensor) for sensor in sensors]
    cameras = [camera for film in films for camera in film]
    kinds = {camera.class_name() for camera in cameras}
    places = tuple(f"{sensor.id()}." for sensor in sensors)
    moves = any(name.startswith(places) for name in written)
    if kinds <= {_PINHOLE} or not kinds <= {*_KNOWN} or moves:
        chosen = dr.arange(mi.UInt32, len(views)) + views.start
        return dr.gather(mi.SensorPtr, scene.sensors_dr(), chosen)
    counts = np.array([len(film) for film in films], np.uint32)
    table = np.concatenate([_numbers(camera) for camera in cameras])
    return Lenses(
        own(mi.Float, table.astype(np.float32)),
        own(mi.UInt32, np.cumsum(counts, dtype=np.uint32) - counts),
        own(mi.UInt32, counts),
    )


def only(cameras: mi.SensorPtr | Lenses, views: mi.UInt32) -> mi.SensorPtr | Lenses:
    """Those of some of the views."""
    if isinstance(cameras, Lenses):
        return cameras.only(views)
    return dr.gather(mi.SensorPtr, cameras, views)


@dataclass
class Lenses:
    """``table``: the numbers of each camera, camera after camera (``_SIZES``); ``first``,
    ``count (V,)``: of each view, its first camera and how many there are side by side in its film
    (those of a batch). A plain dataclass, so that Dr.Jit sees the arrays when a kernel is frozen.
    """

    table: mi.Float
    first: mi.UInt32
    count: mi.UInt32

    def only(self, views: mi.UInt32) -> "Lenses":
        """Those of some of the views."""
        first, count = (dr.gather(mi.UInt32, each, views) for each in (self.first, self.count))
        return replace(self, first=first, count=count)

    def rays(
        self, view: mi.UInt32, position: mi.Point2f, aperture: mi.Point2f
    ) -> tuple[mi.RayDifferential3f, mi.Color3f]:
        """As ``Sensor.sample_ray`` makes them at time 0: through ``position`` [0, 1)² of each
        view's film and the point of the lens that ``aperture`` [0, 1)² stands for, and their
        weight. Without differentials, which no material of Mitsuba's uses. Traced."""
        count = dr.gather(mi.UInt32, self.count, view)
        along = position.x * mi.Float(count)
        number = mi.UInt32(along)
        x, camera = along - mi.Float(number), dr.minimum(number, count - 1)
        base = (dr.gather(mi.UInt32, self.first, view) + camera) * _WIDTH

        def numbers(name: str) -> list:
            first, size = _PLACES[name]
            return [dr.gather(mi.Float, self.table, base + first + n) for n in range(size)]

        def vector(name: str, kind=mi.Vector3f):
            return kind(*numbers(name))

        on_film = mi.Point2f(x, position.y) + vector("offset", mi.Point2f)
        near, far, focus, radius, flat = numbers("lens")
        flat = flat > 0
        # A point of the near plane: affine for an orthographic camera, else projective.
        right, down, corner, weights = (vector(n) for n in ("right", "down", "corner", "weights"))
        on_near = mi.Point3f(right * on_film.x + down * on_film.y + corner)
        on_near /= weights.x * on_film.x + weights.y * on_film.y + weights.z
        lens = mi.Point3f(0)
        lens.x, lens.y = radius * mi.warp.square_to_uniform_disk_concentric(aperture)
        way = dr.normalize(mi.Vector3f(on_near * (focus / on_near.z) - lens))
        way = dr.select(flat, mi.Vector3f(0, 0, 1), way)
        per_depth = dr.select(flat, 1, dr.rcp(way.z))

        axes = [vector(name) for name in ("axis_x", "axis_y", "axis_z")]

        def turned(v) -> mi.Vector3f:
            return axes[0] * v.x + axes[1] * v.y + axes[2] * v.z

        ray = dr.zeros(mi.RayDifferential3f)
        ray.d = turned(way)
        ray.d = dr.select(flat, dr.normalize(ray.d), ray.d)  # an orthographic camera may be scaled
        ray.o = mi.Point3f(vector("middle")) + turned(dr.select(flat, on_near, lens))
        ray.o += dr.select(flat, 0, ray.d * (near * per_depth))
        ray.maxt = (far - near) * per_depth
        return ray, mi.Color3f(1)


# What the numbers of a camera mean, and how many there are of each. In its own space: where the
# film's corner, and its sides as seen from there, lie in the near plane, over a weight of its own;
# near and far clip, distance of focus, radius of the aperture, whether it is orthographic. In the
# world: its axes and its middle. On the film: the principal point's offset.
_SIZES = {
    "right": 3,
    "down": 3,
    "corner": 3,
    "weights": 3,
    "lens": 5,
    "axis_x": 3,
    "axis_y": 3,
    "axis_z": 3,
    "middle": 3,
    "offset": 2,
}
_WIDTH = sum(_SIZES.values())
_PLACES = {
    name: (sum(list(_SIZES.values())[:number]), size)
    for number, (name, size) in enumerate(_SIZES.items())
}


def _numbers(camera: mi.Sensor) -> np.ndarray:
    """``_SIZES`` of one camera, float64."""
    kind, params = camera.class_name(), mi.traverse(camera)
    matrix = np.array(camera.projection_transform().inverse().matrix, np.float64).reshape(4, 4)
    world = np.array(camera.world_transform().matrix, np.float64).reshape(4, 4)
    film = camera.film()
    size, crop = (np.array(each, np.float64) for each in (film.size(), film.crop_size()))
    found = {
        "right": matrix[:3, 0],
        "down": matrix[:3, 1],
        "corner": matrix[:3, 3],
        "weights": matrix[3, [0, 1, 3]],
        # A pinhole may focus anywhere.
        "lens": [camera.near_clip(), camera.far_clip(), 1, 0, kind == _ORTHOGRAPHIC],
        "axis_x": world[:3, 0],
        "axis_y": world[:3, 1],
        "axis_z": world[:3, 2],
        "middle": world[:3, 3],
        "offset": [0, 0],
    }
    if kind == _THIN_LENS:
        found["lens"][2:4] = params["focus_distance"][0], params["aperture_radius"][0]
    if kind == _PINHOLE:
        offset = [params[f"principal_point_offset_{axis}"][0] for axis in "xy"]
        found["offset"] = size * offset / crop
    return np.concatenate([np.asarray(found[name], np.float64) for name in _SIZES])


def side_by_side(sensor: mi.Sensor) -> list:
    """The cameras in a sensor's film, from left to right."""
    if sensor.class_name() != _BATCH:
        return [sensor]
    params, found = mi.traverse(sensor), {}
    for key in params.keys():
        holder = owner(params, key)
        # What a camera itself holds has no dot in its name; what it is called may.
        if isinstance(holder, mi.Sensor) and holder is not sensor:
            found.setdefault(key.rpartition(".")[0], holder)
    return list(found.values())
