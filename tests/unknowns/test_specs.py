"""What is said of the unknowns, against the scene: ranges, starts, and what cannot be one."""

import mitsuba as mi
import numpy as np
import pytest
from lit_scene import SKY, STARTS, UNDER, lit
from omegaconf import OmegaConf
from scenes_for_tests import dictionary

from isas_cli.config.compose import compose, translate
from isas_cli.config.schema import BlurConfig, UnknownConfig
from isas_cli.runtime.errors import InputError
from isas_cli.unknowns import registry
from isas_cli.unknowns.kind import Loaded
from isas_cli.unknowns.specs import narrow_blurs, parse


def parsed(description: dict, specs: dict, truth_known: bool = True):
    params = mi.traverse(mi.load_dict(description, optimize=False))
    specs = {key: UnknownConfig(**spec) for key, spec in specs.items()}
    return {u.key: u for u in parse(params, specs, truth_known)}


def test_ranges_unless_given():
    colour, positive = (0.0, 1.0), (0.0, np.inf)
    expected = {
        "map": {
            "floor.bsdf.base_color.data": colour,
            "wall.bsdf.base_color.value": colour,
            "wall.bsdf.roughness.value": (0.03, 1.0),
            "wall.bsdf.metallic.value": colour,
            "lamp.emitter.radiance.value": positive,
            "bulb.intensity.value": positive,
            "sky.data": positive,
            "sky.scale": positive,
        },
        "constant": {
            "sky.radiance.value": positive,
            "sun.irradiance.value": positive,
            "spot.intensity.value": positive,
        },
    }
    for sky, ranges in expected.items():
        found = parsed(lit(sky), {key: {"start": 0.5} for key in ranges})
        # A hair from where there is no derivative.
        near = {key: pytest.approx(each, abs=2e-3) for key, each in ranges.items()}
        assert {key: (u.low, u.high) for key, u in found.items()} == near
    own = parsed(lit("map"), {"sky.data": {"start": 0.5, "range": [0.1, 0.9], "lr": 0.3}})
    assert (own["sky.data"].low, own["sky.data"].high, own["sky.data"].lr) == (0.1, 0.9, 0.3)
    stages = [0, 0.5, 0.6, 1]
    own = {"start": 0.5, "schedule": "cosine", "final": 0.3, "prior": 2.0, "during": stages}
    found = parsed(lit("map"), {"sky.data": own, "sky.scale": {"start": 0.5}})["sky.data"]
    assert (found.schedule, found.final, found.prior) == ("cosine", 0.3, 2.0)
    assert list(found.during) == stages
    with pytest.raises(InputError, match="outside its range"):
        parsed(lit("map"), {"sky.data": {"start": -0.1}})
    with pytest.raises(InputError, match="zero everywhere"):
        parsed(lit("map"), {"sky.data": {"start": 0}})
    with pytest.raises(InputError, match="does not fit the parameter's shape"):
        parsed(lit("map"), {"sky.data": {"start": []}})


def test_what_moves_geometry_stays_refused():
    for sky in ("map", "constant"):
        params = mi.traverse(mi.load_dict(lit(sky), optimize=False))
        valid = list(registry.offered(Loaded(params)))
        assert set(STARTS) | set(UNDER[sky]) <= set(valid)
        for key in valid:
            assert not key.endswith(("to_world", "position", "direction", "center"))
    with pytest.raises(InputError, match="'wall.to_world' moves geometry"):
        parsed(lit("map"), {"wall.to_world": {"start": 0}})
    for key in ("sky.to_world", "bulb.position"):
        told = f"'{key}' is no differentiable parameter: scene.poses moves '{key.split('.')[0]}'; "
        with pytest.raises(InputError, match=told):
            parsed(lit("map"), {key: {"start": 0}})


@pytest.mark.parametrize("kind", ["bsplinecurve", "linearcurve", "cube"])
def test_what_moves_geometry_says_what_moves_it_instead(tmp_path, kind):
    thing, key = {"type": kind}, "it.vertex_positions"
    told = "move the object by .*, or find its shape, 'it.vertices', by estimator=silhouettes"
    if kind != "cube":
        points = "".join(f"{x} 0 0 0.1\n" for x in range(5))
        (tmp_path / "curve.txt").write_text(points)
        thing, key = thing | {"filename": str(tmp_path / "curve.txt")}, "it.control_points"
        told = "move an instance of a shapegroup with it by scene.poses"
    with pytest.raises(InputError, match=f"'{key}' moves geometry.*{told}"):
        parsed({"type": "scene", "it": thing}, {key: {"start": 0}})


def two_floors() -> dict:
    """Two textures of one size, one of another, and a map of the size of none."""
    scene = lit("map")
    for name, size in (("other", 4), ("fine", 8)):
        scene[name] = dictionary(size=size)["floor"] | {
            "to_world": mi.ScalarTransform4f().translate([5, 0, 0])
        }
    texels = np.random.default_rng(8).uniform(0.2, 0.8, (4, 4, 3)).astype(np.float32)
    scene["other"]["bsdf"]["base_color"]["data"] = mi.TensorXf(texels)
    return scene


FLOOR, OTHER = "floor.bsdf.base_color.data", "other.bsdf.base_color.data"


def test_start_of_another_parameter():
    """Two textures that start with each other's truth; a colour that starts as another's."""
    found = parsed(
        two_floors(),
        {
            FLOOR: {"start": {"of": OTHER}},
            OTHER: {"start": OmegaConf.create({"of": FLOOR})},
            "bulb.intensity.value": {"start": {"of": "wall.bsdf.base_color.value"}},
        },
    )
    np.testing.assert_array_equal(found[FLOOR].start, found[OTHER].truth)
    np.testing.assert_array_equal(found[OTHER].start, found[FLOOR].truth)
    assert np.abs(found[FLOOR].start - found[FLOOR].truth).mean() > 0.1
    np.testing.assert_allclose(found["bulb.intensity.value"].start, [0.7, 0.5, 0.3])
    photographs = parsed(two_floors(), {FLOOR: {"start": {"of": OTHER}}}, truth_known=False)
    np.testing.assert_array_equal(photographs[FLOOR].start, found[FLOOR].start)


def test_a_map_starts_with_a_texture_of_its_size():
    scene = lit("map")
    picture = np.random.default_rng(9).uniform(0.2, 0.8, SKY).astype(np.float32)
    scene["floor"]["bsdf"]["base_color"]["data"] = mi.TensorXf(picture)
    found = parsed(scene, {"sky.data": {"start": {"of": FLOOR}}})
    np.testing.assert_array_equal(found["sky.data"].start, picture)


@pytest.mark.parametrize(
    "start, parts",
    [
        ({"of": "other.bsdf.base_colour.data"}, [f"did you mean '{OTHER}'?", "of=other.bsdf"]),
        ({"of": "fine.bsdf.base_color.data"}, ["(8, 8, 3)", "(4, 4, 3)", "fine.bsdf"]),
        ({"of": "wall.bsdf.roughness.value"}, ["(1,)", "(4, 4, 3)"]),
        ({"of": "sky.data"}, ["(4, 8, 3)"]),
        ({"of": FLOOR}, ["no other parameter"]),
        ({"of": "wall.to_world"}, ["no other parameter"]),
        ({"of": 3}, ["of=3", "valid: "]),
        ({"off": OTHER}, ["{of: another key}"]),
        ({"of": OTHER, "scale": 2}, ["{of: another key}", "scale"]),
        ({}, ["{of: another key}"]),
    ],
)
def test_other_starts_of_another_are_refused(start, parts):
    with pytest.raises(InputError) as refused:
        parsed(two_floors(), {FLOOR: {"start": start}})
    for part in (f"scene.unknowns['{FLOOR}'].start", *parts):
        assert part in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_start_of_another_outside_the_range_is_refused():
    specs = {"wall.bsdf.base_color.value": {"start": {"of": "lamp.emitter.radiance.value"}}}
    with pytest.raises(InputError, match="outside its range"):
        parsed(two_floors(), specs)


def test_the_command_line_takes_a_start_of_another():
    given = 'scene.unknowns={"a.b": {"start": {"of": "c.d_0.data"}}, "c.d_0.data": {"start": 2}}'
    cfg = compose(translate(["scene=file", "scene.path=s.xml", given]))
    typed = OmegaConf.to_object(cfg).scene.unknowns
    assert typed["a.b"].start == {"of": "c.d_0.data"}
    assert typed["c.d_0.data"].start == 2


def test_blurs_narrower_than_single_precision_resolves_are_told():
    """With the width that is taken instead."""
    key = "wall.bsdf.roughness.value"
    found = {}
    for end in (1e-9, 1e-3):
        spec = {"start": 0.5, "blur": BlurConfig(start=0.1, end=end)}
        found[end] = narrow_blurs(list(parsed(dictionary(), {key: spec}).values()))
    assert found[1e-3] == []
    (told,) = found[1e-9]
    assert f"scene.unknowns['{key}'].blur.end=1e-09" in told and "3.1e-05" in told


def test_a_light_of_small_numbers_is_blurred_as_narrowly_as_its_own_size_allows():
    key, scene = "bulb.intensity.value", lit("map")
    scene["bulb"]["intensity"] = {"type": "rgb", "value": [1e-6, 2e-6, 1e-6]}
    spec = {"start": 1e-6, "blur": BlurConfig(start=5e-7, end=1e-7)}
    found = parsed(scene, {key: spec})
    assert narrow_blurs(list(found.values())) == []
    assert found[key].scale == pytest.approx(2e-6)
