"""Rays that are made from arrays, against Mitsuba's own, ray by ray."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from isas_cli.rendering import rays
from isas_cli.scene import lenses

N = 512


def sensors() -> list[dict]:
    look = mi.ScalarTransform4f().look_at([1, 2, 4], [0.3, -0.2, 0], [0, 1, 0.1])
    scale = mi.ScalarTransform4f().scale
    film = {"type": "hdrfilm", "width": 30, "height": 20}
    crop = {"crop_width": 11, "crop_height": 7, "crop_offset_x": 5, "crop_offset_y": 9}
    cropped = film | crop
    pinhole = {"type": "perspective", "to_world": look, "fov": 33, "near_clip": 0.3}
    offset = {"principal_point_offset_x": 0.13, "principal_point_offset_y": -0.2}
    thin = {"type": "thinlens", "to_world": look, "aperture_radius": 0.3, "focus_distance": 2.7}
    flat = {"type": "orthographic", "to_world": look @ scale([2, 3, 1.5]), "near_clip": 0.5}
    parts = {"a": {"type": "orthographic", "to_world": look}, "b": thin, "c": pinhole | offset}
    return [
        pinhole | {"film": film} | offset,
        pinhole | {"film": cropped} | offset,
        thin | {"film": film, "fov": 50, "near_clip": 0.5, "far_clip": 70},
        thin | {"film": cropped, "fov": 50, "fov_axis": "y"},
        flat | {"film": film},
        flat | {"film": cropped, "far_clip": 9},
        {"type": "batch", "film": film} | parts,
    ]


def scene(described: list[dict]) -> mi.Scene:
    named = {f"view_{number}": each for number, each in enumerate(described)}
    return mi.load_dict({"type": "scene", **named}, optimize=False)


def difference(found, true) -> float:
    """The largest, over the largest of ``true``."""
    found, true = np.array(found), np.array(true)
    return np.abs(found - true).max() / np.abs(true).max()


def compare(made: mi.Scene, cameras: lenses.Lenses, views: list[int], rng) -> None:
    position = mi.Point2f(rng.random((2, N), np.float32))
    aperture = mi.Point2f(rng.random((2, N), np.float32))
    # In one wavefront, whatever their kinds.
    view = rng.integers(len(views), size=N).astype(np.uint32)
    ray, weight = cameras.rays(mi.UInt32(view), position, aperture)
    everywhere = dr.zeros(mi.Float, N)
    for number, sensor in enumerate(views):
        own = view == number
        true, of_sensor = made.sensors()[sensor].sample_ray(0, 0, position, aperture)
        for name in ("o", "d", "maxt"):
            pair = (getattr(each, name) + everywhere for each in (ray, true))
            found, right = (np.array(each)[..., own] for each in pair)
            assert difference(found, right) < 1e-6, (sensor, name)
        assert np.all(np.array(of_sensor + everywhere) == 1)
    assert np.all(np.array(weight) == 1) and np.all(np.array(ray.time) == 0)


def test_rays_are_those_of_mitsuba(rng):
    made = scene(sensors())
    cameras = lenses.of(made, range(7))
    compare(made, cameras, list(range(7)), rng)
    compare(made, lenses.only(cameras, mi.UInt32([6, 2, 4])), [6, 2, 4], rng)
    compare(made, lenses.of(made, range(3, 7)), [3, 4, 5, 6], rng)


def test_pinholes_and_what_moves_stay_mitsubas():
    made = scene(sensors())
    assert not isinstance(lenses.of(made, range(2)), lenses.Lenses)
    assert isinstance(lenses.of(made, range(3), ["view_5.to_world"]), lenses.Lenses)
    for moved in ("view_2.to_world", "view_6.b.to_world"):
        cameras = lenses.of(made, range(7), [moved])
        assert isinstance(cameras, mi.SensorPtr) and dr.width(cameras) == 7


@pytest.mark.parametrize("kind", ["distant", "radiancemeter"])
def test_kinds_that_are_not_known_stay_mitsubas(kind):
    film = {"type": "hdrfilm", "width": 1, "height": 1}
    made = scene([*sensors(), {"type": kind, "film": film}])
    assert isinstance(lenses.of(made, range(8)), mi.SensorPtr)
    assert isinstance(lenses.of(made, range(7)), lenses.Lenses)


@pytest.mark.parametrize("angle", [0.0, 2e-5, 3e-4, 0.3])
def test_turns_have_their_derivatives_where_they_begin_too(angle):
    way, at, step = [0.2, -0.5, 0.8], angle * np.array([0.6, -0.48, 0.64]), 1e-4
    for axis in np.eye(3):
        x = mi.Float(0)
        dr.enable_grad(x)
        turn = mi.Vector3f(at.tolist()) + x * mi.Vector3f(axis.tolist())
        found = rays.turned(mi.Vector3f(way), turn)
        dr.forward(x)
        low, middle, high = (
            Rotation.from_rotvec(at + s * axis).apply(way) for s in (-step, 0, step)
        )
        np.testing.assert_allclose(np.array(dr.detach(found)).ravel(), middle, atol=1e-6)
        slope = (high - low) / (2 * step)
        np.testing.assert_allclose(np.array(dr.grad(found)).ravel(), slope, atol=1e-4)
