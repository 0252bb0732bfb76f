"""Gradients by the edges of shadows against differences of images; what is left out is noticed."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from crosses import some
from isas_cli.scenes import kirby
from isas_cli.scenes.cameras import orbit, perspective
from scenes_for_tests import without_targets
from shapes_for_tests import (
    COUNT,
    KEY,
    agrees,
    ball,
    differences,
    estimates,
    problem,
    screened,
    shaped,
)

from isas_cli import losses
from isas_cli.config.schema import UnknownConfig
from isas_cli.estimators import silhouettes
from isas_cli.estimators.silhouettes import Settings
from isas_cli.rendering import rays
from isas_cli.rendering.shadows import Lamps
from isas_cli.rendering.standing import others
from isas_cli.runtime.errors import InputError

LAMPS = {
    "ball": {
        "type": "sphere",
        "center": [3.0, 1.0, -2.0],
        "radius": 0.3,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [90.0, 90.0, 90.0]}},
    },
    "point": {"type": "point", "position": [3.0, 1.0, -2.0], "intensity": 30.0},
    "sun": {"type": "directional", "direction": [-3.0, -1.4, 2.0], "irradiance": 2.0},
}


def shadow(lamp: str) -> dict:
    """A lamp throws the figure's shadow on a floor, and a disk hides the figure from the camera."""
    place = mi.ScalarTransform4f()
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.8, 0.8]}}
    floor = place.translate([0, -1.1, 0]).rotate([1, 0, 0], -90).scale(6)
    eye = orbit((0, 0, 0), 9.0, 40.0, 50.0)
    near = place.look_at(origin=(np.array(eye) * 8 / 9).tolist(), target=[0, 0, 0], up=[0, 1, 0])
    return {
        "floor": {"type": "rectangle", "to_world": floor, "bsdf": grey},
        "board": {"type": "disk", "to_world": near.scale(0.17), "bsdf": grey},
        "sky": {"type": "constant", "radiance": 0.05},
        "lamp": LAMPS[lamp],
        "sensor_000": perspective(eye, (0, 0, 0), 35.0, 32),
    }


@pytest.mark.parametrize(
    "lamp", ["point", *(pytest.param(each, marks=pytest.mark.slow) for each in ("ball", "sun"))]
)
def test_what_only_a_shadow_shows(lamp):
    """Seen with four times as many: 0.97 ± 0.03, 0.99 ± 0.03, 1.00 ± 0.02 along ``scale``. Without
    samples of shadows' edges nothing is found, which is noticed."""
    p = problem(views=1, **shadow(lamp))
    exact = differences(p, ["right", "scale"])
    found = estimates(p, COUNT, shadows=1 << 16, lamps=64)
    for name, each in exact.items():
        assert agrees(found[name], each), name
    missing = estimates(p, 3, shadows=0)["right"]
    assert abs(missing.mean()) < 0.1 * abs(exact["right"].mean())


def test_views_share_the_samples_of_edges():
    """With a second camera that stands where the first does the gradient is the same."""
    scene = shadow("point")
    one = problem(views=1, **scene)
    both = problem(views=2, **scene, sensor_001=dict(scene["sensor_000"]))
    both.set_targets(dr.tile(one.targets, 2), None, "test")
    exact = differences(one, ["right", "scale"])
    found = estimates(both, COUNT, shadows=1 << 16, lamps=64)
    for name, each in exact.items():
        assert agrees(found[name], each), name


def test_what_a_near_clip_plane_cuts_away_hides_no_shadow():
    scene = shadow("point")
    scene |= {"sky": {"type": "constant", "radiance": 0.0}}
    plain, found = (
        estimates(problem(views=1, **scene | more), 2, shadows=1 << 14)
        for more in ({}, screened(scene["sensor_000"], 0.02))
    )
    for name in ("right", "scale"):
        assert np.abs(plain[name]).min() > 1e-4
        np.testing.assert_allclose(found[name], plain[name], rtol=1e-2, err_msg=name)


@pytest.mark.slow  # at this fineness; one that moves before another is in test_silhouettes.py
def test_shapes_that_hide_and_shade_parts_of_themselves():
    """Seen: 0.993 ± 0.004, with shadows' edges or without. Of 642 vertices 0.98: smooth normals are
    black along the silhouettes of coarse meshes, and the inner border of that is not sampled."""
    p = problem(views=2, level=5)
    own = 1.1 * np.array(p.unknowns[KEY].truth)
    exact = differences(p, ["scale"], at=own, spp=256)["scale"]
    assert agrees(estimates(p, COUNT, batch=1 << 16, at=own)["scale"], exact)


# A large ball, and a small one that throws its shadow on it: fine ones, as smooth normals are black
# along the silhouettes of coarse meshes, and the inner border of that is not sampled.
LARGE = ball(5, 0.7)[0] + [0, -0.3, 0], ball(5)[1]
SMALL = ball(5, 0.3)[0] + [0.3, 1.1, 0.2], ball(5)[1]


def lit() -> dict:
    return {
        "sky": {"type": "constant", "radiance": 0.05},
        "lamp": {"type": "point", "position": [2.0, 3.5, -0.5], "intensity": 30.0},
        "sensor_000": perspective(orbit((0, 0.2, 0), 4.5, 0.0, 35.0), (0.0, 0.2, 0.0), 35.0, 32),
    }


@pytest.mark.slow  # what stands still on what moves is below
def test_the_shadow_of_one_part_on_another():
    """Seen with twice as many: 1.02 ± 0.03 of the small one's, 0.97 ± 0.02 of the large one's, of
    balls of a quarter of the triangles 1.00 ± 0.03 and 0.955 ± 0.015; without shadows' edges 0.83
    and 0.90."""
    both = shaped(
        np.concatenate([LARGE[0], SMALL[0]]),
        np.concatenate([LARGE[1], SMALL[1] + len(LARGE[0])]),
    )
    p = problem(views=1, start="smooth", figure=both, **lit())
    at = 1.08 * p.unknowns[KEY].truth
    small = (at[:, 1:2] > 0.6).astype(np.float64)
    assert small.sum() == len(SMALL[0])
    ways = {"small": small * [1.0, 0, 0], "large": (1 - small) * [1.0, 0, 0]}
    exact = differences(p, at=at, ways=ways)

    def right(**settings) -> list[bool]:
        found = estimates(p, COUNT, batch=1 << 16, at=at, ways=ways, **settings)
        return [agrees(found[name], exact[name]) for name in ways]

    assert all(right())
    assert not all(right(shadows=0))


def towards_the_lamp(size: float) -> mi.ScalarTransform4f:
    """Over the large ball, across the light of ``lit``."""
    place = mi.ScalarTransform4f()
    return place.look_at([0.3, 1.1, 0.2], target=[2.0, 3.5, -0.5], up=[0, 0, 1]).scale(size)


HATS = {
    "mesh": lambda: shaped(*SMALL, "hat"),
    "sphere": lambda: {"type": "sphere", "center": [0.3, 1.1, 0.2], "radius": 0.3},
    "rectangle": lambda: {"type": "rectangle", "to_world": towards_the_lamp(0.22)},
    "disk": lambda: {"type": "disk", "to_world": towards_the_lamp(0.25)},
}


def beside() -> dict:
    """Below the ball, and beside all ways of the lamp's light to it."""
    place = mi.ScalarTransform4f().translate([0, -2, 0]).rotate([1, 0, 0], -90).scale(4)
    return {
        "floor": {"type": "rectangle", "to_world": place},
        "stone": {"type": "sphere", "center": [-2.0, 0.2, 0.5], "radius": 0.4},
    }


@pytest.mark.parametrize("hat", some([*HATS], ("rectangle",)))
def test_the_shadow_of_what_stands_still_on_what_moves(monkeypatch, hat):
    """Seen: 1.01 ± 0.03 and 0.98 ± 0.02, without these shadows' edges 0.61 and 0.74."""
    p = problem(
        views=1, start="smooth", figure=shaped(*LARGE), hat=HATS[hat](), **beside(), **lit()
    )
    alone = problem(views=1, start="smooth", figure=shaped(*LARGE), hat=HATS[hat](), **lit())
    assert others(p)[1].count == others(alone)[1].count, "what is not in the way is left out"
    at = 1.08 * p.unknowns[KEY].truth
    exact = differences(p, ["up", "scale"], at=at)

    def right() -> list[bool]:
        found = estimates(p, COUNT, batch=1 << 16, at=at, lamps=1)
        return [agrees(found[name], exact[name]) for name in exact]

    assert all(right())
    if hat == "rectangle":
        monkeypatch.setattr(silhouettes, "others", lambda problem: None)
        assert not any(right())


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize("turned", [0, 70])
def test_a_sphere_lights_what_its_solid_angle_says(turned, inside):
    """However it is turned; with its normals inwards what is in it."""
    place = mi.ScalarTransform4f().translate([3.0, 1.0, -2.0]).rotate([0.6, 0.8, 0], turned)
    shape = {"type": "sphere", "to_world": place.scale(0.5), "flip_normals": inside}
    shape |= {"emitter": {"type": "area", "radiance": 2.0}}
    count, scene = 1 << 16, mi.load_dict({"type": "scene", "lamp": shape})
    lamps = Lamps.draw(scene.emitters(), np.zeros(3), count, rays.stream(mi.UInt32(1), count))
    away = 0.2 if inside else 0.6
    point = dr.zeros(mi.Point3f, count) + [3.0 + away, 1.0, -2.0]
    _, light = lamps.light(dr.arange(mi.UInt32, count), point, mi.Bool(True))
    found = np.array(light[0], np.float64)
    whole = 2 if inside else 1 - np.sqrt(1 - (0.5 / away) ** 2)
    error = found.std() * np.sqrt(count)
    print(found.sum() / (4 * np.pi * whole), error)
    assert abs(found.sum() - 4 * np.pi * whole) < 4 * error


@pytest.mark.parametrize("hat", ["mesh", "rectangle"])
def test_what_is_flat_stands_as_it_is(hat):
    """The triangles, and of a rectangle two, of the same area."""
    scene = kirby.build(1, 8, 1) | lit() | {"hat": HATS[hat]()}
    positions, topology = others(without_targets(scene, {KEY: UnknownConfig(start="sphere")}))
    points = np.array(positions, np.float64).reshape(-1, 3)
    a, b, c = np.moveaxis(points[topology.first[topology.faces]], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    whole = HATS[hat]()
    whole = whole if isinstance(whole, mi.Shape) else mi.load_dict(whole)
    assert area == pytest.approx(whole.surface_area(), rel=1e-4)


@pytest.mark.parametrize("hat, radius, missed", [("sphere", 0.3, 1.2e-3), ("disk", 0.25, 8e-5)])
def test_triangles_stand_around_a_sphere_and_a_disk(hat, radius, missed):
    """Nowhere in it, and about as near to it as standing.py says."""
    scene = kirby.build(1, 8, 1) | lit() | {"hat": HATS[hat]()}
    p = without_targets(scene, {KEY: UnknownConfig(start="sphere")})
    positions, topology = others(p)
    points = np.array(positions, np.float64).reshape(-1, 3) - [0.3, 1.1, 0.2]
    away = np.linalg.norm(points, axis=1).max() / radius - 1
    if hat == "sphere":
        a, b, c = np.moveaxis(points[topology.first[topology.faces]], 1, 0)
        across = np.cross(b - a, c - a)
        near = np.abs(np.einsum("ij,ij->i", a, across)) / np.linalg.norm(across, axis=1)
    else:
        following = np.roll(points, -1, axis=0)  # along the border
        near = np.linalg.norm(np.cross(points, following), axis=1)
        near /= np.linalg.norm(following - points, axis=1)
    print("radii from", near.min() / radius, "to 1 +", away)
    assert near.min() / radius > 1 - 1e-5 and away < missed


def test_points_are_shared_out_over_lamps():
    lamps = {f"lamp_{n}": {"type": "point", "position": [n, 1.0, 0.0]} for n in range(3)}
    emitters = mi.load_dict({"type": "scene", **lamps}).emitters()
    found = Lamps.draw(emitters, np.zeros(3), 8, rays.stream(mi.UInt32(1), 8))
    assert np.array(found.density).tolist() == [3, 3, 2, 3, 3, 2, 3, 3]


def test_shadows_of_very_many_lamps_are_left_out_or_refused():
    lamps = {
        f"lamp_{number}": {"type": "point", "position": [0.02 * number, 4.0, 0.0]}
        for number in range(257)
    }
    p = problem(views=1, side=8, **lamps)
    assert Settings().shadowed(p) == 0
    Settings().on(p, losses.L2())
    assert any("leaves out the edges of the shadows of 25" in line for line in p.warnings)
    with pytest.raises(InputError, match="at most 256 lamps.*take estimator.shadows=0"):
        Settings(shadows=64).on(p, losses.L2())


def test_what_is_followed_is_said():
    mirror = {"type": "rectangle", "bsdf": {"type": "conductor"}}
    scene = kirby.build(1, 8, 1)
    p = without_targets(scene | lit(), {KEY: UnknownConfig(start="sphere")})
    said = Settings(edges=500).derivatives(p)
    assert said.endswith("in the images, and 500 a step of the edges of shadows")
    p = without_targets(scene | {"glossy": mirror}, {KEY: UnknownConfig(start="sphere")})
    said = Settings().derivatives(p)
    assert "none a step of the edges" in said and "by way of glossy are left out" in said
