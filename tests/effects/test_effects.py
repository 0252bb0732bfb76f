"""What a record says of the light transport: read off the scene, and true of it."""

import mitsuba as mi
import pytest
from scenes_for_tests import TEXTURE, problem

from isas_cli import effects


def plan(depth: int = 4, **more) -> dict[str, str]:
    p = problem({TEXTURE: 0.5}, depth=depth)
    if more:
        p.scene = mi.load_dict({"type": "scene", **more})
    return effects.statements(p, p.integrator.derivatives)


@pytest.mark.parametrize(
    "depth, words",
    [
        (-1, "of any length"),
        (1, "emission only"),
        (2, "no interreflection"),
        (3, "up to 1 bounces"),
        (7, "up to 5 bounces"),
    ],
)
def test_depth_is_told_as_what_it_carries(depth, words):
    assert words in plan(depth)["paths"]


def test_derivatives_are_told_as_the_passes_decide():
    assert "unrolled" in plan(4)["derivatives"] and "replay" in plan(9)["derivatives"]


def test_lights_and_glass_are_those_of_the_scene():
    found = plan()
    assert found["refraction"].startswith("not met") and found["media"].startswith("not met")
    assert found["light"].count("1 ×") == 2, "a sky and a lamp"
    glass = {"type": "sphere", "id": "bell", "bsdf": {"type": "dielectric"}}
    found = plan(bell=glass, lamp={"type": "point", "intensity": 1.0})
    assert found["refraction"] == "simulated: light passes through bell"
    assert found["light"] == "1 × PointLight"


def test_glass_of_a_group_is_met_where_an_instance_shows_it():
    glass = {"type": "sphere", "id": "bell", "bsdf": {"type": "dielectric"}}
    group = {"type": "shapegroup", "one": glass}
    found = plan(group=group, shown={"type": "instance", "of": {"type": "ref", "id": "group"}})
    assert found["refraction"] == "simulated: light passes through bell"
    assert "not met" not in found["caustics"]


def test_media_are_not_passed_off_as_simulated():
    medium = {"type": "homogeneous", "albedo": 0.5, "sigma_t": 1.0}
    fog = {"type": "cube", "bsdf": {"type": "null"}, "interior": medium}
    assert "ignored" in plan(fog=fog, lamp={"type": "point", "intensity": 1.0})["media"]
    group = {"type": "shapegroup", "one": fog}
    found = plan(group=group, shown={"type": "instance", "of": {"type": "ref", "id": "group"}})
    assert "ignored" in found["media"]
