"""Poses: what they move, where to, and what their derivatives are."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from isas_cli.scenes import meshes, stage
from scenes_for_tests import without_targets

from isas_cli.config.schema import PoseConfig, UnknownConfig
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime.errors import InputError
from isas_cli.unknowns.kind import Loaded
from isas_cli.unknowns.parameters import as_numpy
from isas_cli.unknowns.poses import Pose

RADIUS, BALL = 0.3, [0.4, 0.5, 0.2]


def description(place=None) -> dict:
    """A ball, a box as a mesh, a point light and a camera; ``place``: Mitsuba's transform of the
    ball and the box, as if they had been loaded there."""
    place = place or mi.ScalarTransform4f()
    box = stage.boxes(np.array([[-0.5, 0.4, 0.1], [-0.5, 1.1, 0.1]]), (0.2, 0.3, 0.1))
    points = np.asarray(place.matrix)[:3, :3] @ box.vertices.T + np.asarray(place.matrix)[:3, 3:]
    turn = np.asarray(place.matrix)[:3, :3]
    turn = turn / np.linalg.norm(turn[0])
    moved = meshes.Surface(
        points.T.astype(np.float32), box.faces, box.texcoords, (box.normals @ turn.T).astype("f4")
    )
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 3},
        "sky": {"type": "constant", "radiance": 0.4},
        "lamp": {"type": "point", "position": [1.0, 3.0, 2.0], "intensity": 9.0},
        "ground": stage.ground(2.0, stage.matt(0.5)),
        "ball": {
            "type": "sphere",
            "to_world": place @ mi.ScalarTransform4f().translate(BALL).scale(RADIUS),
            "bsdf": stage.matt([0.6, 0.2, 0.1]),
        },
        "box": meshes.shape("box", moved, stage.matt([0.1, 0.3, 0.6])),
        "sensor_000": stage.camera([0.2, 1.6, 3.5], (0.0, 0.4, 0.0), 45.0, 24),
    }


BOTH = ["ball", "box"]
TURN = PoseConfig(kind="rotation", objects=BOTH, axis=[0.2, 1.0, 0.1], origin=[0.1, 0.0, -0.2])
# Mitsuba itself takes axes of unit length alone.
AXIS = (np.array(TURN.axis) / np.linalg.norm(TURN.axis)).tolist()
SHIFT = PoseConfig(kind="translation", objects=BOTH)
GROW = PoseConfig(kind="scale", objects=BOTH, origin=[0.1, 0.0, -0.2])
POSES = {"rotation": TURN, "translation": SHIFT, "scale": GROW}
VALUES = [("rotation", 35.0), ("translation", [0.2, 0.1, -0.3]), ("scale", 0.4)]


def moved(poses: dict[str, PoseConfig], start: dict):
    return without_targets(description(), start, poses)


def image(p, seed: int = 5) -> np.ndarray:
    return Renderer(p).range(0, p.views.total, 32, lambda i: seed + i)


def transform(kind: str):
    to = mi.ScalarTransform4f()
    if kind == "translation":
        return to.translate([0.2, 0.1, -0.3])
    if kind == "scale":
        away = [-x for x in GROW.origin]
        return to.translate(GROW.origin).scale(2**0.4).translate(away)
    return to.translate(TURN.origin).rotate(AXIS, 35.0).translate([-x for x in TURN.origin])


@pytest.mark.parametrize("kind, value", VALUES)
def test_a_moved_scene_is_the_scene_loaded_there(kind, value):
    """The same random numbers give the same image, to rounding: mesh, normals, sphere; and the
    recorded kernels see every later movement, and the way back."""
    p = moved({"all.pose": POSES[kind]}, {"all.pose": value})
    there = without_targets(description(transform(kind)), {"ground.bsdf.base_color.value": 0.3})
    there.unknowns.write(there.unknowns.truths())
    expected = image(there)
    p.unknowns.write(p.unknowns.truths())
    renderer = Renderer(p)
    at_rest = renderer.range(0, p.views.total, 32, lambda i: 5 + i)
    for _ in range(3):
        p.unknowns.write(p.unknowns.starts())
        found = renderer.range(0, p.views.total, 32, lambda i: 5 + i)
        # A path on an edge may go the other way by rounding.
        assert np.mean(np.abs(found - expected) > 1e-3) < 0.02
        assert np.abs(found - expected).mean() < 1e-3 < np.abs(at_rest - expected).mean()
    p.unknowns.write(p.unknowns.truths())
    assert np.array_equal(at_rest, renderer.range(0, p.views.total, 32, lambda i: 5 + i))


def test_at_its_own_value_everything_stands_as_loaded():
    plain = mi.traverse(mi.load_dict(description(), optimize=False))
    p = moved(
        {
            "all.turn": PoseConfig(
                kind="rotation", objects=BOTH, at=[70.0], origin=[1.0, 2.0, 3.0]
            ),
            "lamp.place": PoseConfig(kind="translation", objects=["lamp"], at=[1.0, 3.0, 2.0]),
        },
        {"all.turn": 10.0, "lamp.place": [0.0, 2.0, 0.0]},
    )
    p.unknowns.write(p.unknowns.starts())
    assert np.allclose(as_numpy(p.unknowns.params["lamp.position"]), [0, 2, 0])
    assert not np.allclose(p.unknowns.params["box.vertex_positions"], plain["box.vertex_positions"])
    p.unknowns.write(p.unknowns.truths())
    for key in ("box.vertex_positions", "box.vertex_normals", "lamp.position"):
        assert np.array_equal(as_numpy(p.unknowns.params[key]), as_numpy(plain[key])), key
    truth, loaded = (np.array(q["ball.to_world"].matrix) for q in (p.unknowns.params, plain))
    assert np.array_equal(truth.ravel(), loaded.ravel())


def test_a_turn_of_what_stands_far_away_is_resolved():
    """Coordinates of 100 about an axis a unit away: σ is raised to many of their roundings."""
    from isas_cli.unknowns import smoothing

    scene = description(mi.ScalarTransform4f().translate([100, 0, 0]))
    turn = PoseConfig(kind="rotation", objects=["box"], origin=[100.5, 0.0, 0.0], axis=[0, 1, 0])
    p = without_targets(scene, {"box.turn": 0.0}, {"box.turn": turn})
    scale = p.unknowns.items[0].scale
    assert scale == pytest.approx(np.degrees(100 / 1), rel=0.5)
    (σ,) = smoothing.stable(np.array([1e-9]), np.array([0.0]), scale)
    arm = np.float32(99.5) + np.float32(np.radians(σ)) - np.float32(99.5)
    assert abs(arm / np.radians(σ) - 1) < 1 / 100


def test_parts_move_by_themselves():
    spec = PoseConfig(
        kind="translation", objects=["box"], directions=[[1, 0, 0], [0, 0, 2]], parts=2
    )
    p = moved({"boxes.place": spec}, {"boxes.place": [0.1, 0.2, 0.3, 0.4]})
    rest = as_numpy(mi.traverse(p.scene)["box.vertex_positions"]).reshape(2, 24, 3)
    p.unknowns.write(p.unknowns.starts())
    found = as_numpy(p.unknowns.params["box.vertex_positions"]).reshape(2, 24, 3)
    assert np.allclose(found[0] - rest[0], [0.1, 0, 0.2], atol=1e-6)
    assert np.allclose(found[1] - rest[1], [0.3, 0, 0.4], atol=1e-6)
    assert p.unknowns.items[0].truth.tolist() == [0, 0, 0, 0]
    p = moved({"boxes.place": spec}, {"boxes.place": [0.1, 0.2]})
    assert p.unknowns.items[0].start.tolist() == pytest.approx([0.1, 0.2, 0.1, 0.2])
    with pytest.raises(InputError, match="one per direction, or one per part and direction"):
        moved({"boxes.place": spec}, {"boxes.place": [0.1, 0.2, 0.3]})


def test_poses_of_one_object_follow_each_other():
    """First turned, then shifted."""
    poses = {"a.turn": TURN, "a.shift": SHIFT}
    p = moved(poses, {"a.turn": 90.0, "a.shift": [1.0, 0.0, 0.0]})
    p.unknowns.write(p.unknowns.starts())
    to = mi.ScalarTransform4f().translate([1, 0, 0])
    turned = to.translate(TURN.origin).rotate(AXIS, 90).translate([-x for x in TURN.origin])
    centre = turned @ mi.ScalarPoint3f(BALL)
    found = np.array(p.unknowns.params["ball.to_world"].matrix).reshape(4, 4)[:3, 3]
    assert np.allclose(found, centre, atol=1e-5)


@pytest.mark.parametrize("kind, value", VALUES)
def test_derivatives_flow_on_to_the_pose(kind, value):
    """Of a fixed weighting of all vertices and of the ball's centre, against differences."""
    p = moved({"all.pose": POSES[kind]}, {"all.pose": value})
    rng = np.random.default_rng(1)
    count = dr.width(p.unknowns.params["box.vertex_positions"])
    weight = mi.Float(rng.standard_normal(count).astype(np.float32))

    def value_at(values):
        box = dr.sum(p.unknowns.params["box.vertex_positions"] * weight)
        centre = p.unknowns.params["ball.to_world"].translation()
        return box + centre.x + 2 * centre.y - centre.z

    p.unknowns.attach(p.unknowns.starts())
    dr.backward(value_at(None))
    found = as_numpy(p.unknowns.gradients()["all.pose"])
    start = p.unknowns.items[0].start
    step = 0.5 if kind == "rotation" else 0.05
    for k in range(start.size):
        ends = []
        for h in (-step, step):
            at = start.copy()
            at[k] += h
            p.unknowns.write(p.unknowns.values_of({"all.pose": at}))
            ends.append(float(value_at(None)[0]))
        assert found[k] == pytest.approx((ends[1] - ends[0]) / (2 * step), rel=2e-3, abs=1e-3)


@pytest.mark.parametrize(
    "settings, words",
    [
        ({"objects": ["bal"]}, "'bal' is nothing that can be moved; did you mean 'ball'"),
        ({"objects": ["sky"]}, "'sky' is nothing that can be moved"),
        ({"kind": "shear"}, "pose.kind=shear: valid: rotation, translation"),
        ({"kind": "rotation", "axis": [0, 0, 0]}, "pose.axis"),
        ({"axis": [1, 0, 0]}, "pose.axis: a translation has no use for it"),
        ({"kind": "rotation", "directions": [[1, 0, 0]]}, "pose.directions: a rotation has no use"),
        ({"kind": "scale", "axis": [1, 0, 0]}, "pose.axis: a scale has no use for it"),
        ({"directions": [[1, 0]]}, "pose.directions"),
        ({"directions": [1, 0, 0]}, "pose.directions: 1 is no .x, y, z. .a list of such."),
        ({"directions": [[1, "a", 0]]}, "pose.directions: .1, 'a', 0. is no"),
        ({"directions": []}, "pose.directions=..: at least one"),
        ({"objects": []}, "pose.objects=..: at least one"),
        ({"period": 90.0}, "pose.period: a translation has no use for it"),
        ({"kind": "rotation", "period": 0.0}, "pose.period=0.0: degrees"),
        ({"parts": 0}, "pose.parts=0: at least 1"),
        ({"parts": 5}, "48 vertices, no multiple"),
        ({"parts": 2, "objects": ["ball"]}, "'ball' is no mesh"),
        ({"at": [1.0]}, "3 numbers, one per direction"),
    ],
)
def test_what_cannot_be_moved_is_refused_in_one_line(settings, words):
    params = mi.traverse(mi.load_dict(description(), optimize=False))
    with pytest.raises(InputError, match=words) as error:
        spec = PoseConfig(**{"kind": "translation", "objects": ["box"], **settings})
        Pose("x.place", Loaded(params, {"x.place": spec}))
    assert "\n" not in str(error.value)


def thing(name: str) -> dict:
    place = mi.ScalarTransform4f()
    if name == "sdfgrid":
        field = np.ones((3, 3, 3, 1), np.float32)
        field[1, 1, 1] = -1
        return {"type": name, "grid": mi.TensorXf(field)}
    if name.startswith("mirrored "):
        return {"type": name.split()[1], "to_world": place.scale([-1, 1, 1])}
    more = {"aperture_radius": 0.1, "focus_distance": 3.0} if name == "thinlens" else {}
    if name == "envmap":
        more["bitmap"] = mi.Bitmap(np.ones((4, 8, 3), np.float32))
    return {"type": name, **more} | ({"flip_normals": True} if name == "sphere" else {})


@pytest.mark.parametrize(
    "name, kind, words",
    [
        ("sdfgrid", "rotation", "with holes: put it into a shapegroup and turn an instance"),
        ("sdfgrid", "translation", None),
        ("mirrored sphere", "translation", "write it unmirrored, with flip_normals"),
        ("mirrored cylinder", "rotation", "write it unmirrored, with flip_normals"),
        ("mirrored disk", "rotation", None),
        ("sphere", "translation", None),
        ("perspective", "scale", "Mitsuba scales no camera with a perspective"),
        ("thinlens", "scale", "Mitsuba scales no camera with a perspective"),
        ("perspective", "rotation", None),
        ("orthographic", "scale", None),
        ("envmap", "scale", "infinitely far away, so that only a rotation of it shows"),
        ("envmap", "rotation", None),
        ("directional", "translation", "infinitely far away, so that only a rotation of it shows"),
    ],
)
def test_what_mitsuba_does_not_move_well_is_refused_in_one_line(name, kind, words):
    params = mi.traverse(mi.load_dict({"type": "scene", "it": thing(name)}, optimize=False))
    loaded = Loaded(params, {"pose": PoseConfig(kind=kind, objects=["it"])})
    if words is None:
        assert Pose("pose", loaded).ids == ["it"]
        return
    with pytest.raises(InputError, match=f"scene.poses\\['pose'\\]: 'it': .*{words}") as error:
        Pose("pose", loaded)
    assert "\n" not in str(error.value)


def test_a_pose_that_is_no_unknown_is_refused():
    with pytest.raises(InputError, match="scene.poses\\['b.place'\\] is not among scene.unknowns"):
        moved({"a.turn": TURN, "b.place": SHIFT}, {"a.turn": 0.0})


def test_patterns_name_several_objects():
    params = mi.traverse(mi.load_dict(description(), optimize=False))
    spec = PoseConfig(kind="translation", objects=["b*", "box"])
    assert Pose("x.place", Loaded(params, {"x.place": spec})).ids == ["ball", "box"]
    with pytest.raises(InputError, match="has a parameter of this name"):
        Pose("ball.to_world", Loaded(params, {"ball.to_world": SHIFT}))


def test_an_id_may_be_what_patterns_are_made_of():
    """Mitsuba, too, takes keys for patterns when parameters are chosen."""
    scene, name = description(), "ball[0] (1)+wood"
    scene[name] = scene.pop("ball")
    colour, place = f"{name}.bsdf.base_color.value", f"{name}.to_world"
    shift = {"shift": PoseConfig(kind="translation", objects=[name])}
    p = without_targets(scene, {colour: 0.1, "shift": [0.0, 0.0, 0.5]}, shift)
    p.unknowns.write(p.unknowns.starts())
    assert {*p.unknowns.params.keys()} == {colour, place}
    assert np.allclose(p.unknowns.params[colour], 0.1)
    assert np.array(p.unknowns.params[place].matrix).reshape(4, 4)[2, 3] == pytest.approx(0.7)


def test_a_square_box_is_compared_modulo_a_quarter_turn():
    spec = PoseConfig(kind="rotation", objects=["box"], period=90.0)
    p = moved({"box.turn": spec}, {"box.turn": 10.0})
    assert p.unknowns.items[0].kind.period == 90.0


def test_an_angle_is_compared_the_shorter_way_round():
    from isas_cli import losses
    from isas_cli.engine.evaluate import Evaluator

    p = moved({"all.turn": TURN}, {"all.turn": UnknownConfig(start=350.0)})
    p.set_targets(dr.zeros(mi.Float, p.views.total * 3), None, "test")
    evaluator = Evaluator(p, losses.L2(), 10, 2, 1)
    for value, error in ((350.0, 10.0), (-350.0, 10.0), (180.0, 180.0), (725.0, 5.0)):
        values = p.unknowns.values_of({"all.turn": np.array([value], np.float32)})
        found = evaluator.parameter_errors(values)["parameter_rmse"]
        assert found == pytest.approx(error, abs=1e-3)


@pytest.mark.parametrize("lies_on_a_grid", [True, False])
def test_a_grid_that_stays_behind_is_told(lies_on_a_grid):
    fog = {"type": "homogeneous", "sigma_t": 0.5}
    if lies_on_a_grid:
        texels = mi.TensorXf(np.full((2, 2, 2, 1), 0.5, np.float32))
        fog = {"type": "heterogeneous", "sigma_t": {"type": "gridvolume", "data": texels}}
    described = {"type": "scene", "box": {"type": "cube", "interior": fog}}
    params = mi.traverse(mi.load_dict(described, optimize=False))
    spec = PoseConfig(objects=["box"], kind="translation", directions=[[1.0, 0.0, 0.0]])
    told = Pose("place", Loaded(params, {"place": spec})).warnings()
    assert any("moves 'box', and the grid" in line for line in told) == lies_on_a_grid
