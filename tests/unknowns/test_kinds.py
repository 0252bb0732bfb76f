"""A kind of unknown is one file: kinds from outside work everywhere, and nobody names those that
there are."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from lit_scene import SKY, lit
from scenes_for_tests import TEXTURE, dictionary, texture, without_targets
from toy_kinds import DECIBELS, LogGrid, Swelling
from xml_for_tests import camera, paths

import isas_cli
from isas_cli import losses, records
from isas_cli.cli.app import main
from isas_cli.config.schema import PoseConfig, UnknownConfig
from isas_cli.engine.evaluate import Evaluator
from isas_cli.rendering import coverage
from isas_cli.runtime import images
from isas_cli.runtime.errors import InputError
from isas_cli.unknowns import registry
from isas_cli.unknowns.kind import Loaded
from isas_cli.unknowns.parameters import as_numpy, owner
from isas_cli.unknowns.specs import parse

GRID, LOG = "floor.bsdf.reflectance.volume.data", "floor.bsdf.reflectance.volume.log"
SHAPE = (2, 3, 4, 3)
SCENE = f"""<scene version="3.0.0">{paths(2)}{camera("0,0,3", 24, 20, fov=50)}
  <emitter type="constant" id="sky"/>
  <shape type="rectangle" id="floor"><bsdf type="diffuse"><texture name="reflectance" type="volume">
    <volume name="volume" type="gridvolume"><string name="filename" value="grid.vol"/>
      <transform name="to_world"><scale x="2" y="2" z="4"/><translate x="-1" y="-1" z="-1"/>
      </transform></volume></texture></bsdf></shape>
  <shape type="cube" id="box"><transform name="to_world"><scale value="0.2"/>
    <translate x="0.6" y="0.6" z="0.2"/></transform></shape></scene>"""
SHORT = ["frames.spp=2", "frames.views=1", "frames.snapshots=0", "report=false"]
SHORT += ["scene=file", "scene.path=scene.xml", "hydra.run.dir=r", "estimator.batch=512"]
SHORT += ["effects=full"]


@pytest.fixture
def toys(monkeypatch):
    monkeypatch.setattr(registry, "_KINDS", [Swelling, LogGrid, *registry.kinds()])


@pytest.fixture
def folder(tmp_path, tmp_path_factory, monkeypatch, rng):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
    monkeypatch.chdir(tmp_path)
    grid = rng.uniform(0.2, 0.9, SHAPE).astype(np.float32)
    mi.VolumeGrid(grid).write("grid.vol")
    Path("scene.xml").write_text(SCENE)
    return tmp_path


def words(unknowns: dict, *arguments: str) -> list[str]:
    return ["run", *SHORT, f"scene.unknowns={json.dumps(unknowns)}", *arguments]


def test_a_kind_from_outside_is_found_recorded_and_pictured(toys, folder):
    """Of its own shape and unit, written to another parameter, differentiated by path replay."""
    spec = {LOG: {"start": float(np.log(0.5)), "lr": 0.05}}
    settings = ["sampler=uniform", "budget.iterations=80", "target.spp=256"]
    assert main(words(spec, *settings)) == 0
    recorded = records.load(folder / "r")
    error = recorded.history[f"parameter_rmse/{LOG}"].to_numpy()
    np.testing.assert_allclose(error, recorded.history["parameter_rmse"])
    truth = np.array(mi.VolumeGrid("grid.vol"))
    at_first = np.sqrt(np.mean((DECIBELS * np.log(truth[0] / 0.5)) ** 2))
    assert error[0] == pytest.approx(at_first, rel=0.3)  # of the layer that is seen
    assert error[-1] < 0.3 * error[0]
    assert recorded.parameter_rmse_is == "dB"
    told = recorded.manifest["unknowns"][LOG]
    assert told["kind"] == LogGrid.name and told["shape"] == list(SHAPE)
    # The floor passes through the first layer alone.
    assert 0.5 * told["entries"] >= told["entries_seen"] > 0.3 * told["entries"]
    for what in ("truth", "start", "result"):
        picture = images.read(folder / "r" / "frames" / f"{what}_{LOG}.slice0.exr")
        assert picture.shape == SHAPE[1:]
    np.testing.assert_allclose(
        images.read(folder / "r" / "frames" / f"truth_{LOG}.slice1.exr"), truth[1], rtol=2e-3
    )


def test_a_kind_that_moves_geometry_is_blurred(toys, folder):
    key = "box.swelling"
    spec = {key: {"start": 0.1, "lr": 0.02, "blur": {"start": 0.1, "end": 0.05}}}
    settings = ["sampler=plateau", "budget.iterations=2", "target.spp=16"]
    assert main(words(spec, *settings)) == 0
    recorded = records.load(folder / "r")
    assert recorded.history["parameter_rmse"].iloc[0] == pytest.approx(0.1)
    assert recorded.history["parameter_rmse"].iloc[-1] != pytest.approx(0.1, rel=1e-6)
    told = recorded.manifest["unknowns"][key]
    assert told["entries_seen"] == told["entries"] == 24
    assert key in recorded.manifest["effects"]["moving silhouettes"]
    assert images.read(folder / "r" / "frames" / f"result_{key}.exr").shape[:2] == (1, 24)


def test_what_a_kind_from_outside_cannot_do_is_one_line(toys, folder, refused):
    moves = "'box.swelling' moves objects, and path replay does not differentiate"
    for key, start, parts in (
        (LOG, {"uniform": [-9.0, -0.1], "seed": 1}, ["spans more than 20 dB"]),
        (LOG, 0.5, ["outside its range"]),
        ("floor.logg", 0.5, [LOG, "box.swelling"]),
        ("box.swelling", 0.1, [moves]),
    ):
        refused(words({key: {"start": start}}, "sampler=uniform"), *parts)


def test_a_grid_starts_from_a_file_of_its_own_size(folder, refused):
    np.save("half.npy", np.full(SHAPE, 0.5, np.float32))
    np.save("other.npy", np.full((2, 2, 2, 3), 0.5, np.float32))
    message = refused(words({GRID: {"start": "other.npy"}}, "sampler=uniform"))
    assert "other.npy is (2, 2, 2, 3) of float32, the grid (2, 3, 4, 3)" in message
    message = refused(words({GRID: {"start": "half.png"}}, "sampler=uniform"))
    assert "a .npy or .vol file that exists" in message
    settings = ["sampler=uniform", "budget.iterations=3", "target.spp=4"]
    assert main(words({GRID: {"start": "half.npy"}}, *settings)) == 0
    saved = np.array(mi.VolumeGrid(f"r/meshes/start_{GRID}.vol"))
    np.testing.assert_array_equal(saved, np.full(SHAPE, 0.5, np.float32))
    again = words({GRID: {"start": f"r/meshes/result_{GRID}.vol"}}, *settings, "overwrite=true")
    assert main(again) == 0


def test_unknowns_of_one_mesh_build_upon_each_other(toys):
    """Swollen first, then turned, whatever their order in the configuration; and derivatives reach
    both."""
    scene = dictionary()
    scene["box"] = {"type": "cube"}
    turn = PoseConfig(kind="rotation", objects=["box"], axis=[0, 0, 1])
    starts = {"box.turn": 90.0, "box.swelling": 0.5}
    made = without_targets(scene, starts, {"box.turn": turn})
    rest = mi.traverse(mi.load_dict({"type": "cube"}))
    points, normals = (
        as_numpy(rest[f"vertex_{name}"]).reshape(-1, 3) for name in ("positions", "normals")
    )
    made.unknowns.attach(made.unknowns.starts())
    found = made.unknowns.params["box.vertex_positions"]
    swollen = points + 0.5 * normals
    turned = np.stack([-swollen[:, 1], swollen[:, 0], swollen[:, 2]], axis=1)
    np.testing.assert_allclose(as_numpy(found).reshape(-1, 3), turned, atol=1e-5)
    dr.backward(dr.sum(found * mi.Float(turned.ravel())))
    gradients = made.unknowns.gradients()
    np.testing.assert_allclose(
        as_numpy(gradients["box.swelling"]), (swollen * normals).sum(axis=1), atol=1e-4
    )
    assert as_numpy(gradients["box.turn"]) == pytest.approx(0, abs=1e-4)  # along the arm
    assert made.unknowns.moved == {"box"} and made.unknowns.moving == list(starts)
    made.unknowns.write(made.unknowns.truths())
    found = as_numpy(made.unknowns.params["box.vertex_positions"])
    np.testing.assert_array_equal(found, points.ravel())


def kind_of(description: dict, key: str):
    loaded = Loaded(mi.traverse(mi.load_dict(description, optimize=False)))
    return registry.offered(loaded)[key](key, loaded)


@pytest.mark.parametrize("mode, wraps", [("repeat", True), ("clamp", False), ("mirror", False)])
@pytest.mark.parametrize("channels, turned", [(3, False), (1, True)])
def test_a_texture_knows_whether_its_edges_meet(mode, wraps, channels, turned):
    scene = dictionary()
    place = mi.ScalarTransform3f().rotate(30).scale([2, 3]).translate([0.3, 0.1])
    name = "base_color" if channels == 3 else "roughness"
    scene["floor"]["bsdf"][name] = {
        "type": "bitmap",
        "data": mi.TensorXf(texture(5)[:4, :, :channels]),
        "raw": True,
        "wrap_mode": mode,
        **({"to_uv": place} if turned else {}),
    }
    found = kind_of(scene, f"floor.bsdf.{name}.data")
    assert found.axes == ((0, wraps), (1, wraps))


def test_a_picture_of_which_the_brightness_alone_is_taken_is_told():
    """As of glTF's occlusion, roughness and metal in one."""
    packed, grey = texture(5)[:4], np.repeat(texture(5)[:4, :, :1], 3, axis=2)

    def told(texels: np.ndarray, *names: str) -> list[str]:
        paint = {"type": "principled", **dict.fromkeys(names, {"type": "ref", "id": "packed"})}
        bitmap = {"type": "bitmap", "data": mi.TensorXf(texels), "raw": True}
        scene = {"type": "scene", "packed": bitmap, "ball": {"type": "sphere", "bsdf": paint}}
        loaded = Loaded(mi.traverse(mi.load_dict(scene, optimize=False)))
        ((key, kind),) = (each for each in registry.offered(loaded).items() if "data" in each[0])
        return kind(key, loaded).warnings()

    (line,) = told(packed, "roughness")
    assert "roughness takes the brightness of three channels" in line
    (line,) = told(packed, "metallic", "roughness")
    assert "metallic, roughness take the brightness" in line and "of one channel" in line
    for texels, names in (
        (grey, ["roughness"]),
        (packed[..., :1], ["roughness"]),
        (packed, ["base_color"]),
        (packed, ["base_color", "roughness"]),
    ):
        assert told(texels, *names) == []


def test_textures_of_one_colour_know_it_as_well():
    """And stay what they are, with the lamp's odds of each place."""
    wraps, scene = {"base_color": False, "roughness": True}, dictionary()
    for name, mode, channels in (("base_color", "clamp", 3), ("roughness", "repeat", 1)):
        texels = mi.TensorXf(np.full((4, 5, channels), 0.3, np.float32))
        bitmap = {"type": "bitmap", "data": texels, "raw": True, "wrap_mode": mode}
        scene["floor"]["bsdf"][name] = bitmap
    loaded = Loaded(mi.traverse(mi.load_dict(scene, optimize=False)))
    middle = dr.zeros(mi.SurfaceInteraction3f)

    def shown(key: str) -> list[np.ndarray]:
        texture, place = owner(loaded.params, key), mi.Point2f(0.2, 0.7)
        told = texture.mean(), texture.eval_1(middle), texture.pdf_position(place)
        return [np.array(loaded.params[key]), *map(np.array, told)]

    for name in wraps:
        key = f"floor.bsdf.{name}.data"
        before = shown(key)
        found = registry.offered(loaded)[key](key, loaded)
        assert found.axes == ((0, wraps[name]), (1, wraps[name]))
        for a, b in zip(before, shown(key), strict=True):
            np.testing.assert_array_equal(a, b)


def test_neighbours_of_other_kinds():
    sky = kind_of(lit("map"), "sky.data")
    assert sky.present.shape == SKY and sky.axes == ((0, False), (1, True))
    assert kind_of(lit("map"), "lamp.emitter.radiance.value").axes == ()


def test_extinction_and_albedo_of_a_medium_have_ranges():
    medium = {"type": "homogeneous", "sigma_t": 1.0, "albedo": 0.5}
    fog = {"type": "sphere", "bsdf": {"type": "null"}, "interior": medium}
    loaded = Loaded(mi.traverse(mi.load_dict({"type": "scene", "fog": fog}, optimize=False)))
    keys = [f"fog.interior_medium.{name}.value.value" for name in ("sigma_t", "albedo")]
    offered = registry.offered(loaded)
    ranges = [tuple(offered[key](key, loaded).range) for key in keys]
    assert ranges == [(0, np.inf), (0, 1)]
    with pytest.raises(InputError, match="outside its range"):
        parse(loaded.params, {keys[0]: UnknownConfig(start=-0.1)}, True)


AWAY = PoseConfig(kind="rotation", objects=["sensor_00*"], axis=[0, 1, 0], origin=[0, 0, 3])


def seen_texels(unknowns: dict, poses: dict, hidden: bool = False, photographs: bool = False):
    scene = dictionary(size=16, resolution=(96, 64), depth=2, floor=6.0)
    if hidden:
        scene["floor"]["to_world"] = mi.ScalarTransform4f().translate([0, 90, 90]).scale(0.01)
    made = without_targets(scene, unknowns, poses)
    made.content_hash = f"hidden: {hidden}"
    for unknown in made.unknowns:
        unknown.seen = None
        unknown.truth = None if photographs else unknown.truth
    coverage.fill_in(made, 1)
    assert all(made.unknowns[key].seen.all() for key in poses)
    return made.unknowns[TEXTURE].seen


def test_beside_a_pose_texels_are_judged_by_what_is_seen(tmp_path, monkeypatch):
    """From the start, and from the truth where that is known: cameras that look away at first."""
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    alone = seen_texels({TEXTURE: 0.5}, {})
    assert 0.2 < alone.mean() < 1
    still, away = ({TEXTURE: 0.5, "eye.turn": angle} for angle in (0.0, 180.0))
    poses = {"eye.turn": AWAY}
    assert np.array_equal(seen_texels(still, poses), alone)
    both = seen_texels(away, poses)
    assert (both >= alone).all() and alone.mean() < both.mean() < 1
    # Where nothing can be told, all count.
    assert seen_texels(away, poses, hidden=True, photographs=True).all()
    with pytest.raises(InputError, match="no view sees it"):
        seen_texels({TEXTURE: 0.5}, {}, hidden=True)


def test_errors_in_unlike_units_are_relative_to_the_start():
    """Degrees and reflectances; one that starts at its truth is counted by what it is added to."""
    poses = {
        "wall.turn": PoseConfig(kind="rotation", objects=["wall"]),
        "floor.place": PoseConfig(kind="translation", objects=["floor"], directions=[[0, 1, 0]]),
    }
    starts = {TEXTURE: 0.5, "wall.turn": 40.0, "floor.place": 0.0}
    made = without_targets(dictionary(), starts, poses)
    made.set_targets(dr.zeros(mi.Float, made.views.total * 3), None, "test")
    evaluator = Evaluator(made, losses.L2(), 10, 2, 1)
    assert made.unknowns.unit is None

    def errors(**changed):
        arrays = {u.key: u.start for u in made.unknowns} | changed
        return evaluator.parameter_errors(made.unknowns.values_of(arrays))

    start = errors()
    assert start["parameter_rmse"] == pytest.approx(np.sqrt(2 / 3))  # two of three stand off
    assert start["parameter_rmse/wall.turn"] == pytest.approx(40)
    half = errors(**{"wall.turn": np.array([20], np.float32)})
    assert half["parameter_rmse"] == pytest.approx(np.sqrt((1 + 0.25) / 3))
    moved = errors(**{"floor.place": np.array([0.5], np.float32)})
    share = 0.5 / made.unknowns["floor.place"].scale
    assert moved["parameter_rmse"] == pytest.approx(np.sqrt((2 + share**2) / 3))
    truths = {u.key: u.truth for u in made.unknowns}
    assert errors(**truths)["parameter_rmse"] == 0


SOURCES = Path(isas_cli.__file__).parent
KINDS = {"environment", "poses", "texture", "value"}
# Rooms that handle unknowns; a configuration, a record and a report have keys of other things.
ROOMS = "scene rendering losses samplers estimators effects engine measure".split()
# Tests of a kind by its class, its name or its key.
TELLING = (
    r"isinstance\([^)]*\b(kind|unknown)\b|\.kind\.name\s*[=!]=|\bkey\.(ends|starts)with\("
    r"|unknowns\.poses\b(?! import)|is_tensor_v|is_environment"
)


def imported(tree: ast.Module) -> set[str]:
    """Last words of the modules that a file imports from, or imports, but for type checkers."""
    typing = [n for n in ast.walk(tree) if isinstance(n, ast.If) and "TYPE_CH" in ast.dump(n.test)]
    guarded = {id(inner) for node in typing for inner in ast.walk(node)}
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and id(node) not in guarded:
            names = [f"{node.module or ''}.{alias.name}" for alias in node.names]
            found |= {m[1] for n in names if (m := re.search(r"(?:^|\.)unknowns\.(\w+)", n))}
    return found


def test_nothing_outside_names_a_kind():
    files = [path for room in ROOMS for path in sorted((SOURCES / room).rglob("*.py"))]
    assert len(files) > 50
    found = []
    for path in files:
        text = path.read_text(encoding="utf-8")
        found += [(path.name, kind) for kind in imported(ast.parse(text)) & KINDS]
        found += [(path.name, line) for line in text.splitlines() if re.search(TELLING, line)]
    assert found == []


def test_two_that_write_one_parameter_are_refused(toys, folder, refused):
    """One would be lost. Poses build on what moves before them."""
    both = {GRID: {"start": 0.5}, LOG: {"start": -1.0}}
    message = refused(words(both, "sampler=uniform"))
    assert f"'{GRID}' and '{LOG}' both write the scene's parameter '{GRID}'" in message

    def parsed(**specs) -> list[str]:
        params = mi.traverse(mi.load_file("scene.xml"))
        turn, shift = PoseConfig("rotation", ["box"]), PoseConfig("translation", ["box"])
        poses = {"turn": turn, "shift": shift}
        given = {"turn": {"start": 1.0}, "shift": {"start": 0.1}, **specs}
        given = {key: UnknownConfig(**each) for key, each in given.items()}
        return [u.key for u in parse(params, given, True, poses)]

    assert parsed() == ["turn", "shift"]
    assert parsed(**{"box.swelling": {"start": 0.1}}) == ["turn", "shift", "box.swelling"]
