"""What sensors of a user's own cut away, places that 32 bits do not tell apart, and rays that begin
far above what they leave."""

import mitsuba as mi
import pytest

from isas_cli.scene import sensor_checks


def scene(far: float = 1e4, at: float = 0.0, size: float = 1.0) -> mi.Scene:
    to = mi.ScalarTransform4f
    clips = {"near_clip": 0.01 * min(size, 1.0), "far_clip": far}
    view = to().look_at([at, 0, 4 * size], [at, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}}
    ball = to().translate([at, 0, 0]).scale(size)
    return mi.load_dict(
        {
            "type": "scene",
            "eye": {"type": "perspective", "to_world": view, "film": film} | clips,
            "sky": {"type": "constant"},
            "ball": {"type": "sphere", "to_world": ball},
        }
    )


def test_a_scene_that_is_seen_whole_and_near_the_origin_is_no_matter():
    assert sensor_checks.doubts(scene()) == []
    assert sensor_checks.doubts(scene(far=20, at=3.0)) == []
    assert sensor_checks.doubts(scene(far=10, size=1e-2, at=1e-1)) == []
    assert sensor_checks.doubts(scene(at=100.0)) == []


def test_what_the_far_plane_cuts_off_is_said():
    (told,) = sensor_checks.doubts(scene(size=5000.0))
    assert told.startswith("sensor eye: its far_clip cuts off the surfaces that ")
    assert "up to 1.9 times as far away" in told
    (some,) = sensor_checks.doubts(scene(far=3.5))
    assert "times as far away" in some


@pytest.mark.parametrize("at", [4e6, -4e6])
def test_coordinates_that_32_bits_do_not_tell_apart_are_said(at):
    told, above = sensor_checks.doubts(scene(at=at))
    assert "what it sees lies 4e+06 units from the origin" in told and "0.25 units apart" in told
    assert "take one offset from all" in told and "take one offset from all" in above


def test_shapes_that_rays_leave_far_above_their_surface_are_said():
    """Mitsuba has shadows and bounces begin 9e-5 (1 + the largest coordinate) units above."""
    (told,) = sensor_checks.doubts(scene(at=1000.0))
    assert told.startswith("shape ball is 3.5 units large and up to 1e+03 from the origin: ")
    assert "begin 0.09 units above it, 3% of its size: take one offset from all" in told
    (told,) = sensor_checks.doubts(scene(far=1, size=1e-3))
    assert "begin 8.9e-05 units above it, 3% of its size: scale all that the scene" in told


@pytest.mark.parametrize("kind", ["radiancemeter", "distant", "irradiancemeter"])
def test_the_rays_of_a_meter_are_no_matter(kind):
    """All are one, or alike: no two pixels are to be told apart."""
    view = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    place = {"direction": [0, 0, -1]} if kind == "distant" else {"to_world": view}
    ball = {"type": "scene", "ball": {"type": "sphere"}, "sky": {"type": "constant"}}
    meter = {"meter": {"type": kind, "film": film} | place}
    if kind == "irradiancemeter":  # which is of the shape that it lies on
        table = mi.ScalarTransform4f().translate([0, 0, 5]).rotate([0, 1, 0], 180)
        meter = {
            "table": {
                "type": "rectangle",
                "to_world": table,
                "sensor": {"type": kind, "film": film},
            }
        }
    made = mi.load_dict(ball | meter)
    assert sensor_checks.doubts(made) == []
