"""`isas export`: what was found as a file that Mitsuba reads, the user's own if there is one."""

import json
import re
from pathlib import Path

import drjit as dr
import glb
import mitsuba as mi
import numpy as np
import OpenImageIO as oiio
import photo_sets
import pytest
import trimesh
from runs_for_tests import QUIET, ran
from xml_for_tests import camera, paths

from isas_cli.cli.app import main
from isas_cli.config import schema
from isas_cli.config.compose import compose, translate
from isas_cli.config.schema import PoseConfig, SceneConfig, TargetConfig, UnknownConfig
from isas_cli.engine import assemble
from isas_cli.rendering import rays
from isas_cli.rendering.emission import Emission
from isas_cli.runtime import images
from isas_cli.runtime.errors import InputError
from isas_cli.scene import built, export, instances, scene_file
from isas_cli.scene.views import Views
from isas_cli.unknowns.specs import parse
from isas_cli.unknowns.unknowns import Unknowns

pytestmark = pytest.mark.usefixtures("two_threads")

SCENE = f"""<scene version="3.0.0">{paths(3)}{camera("0,1,4", 16, 12, fov=40)}
  <emitter type="envmap" id="sky"><string name="filename" value="sky.exr"/></emitter>
  <emitter type="point"><point name="position" x="1" y="2" z="3"/>
    <rgb name="intensity" value="2, 1, 1"/></emitter>
  <bsdf type="twosided" id="paint"><bsdf type="principled">
    <texture type="bitmap" name="base_color"><string name="filename" value="paint.png"/></texture>
    <float name="roughness" value="0.4"/></bsdf></bsdf>
  <shape type="rectangle" id="floor"><ref id="paint"/></shape>
  <shape type="ply" id="figure"><string name="filename" value="figure.ply"/>
    <transform name="to_world"><translate y="0.3"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.3, 0.4"/></bsdf></shape>
  <shape type="sphere" id="ball"><float name="radius" value="0.2"/>
    <point name="center" x="0.1" y="0" z="0.3"/>
    <bsdf type="diffuse"><texture type="bitmap" name="reflectance">
      <string name="filename" value="other.png"/></texture></bsdf></shape>
</scene>"""
CLOUD = """<scene version="3.0.0">
  <integrator type="volpath"/><emitter type="constant" id="sky"/>
  <sensor type="perspective"><film type="hdrfilm"><integer name="width" value="4"/>
    <integer name="height" value="4"/></film></sensor>
  <shape type="cube" id="box"><bsdf type="null"/><medium type="heterogeneous" name="interior">
    <volume type="gridvolume" name="sigma_t"><string name="filename" value="grid.vol"/></volume>
    <volume type="constvolume" name="albedo"><rgb name="value" value="0.5"/></volume>
  </medium></shape></scene>"""


PAINT, SKY, RED = "paint.brdf_0.base_color.data", "sky.data", "figure.bsdf.reflectance.value"
ROUGH, LAMP = "paint.brdf_0.roughness.value", "emitter_1.intensity.value"


@pytest.fixture
def folder(tmp_path, rng):
    for name in ("paint", "other"):
        images.write_png(tmp_path / f"{name}.png", rng.integers(0, 255, (4, 6, 3), dtype=np.uint8))
    images.write_exr(tmp_path / "sky.exr", rng.random((8, 16, 3)), [*"RGB"], {})
    trimesh.creation.icosphere(1, 0.5).export(tmp_path / "figure.ply")
    grid = rng.uniform(0.1, 0.9, (2, 3, 4, 1)).astype(np.float32)
    mi.VolumeGrid(grid).write(str(tmp_path / "grid.vol"))
    (tmp_path / "scene.xml").write_text(SCENE)
    (tmp_path / "cloud.xml").write_text(CLOUD)
    return tmp_path


def of_xml(told: list[str]) -> list[str]:
    """What is said of Mitsuba's file, not of glTF's."""
    return [line for line in told if "scene.glb" not in line]


def scene(path, keys, poses=None) -> SceneConfig:
    unknowns = {key: UnknownConfig(start=0.5) for key in keys}
    return SceneConfig(name="file", path=str(path), unknowns=unknowns, poses=poses or {})


def found(path, shapes: dict) -> dict:
    """Each parameter's value in the scene at ``path``, in a shape."""
    params = mi.traverse(mi.load_file(str(path), optimize=False))
    return {key: np.array(params[key]).reshape(shape) for key, shape in shapes.items()}


def test_the_result_stands_in_the_users_own_file(folder, rng):
    arrays = {
        PAINT: rng.random((4, 6, 3)),
        SKY: rng.random((8, 16, 3)) + 0.1,
        RED: np.array([0.7, 0.1, 0.2]),
        ROUGH: np.array([0.25]),
        LAMP: np.array([5.0, 6.0, 7.0]),
    }
    arrays = {key: array.astype(np.float32) for key, array in arrays.items()}
    path, _ = export.write(scene(folder / "scene.xml", arrays), arrays, folder / "result")
    # Nothing of the user's is needed to read it, or has changed.
    for name in ("paint.png", "other.png", "sky.exr", "figure.ply"):
        (folder / name).unlink()
    assert (folder / "scene.xml").read_text() == SCENE
    shapes = {key: array.shape for key, array in arrays.items() if key not in (SKY, LAMP)}
    for key, value in found(path, shapes).items():
        assert np.allclose(value, arrays[key], atol=1e-6), key
    params = mi.traverse(mi.load_file(str(path), optimize=False))
    assert np.allclose(np.array(params[SKY])[:, 1:-1], arrays[SKY], atol=1e-6)
    (lamp,) = (params[key] for key in params.keys() if key.endswith("intensity.value"))
    assert np.allclose(np.array(lamp).ravel(), arrays[LAMP])


def test_a_moved_mesh_and_a_turned_ball_are_where_they_were_found(folder):
    poses = {
        "up": PoseConfig(kind="translation", objects=["figure", "ball"], directions=[[0, 1, 0]])
    }
    arrays = {"up": np.array([0.25], np.float32)}
    path, _ = export.write(scene(folder / "scene.xml", arrays, poses), arrays, folder / "result")
    shapes = {"figure.vertex_positions": (-1, 3)}
    before, after = (found(each, shapes) for each in (folder / "scene.xml", path))
    moved = after["figure.vertex_positions"] - before["figure.vertex_positions"]
    assert np.allclose(moved, [0, 0.25, 0], atol=1e-6)
    balls = []
    for each in (folder / "scene.xml", path):
        (ball,) = (s for s in mi.load_file(str(each)).shapes() if s.id() == "ball")
        balls.append(np.array([ball.bbox().min, ball.bbox().max]).reshape(2, 3))
    assert np.allclose(balls[1] - balls[0], [0, 0.25, 0], atol=1e-6)


def test_a_grid_is_written_in_mitsubas_format(folder, rng):
    key = "box.interior_medium.sigma_t.data"
    arrays = {key: rng.uniform(0.1, 2, (2, 3, 4, 1)).astype(np.float32)}
    path, told = export.write(scene(folder / "cloud.xml", arrays), arrays, folder / "result")
    assert told == ["no scene.glb: nothing in it has a surface that glTF could hold"]
    assert export.write(scene(folder / "cloud.xml", arrays), arrays, folder / "result")[1] == told
    (folder / "grid.vol").unlink()
    assert np.allclose(found(path, {key: (2, 3, 4, 1)})[key], arrays[key])


def test_what_was_found_is_rendered_as_it_was(folder, rng):
    """The scene that a run would render its result from, and the file, with the same numbers."""
    arrays = {PAINT: rng.random((4, 6, 3)).astype(np.float32)}
    path, _ = export.write(scene(folder / "scene.xml", arrays), arrays, folder / "result")
    own, *_ = scene_file.load(str(folder / "scene.xml"), None)
    params = mi.traverse(own)
    untouched = np.array(mi.render(own, spp=16, seed=1))
    params[PAINT] = mi.TensorXf(arrays[PAINT])
    params.update()
    wanted, got = (
        np.array(mi.render(each, spp=16, seed=1))
        for each in (own, mi.load_file(str(path), optimize=False))
    )
    assert np.abs(got - wanted).mean() < 1e-4 < 1e-2 < np.abs(got - untouched).mean()


def same(path, own, noisy: bool = False) -> None:
    """That the file shows what ``own`` does, with the same random numbers, or in the mean."""
    wanted, got = (
        np.array(mi.render(each, spp=256 if noisy else 16, seed=1))
        for each in (own, mi.load_file(str(path), optimize=False))
    )
    if noisy:
        wanted, got = (
            each.reshape(4, -1, 4, each.shape[1] // 4, 3).mean((1, 3)) for each in (wanted, got)
        )
    assert wanted.mean() > 0.01
    assert np.abs(got - wanted).mean() < (0.02 if noisy else 1e-4) * wanted.mean()


def alike(path, own) -> None:
    """That the file holds what ``own`` does: parameters, materials, lights, the length of paths."""
    found = mi.load_file(str(path), optimize=False)
    instances.name_all(found)
    got, wanted = mi.traverse(found), mi.traverse(own)
    assert set(got.keys()) == set(wanted.keys())
    # Bytes of a picture's file, which isas holds as floats, show in renderings alone.
    keys = [key for key in wanted.keys() if not isinstance(got[key], mi.TensorXu8)]
    pairs = {key: (numbers(got[key]), numbers(wanted[key])) for key in keys}
    differing = [key for key, (a, b) in pairs.items() if not np.allclose(a, b, 1e-5, 1e-5)]
    assert differing == []
    assert kinds(got) == kinds(wanted)
    assert found.integrator().max_depth == own.integrator().max_depth


def numbers(value) -> np.ndarray:
    """A parameter's; of a transform, its matrix's."""
    return np.array(value if hasattr(value, "shape") else getattr(value, "matrix", value))


def kinds(params: mi.SceneParameters) -> list[str]:
    """What materials and lights there are."""
    things = (each for each in params.hierarchy if isinstance(each, (mi.BSDF, mi.Emitter)))
    return sorted(each.class_name() for each in things)


BUILDERS = sorted(
    path.stem
    for path in (Path(schema.folder()) / "scene").glob("*.yaml")
    if "builder:" in path.read_text(encoding="utf-8")
)
OURS = {"lego": "emission"} | dict.fromkeys(
    ("room_joint", "object_joint", "object_joint_shape"), "phong"
)
SURFACELESS = ("lego", "smoke")
# Lamps come in another order, and with other random numbers.
NOISY = ("global_illumination",)
# Each of these is rendered, by kernels of its own; of the others the parameters are compared.
RENDERED = ("pottery", "caustic_failure", *NOISY, "cup", "shadows", "sort", "smoke", "kirby")
RENDERED += ("object_joint",)


def described(name: str) -> tuple[SceneConfig, mi.Scene, Unknowns]:
    """A small scene of ours, as configured and loaded."""
    config = schema.typed(compose([f"scene={name}", "size=tiny"])).scene
    loaded = built.load(built.description(config))
    instances.name_all(loaded)
    specs = parse(mi.traverse(loaded), config.unknowns, True, config.poses)
    return config, loaded, Unknowns(mi.traverse(loaded), specs)


OWN = {"scene.xml", "scene.glb", "painted", ".isas-export"}


@pytest.mark.parametrize("name", BUILDERS)
def test_what_a_program_described_is_a_file(tmp_path, rng, name):
    """Meshes, pictures, grids, poses; of what is isas's own it is said."""
    config, loaded, unknowns = described(name)
    arrays = {}
    for each in unknowns:
        low, high = (np.clip(bound, -3, 3) for bound in (each.low, each.high))
        noise = 0.01 * rng.normal(size=each.truth.shape)
        arrays[each.key] = np.clip(each.truth + noise, low, high).astype(np.float32)
    path, said = export.write(config, arrays, tmp_path / "result")
    assert [line.partition(" is isas's own")[0] for line in of_xml(said)] == (
        [f"'{OURS[name]}'"] if name in OURS else []
    )
    # Beside it lies what it names alone: no picture of the truth.
    text = path.read_text(encoding="utf-8")
    beside = {each.name for each in path.parent.iterdir()} - OWN
    assert all(f'"{file}"' in text for file in beside)
    surfaces = path.with_suffix(".glb")
    assert glb.problems(surfaces) == [] if surfaces.exists() else name in SURFACELESS
    unknowns.write(unknowns.values_of(arrays))
    if OURS.get(name) == "emission":
        assert isinstance(mi.load_file(str(path)).integrator(), Emission)
    elif name in RENDERED:
        same(path, loaded, name in NOISY)
    else:
        alike(path, loaded)


def test_the_command_writes_what_a_run_found(tmp_path, capsys):
    folder = tmp_path / "run"
    settings = ["scene=materials_joint", "size=tiny", "sampler=uniform", "budget.iterations=2"]
    settings += ["target.spp=1", "estimator.batch=64", "evaluation.pixels=64", "frames.views=0"]
    ends = ran(folder, *settings, "report=false").parameters()
    assert main(["export", str(folder)]) == 0
    path = folder / "result" / "scene.xml"
    out = capsys.readouterr().out
    assert f"result: {path}\nglTF: {path.with_suffix('.glb')}\nscene.glb leaves out: " in out
    _, loaded, unknowns = described("materials_joint")
    assert not any(np.array_equal(ends[each.key], each.start) for each in unknowns)
    unknowns.write(unknowns.values_of(ends))
    same(path, loaded)


def test_a_painted_mesh_is_an_obj_file_with_its_picture(tmp_path, rng):
    config, loaded, _ = described("pottery")
    key = next(iter(config.unknowns))
    shape = key.partition(".")[0]
    params = mi.traverse(loaded)
    colour = rng.random(params[key].shape).astype(np.float32)
    export.write(config, {key: colour}, tmp_path)
    read = trimesh.load(tmp_path / "painted" / f"{shape}.obj", process=False)
    picture = np.asarray(read.visual.material.image)
    assert np.array_equal(picture, images.to_display(colour))
    uv = np.array(params[f"{shape}.vertex_texcoords"]).reshape(-1, 2)
    assert np.allclose(read.visual.uv * [1, -1] + [0, 1], uv, atol=1e-5)
    assert len(read.faces) * 3 == len(np.array(params[f"{shape}.faces"]))


def test_photographs_are_exported_with_their_cameras_where_they_were_found(tmp_path, rng):
    files = photo_sets.Files(tmp_path, photo_sets.POSES)
    photo_sets.transforms(files)
    trimesh.creation.box((0.8, 0.5, 0.6)).export(tmp_path / "box.ply")
    settings = ["scene=photos", f"photos.path={tmp_path}", f"photos.mesh={tmp_path / 'box.ply'}"]
    settings += ["photos.exposure=scale", "photos.refine=true", "photos.sky=4"]
    cfg = schema.typed(compose(translate(settings))).scene
    colour = "object.bsdf.brdf_0.base_color.value"
    arrays = {
        colour: np.array([0.2, 0.5, 0.7]),
        "sky.data": rng.uniform(0.5, 2, (4, 8, 3)),
        "exposure": np.array([[1.0], [2.0], [0.5]]),
        "cameras": rng.normal(0, 2, (3, 6)),
    }
    arrays["cameras"][0] = 0  # whose picture Mitsuba renders of both
    arrays = {key: array.astype(np.float32) for key, array in arrays.items()}
    earlier = arrays | {"cameras": arrays["cameras"][1:]}
    with pytest.raises(
        InputError, match=r"'cameras': the record has \(2, 6\), where it is \(3, 6\)"
    ):
        export.write(cfg, earlier, tmp_path / "earlier")
    path, told = export.write(cfg, arrays, tmp_path / "result")
    assert of_xml(told) == ["exposures are not in the file: multiply the views by 1, 2, 0.5"]
    assert glb.problems(path.with_suffix(".glb")) == []
    made = assemble.problem(cfg, TargetConfig(spp=1), lambda done, total: None)
    made.unknowns.write(made.unknowns.values_of(arrays))
    same(path, made.scene)
    loaded = mi.load_file(str(path), optimize=False)
    for view in range(3):
        at = dr.full(mi.UInt32, view), mi.UInt32(7), mi.UInt32(5)
        half = mi.Point2f(0.5), mi.Point2f(0.5)
        wanted, _ = rays.through(made.sensors, made.views, *at, *half)
        views = Views.of(made.film_sizes)
        got, _ = rays.through(loaded.sensors_dr(), views, *at, *half)
        assert dr.allclose(got.d, wanted.d, atol=1e-5)
        # Rays begin a thousandth of the way before the camera.
        assert dr.norm(dr.cross(got.o - wanted.o, wanted.d))[0] < 5e-4


def test_views_held_out_see_by_the_lens_that_was_found(tmp_path):
    """That of the views beside them, whose camera is the same."""
    photo_sets.transforms(photo_sets.Files(tmp_path, photo_sets.POSES))
    trimesh.creation.box((0.8, 0.5, 0.6)).export(tmp_path / "box.ply")
    settings = ["scene=photos", f"photos.path={tmp_path}", f"photos.mesh={tmp_path / 'box.ply'}"]
    settings += ["photos.lens=[focal]", "photos.test=[view_0.exr]", "photos.sky=4"]
    cfg = schema.typed(compose(translate(settings))).scene
    arrays = {
        "object.bsdf.brdf_0.base_color.value": np.array([0.2, 0.5, 0.7]),
        "sky.data": np.ones((4, 8, 3)),
        "lens": np.array([[0.0]]),
    }
    fields = []
    for lens in (0.0, 3.0):
        arrays["lens"][:] = lens
        found = {key: array.astype(np.float32) for key, array in arrays.items()}
        path, _ = export.write(cfg, found, tmp_path / f"lens{lens}")
        sensors = mi.load_file(str(path), optimize=False).sensors()
        fields.append([float(mi.traverse(each)["x_fov"][0]) for each in sensors])
    assert len(fields[0]) == 3 and np.ptp(fields[0]) < 1e-4 and np.ptp(fields[1]) < 1e-4
    assert abs(fields[0][0] - fields[1][0]) > 0.5


def test_what_cannot_be_exported_is_one_line(folder, tmp_path, refused):
    arrays = {ROUGH: np.array([0.25], np.float32)}
    with pytest.raises(InputError, match="the scene's own files are, .*: take another --output"):
        export.write(scene(folder / "scene.xml", arrays), arrays, folder)
    (folder / "file").write_text("")
    with pytest.raises(InputError, match="the result cannot be written"):
        export.write(scene(folder / "scene.xml", arrays), arrays, folder / "file" / "result")
    refused(["export", str(tmp_path / "nowhere")], "nowhere")


# Of each, what is found and how the file's material, light or texture says it.
BALL = """<scene version="{version}"><integrator type="{how}"><integer name="max_depth" value="3"/>
  </integrator>{camera}{light}<shape type="sphere" id="ball">{bsdf}</shape>{more}</scene>"""
SKY_ALONE = '<emitter type="constant" id="sky"><float name="radiance" value="1"/></emitter>'
HEIGHTS = '<texture type="bitmap" name="heights"><string name="filename" value="heights.exr"/>'
HEIGHTS += '<boolean name="raw" value="true"/></texture>'
PAINT_AFTER = '<texture type="bitmap" id="paint"><string name="filename" value="paint.png"/>'
PAINT_AFTER += "</texture>"
FOUND = {
    "gold, eta": (
        {"bsdf": '<bsdf type="roughconductor"><string name="material" value="Au"/></bsdf>'},
        ("ball.bsdf.eta.value", [0.2, 0.9, 1.5]),
    ),
    "silver, k": (
        {"bsdf": '<bsdf type="conductor"><string name="material" value="Ag"/></bsdf>'},
        ("ball.bsdf.k.value", [2.0, 3.0, 1.5]),
    ),
    "metal of one number": (
        {"bsdf": '<bsdf type="roughconductor"><float name="k" value="2"/></bsdf>'},
        ("ball.bsdf.eta.value", [0.7]),
    ),
    "sun": (
        {
            "light": '<emitter type="sunsky" id="sky"><vector name="sun_direction" x="0.4" y="-0.3"'
            ' z="0.8"/></emitter>'
        },
        ("sky.sun_direction", [0.6, 0.0, 0.8]),
    ),
    "bumps": (
        {"bsdf": f'<bsdf type="bumpmap">{HEIGHTS}<bsdf type="roughconductor"/></bsdf>'},
        ("ball.bsdf.nested_texture.data", None),
    ),
    "a texture that stands after what shows it": (
        {
            "bsdf": '<bsdf type="diffuse"><ref id="paint" name="reflectance"/></bsdf>',
            "more": PAINT_AFTER,
        },
        ("ball.bsdf.reflectance.data", None),
    ),
    "a material that the file does not name": ({}, ("ball.bsdf.reflectance.value", [0.1])),
    "chequers in a mask": (
        {
            "bsdf": '<bsdf type="mask"><texture type="checkerboard" name="opacity"/>'
            '<bsdf type="diffuse"/></bsdf>'
        },
        ("ball.bsdf.opacity.color0.value", [0.9]),
    ),
    "fog": (
        {
            "how": "volpath",
            "bsdf": '<bsdf type="null"/><medium type="homogeneous" name="interior">'
            '<float name="sigma_t" value="0.4"/></medium>',
        },
        ("ball.interior_medium.sigma_t.value.value", [1.3]),
    ),
    "a spectrum of its own": (
        {
            "bsdf": '<bsdf type="diffuse"><texture type="srgb" name="reflectance">'
            '<rgb name="color" value="0.2,0.3,0.4"/></texture></bsdf>'
        },
        ("ball.bsdf.reflectance.value", [0.7, 0.1, 0.2]),
    ),
    "an older file": (
        {
            "version": "0.6.0",
            "bsdf": '<bsdf type="diffuse"><rgb name="diffuseReflectance" '
            'value="0.2,0.3,0.4"/></bsdf>',
        },
        ("ball.bsdf.reflectance.value", [0.7, 0.1, 0.2]),
    ),
}


@pytest.mark.parametrize("name", FOUND)
def test_each_plugin_is_told_in_its_own_words(folder, rng, name):
    given, (key, value) = FOUND[name]
    images.write_exr(folder / "heights.exr", rng.random((4, 4, 1)), ["Y"], {})
    parts = {
        "version": "3.0.0",
        "how": "path",
        "camera": camera(width=8),
        "light": SKY_ALONE,
        "bsdf": "",
        "more": "",
    }
    (folder / "ball.xml").write_text(BALL.format(**parts | given))
    # With the file's integrator, and so its random numbers.
    own, _ = instances.instantiate(*scene_file.parse(str(folder / "ball.xml")))
    params = mi.traverse(own)
    before = np.array(mi.render(own, spp=16, seed=1))
    shape = np.array(params[key]).shape
    array = rng.uniform(0.2, 0.9, shape) if value is None else np.array(value)
    arrays = {key: array.astype(np.float32)}
    path, told = export.write(scene(folder / "ball.xml", arrays), arrays, folder / "result")
    assert of_xml(told) == []
    unknowns = Unknowns(params, parse(mi.traverse(own), {key: UnknownConfig(start=0.5)}, True))
    unknowns.write(unknowns.values_of(arrays))
    same(path, own)
    assert np.abs(np.array(mi.render(own, spp=16, seed=1)) - before).mean() > 1e-3 * before.mean()


# Its up is y.
SUN = """<emitter type="sunsky" id="sky"><vector name="sun_direction" x="0.4" y="0.8" z="0.3"/>
  <transform name="to_world"><rotate x="1" angle="-90"/></transform></emitter>"""


@pytest.mark.parametrize("towards", [{}, {"sky.sun_direction": [0.0, 0.6, 0.8]}])
def test_a_sun_is_turned_with_its_sky_unless_it_was_found_itself(folder, towards):
    parts = {"version": "3.0.0", "how": "path", "camera": camera(width=8), "bsdf": "", "more": ""}
    (folder / "ball.xml").write_text(BALL.format(light=SUN, **parts))
    poses = {"turn": PoseConfig(kind="rotation", objects=["sky"], axis=[0.0, 1.0, 0.0])}
    arrays = {"turn": [-50.0]} | towards
    arrays = {key: np.array(value, np.float32) for key, value in arrays.items()}
    path, _ = export.write(scene(folder / "ball.xml", arrays, poses), arrays, folder / "result")
    own, _ = instances.instantiate(*scene_file.parse(str(folder / "ball.xml")))
    specs = {key: UnknownConfig(start=0.5) for key in arrays}
    unknowns = Unknowns(mi.traverse(own), parse(mi.traverse(own), specs, True, poses))
    unknowns.write(unknowns.values_of(arrays))
    same(path, own, noisy=True)


PLACEHOLDERS = {
    "a sky that is black": (
        '<emitter type="envmap" id="sky"><string name="filename" value="black.exr"/></emitter>',
        {"sky.data": {"start": 0.5}},
    ),
    "a beam and a cone": (
        """<emitter type="spot" id="spot"><float name="beam_width" value="10"/>
        <float name="cutoff_angle" value="30"/><transform name="to_world">
        <lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform></emitter>""",
        {
            "spot.beam_width": {"start": 8, "range": [0, 12]},
            "spot.cutoff_angle": {"start": 25, "range": [15, 90]},
        },
    ),
}


@pytest.mark.parametrize("name", PLACEHOLDERS)
def test_what_the_scene_had_before_is_no_start_that_is_checked(folder, name):
    """A run that ended is exported, whatever its targets left to be found."""
    light, unknowns = PLACEHOLDERS[name]
    for file, size, value in (("black", (4, 8), 0.0), ("target", (8, 8), 0.3)):
        pixels = np.full((*size, 3), value, np.float32)
        images.write_exr(folder / f"{file}.exr", pixels, [*"RGB"], {})
    wall = f'{paths(3)}{camera(width=8)}{light}<shape type="rectangle" id="wall"/>'
    (folder / "wall.xml").write_text(f'<scene version="3.0.0">{wall}</scene>')
    run = ["scene=file", f"scene.path={folder / 'wall.xml'}", "sampler=uniform", *QUIET]
    run += [f"scene.targets=[{folder / 'target.exr'}]", f"scene.unknowns={json.dumps(unknowns)}"]
    run += ["estimator.batch=64", "evaluation.pixels=64", "budget.iterations=2"]
    arrays = ran(folder / "run", *run).parameters()
    assert main(["export", str(folder / "run")]) == 0
    params = mi.traverse(mi.load_file(str(folder / "run/result/scene.xml"), optimize=False))
    for key, array in arrays.items():
        value = np.array(params[key])
        value = value[:, 1:-1] if key == "sky.data" else value
        np.testing.assert_allclose(value.ravel(), array.ravel(), rtol=1e-4)


@pytest.mark.parametrize("kind", ["direct", "direct_projective"])
def test_a_length_of_paths_that_was_asked_for_is_in_the_file(folder, kind):
    arrays = {ROUGH: np.array([0.25], np.float32)}
    config = scene(folder / "scene.xml", arrays)
    config.max_depth = 2
    path, told = export.write(config, arrays, folder / "result")
    assert of_xml(told) == [] and "max_depth = 2" in str(mi.load_file(str(path)).integrator())
    (folder / "scene.xml").write_text(
        SCENE.replace('type="path"', f'type="{kind}"').replace(
            '<integer name="max_depth" value="3"/>', ""
        )
    )
    path, _ = export.write(config, arrays, folder / "result")
    assert "max_depth = 2" in str(mi.load_file(str(path)).integrator())


def test_a_grid_in_a_box_of_its_own_stays_there(folder, rng):
    """As `use_grid_bbox` has it."""
    low, high = np.float32([-1, -1, -1]), np.float32([0.5, 1, 0.5])
    with open(folder / "grid.vol", "r+b") as file:
        file.seek(24)
        file.write(np.concatenate([low, high]).astype("<f4").tobytes())
    own = '<string name="filename" value="grid.vol"/><boolean name="use_grid_bbox" value="true"/>'
    text = CLOUD.replace('<string name="filename" value="grid.vol"/>', own)
    (folder / "cloud.xml").write_text(text)
    key = "box.interior_medium.sigma_t.data"
    arrays = {key: rng.uniform(0.1, 2, (2, 3, 4, 1)).astype(np.float32)}
    path, _ = export.write(scene(folder / "cloud.xml", arrays), arrays, folder / "result")
    (folder / "grid.vol").unlink()
    medium = next(s for s in mi.load_file(str(path)).shapes()).interior_medium()
    box = mi.traverse(medium).hierarchy
    (grid,) = (each for each in box if isinstance(each, mi.Volume) and "Grid" in each.class_name())
    assert np.allclose([grid.bbox().min, grid.bbox().max], [low, high], atol=1e-5)


def test_what_no_file_of_mitsubas_holds_is_refused_with_what_to_do(folder):
    figure = '<shape type="ply"><string name="filename" value="figure.ply"/><ref id="paint"/>'
    figure += "</shape>"
    merged = f'<shape type="merge">{figure}{figure}</shape></scene>'
    text = SCENE.replace("</scene>", merged).replace('<shape type="ply" id="figure">', "<!--")
    text = text.replace('<shape type="sphere"', '--><shape type="sphere"')
    (folder / "scene.xml").write_text(text)
    own, *_ = scene_file.load(str(folder / "scene.xml"), None)
    (key,) = (key for key in mi.traverse(own).keys() if key.endswith("vertex_positions"))
    poses = {"up": PoseConfig(kind="translation", objects=[key.partition(".")[0]])}
    arrays = {"up": np.zeros(3, np.float32)}
    with pytest.raises(InputError, match="lies in merged shapes: take 'merge' out of the file"):
        export.write(scene(folder / "scene.xml", arrays, poses), arrays, folder / "result")


def test_a_full_memory_is_no_fault_of_the_results(folder, monkeypatch):
    def full(*unused, **settings):
        raise RuntimeError("jit_malloc(): out of memory!")

    monkeypatch.setattr(mi, "load_file", full)
    arrays = {RED: np.float32([0.7, 0.1, 0.2])}
    with pytest.raises(RuntimeError, match="out of memory"):
        export.write(scene(folder / "scene.xml", arrays), arrays, folder / "result")
    assert not (folder / "result/scene.xml").exists(), "nothing that was not checked"


def pictured(**more) -> dict:
    """A scene of a program's, with a bitmap of 8 bits that is not unknown."""
    pixels = np.linspace(0, 255, 24).astype(np.uint8).reshape(2, 4, 3)
    bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "format": "variant", **more}
    return {"paint": {"type": "diffuse", "reflectance": bitmap}}


@pytest.mark.parametrize("raw", [False, True])
def test_pictures_of_whole_numbers_are_written_as_mitsuba_takes_them(tmp_path, raw):
    described = pictured(raw=raw)
    whole = mi.load_dict(described["paint"])
    written = mi.load_dict(export._as_files(described, tmp_path, "")["paint"])
    a, b = (np.array(mi.traverse(each)["reflectance.data"]) for each in (whole, written))
    np.testing.assert_allclose(a, b, atol=2e-3)
    assert 0.9 < a.max() <= 1 and (a.mean() < 0.4) != raw


@pytest.mark.parametrize("kind", ["YA", "RGBA", "XYZ"])
def test_pictures_are_written_without_alpha_and_in_our_colours(tmp_path, rng, kind):
    pixels = rng.uniform(0.3, 0.6, (2, 4, len(kind))).astype(np.float32)
    bitmap = mi.Bitmap(pixels, getattr(mi.Bitmap.PixelFormat, kind))
    described = pictured(bitmap=bitmap)
    whole = mi.load_dict(described["paint"])
    written = mi.load_dict(export._as_files(described, tmp_path, "")["paint"])
    a, b = (np.array(mi.traverse(each)["reflectance.data"]) for each in (whole, written))
    np.testing.assert_allclose(a, b, atol=1e-5)


def test_maps_that_are_no_colours_are_marked_as_data(folder, rng):
    rough = '<texture type="bitmap" name="roughness"><string name="filename" value="other.png"/>'
    text = SCENE.replace('<float name="roughness" value="0.4"/>', f"{rough}</texture>")
    (folder / "scene.xml").write_text(text)
    spaces = {PAINT: "lin_rec709_scene", "paint.brdf_0.roughness.data": "data"}
    arrays = {key: rng.uniform(0.3, 0.6, (4, 6, 3)).astype(np.float32) for key in spaces}
    export.write(scene(folder / "scene.xml", arrays), arrays, folder / "result")
    for key, space in spaces.items():
        spec = oiio.ImageInput.open(str(folder / f"result/{key}.exr")).spec()
        assert spec.get_string_attribute("oiio:ColorSpace") == space


def test_nothing_of_the_users_is_written_over(folder):
    """Where the file lies, where its files do, and where another scene does."""
    (folder / "meshes").mkdir()
    (folder / "figure.ply").rename(folder / "meshes/figure.ply")
    (folder / "scene.xml").write_text(SCENE.replace("figure.ply", "meshes/figure.ply"))
    before = (folder / "meshes/figure.ply").read_bytes()
    (folder / "other").mkdir()
    (folder / "other/scene.xml").write_text("mine")
    for place in (folder, folder / "meshes", folder / "other"):
        with pytest.raises(InputError, match="take another --output"):
            export.write(scene(folder / "scene.xml", [RED]), {RED: np.ones(3, np.float32)}, place)
    assert (folder / "meshes/figure.ply").read_bytes() == before
    for _ in range(2):  # its own it may replace
        arrays = {RED: np.full(3, 0.5, np.float32)}
        export.write(scene(folder / "scene.xml", [RED]), arrays, folder / "result")


def test_a_scene_with_properties_of_its_own_is_written(folder):
    own = '<boolean name="embree_use_robust_intersections" value="true"/>'
    text = SCENE.replace('version="3.0.0">', f'version="3.0.0">{own}', 1)
    (folder / "scene.xml").write_text(text)
    arrays = {RED: np.full(3, 0.5, np.float32)}
    path, _ = export.write(scene(folder / "scene.xml", [RED]), arrays, folder / "result")
    assert np.allclose(found(path, {RED: 3})[RED], 0.5)


def test_painted_meshes_of_like_names_stay_apart(folder):
    shapes = "".join(
        f'<shape type="cube" id="{id}"><bsdf type="diffuse"><texture type="bitmap" '
        'name="reflectance"><string name="filename" value="other.png"/></texture></bsdf></shape>'
        for id in ("cup 1", "cup_1")
    )
    (folder / "scene.xml").write_text(SCENE.replace("</scene>", f"{shapes}</scene>"))
    arrays = {RED: np.full(3, 0.5, np.float32)}
    export.write(scene(folder / "scene.xml", [RED]), arrays, folder / "result")
    assert len(list((folder / "result/painted").glob("cup_1*.obj"))) == 2


def test_meshes_that_share_a_picture_share_its_file(folder):
    paint = '<bsdf type="diffuse" id="all"><texture type="bitmap" name="reflectance">'
    paint += '<string name="filename" value="other.png"/></texture></bsdf>'
    shapes = "".join(f'<shape type="cube" id="{id}"><ref id="all"/></shape>' for id in ("a", "b"))
    (folder / "scene.xml").write_text(SCENE.replace("</scene>", f"{paint}{shapes}</scene>"))
    export.write(scene(folder / "scene.xml", [RED]), {RED: np.full(3, 0.5)}, folder / "result")
    painted = folder / "result/painted"
    assert (painted / "a.png").exists() and not (painted / "b.png").exists()
    pictures = [
        np.asarray(trimesh.load(painted / f"{name}.obj", process=False).visual.material.image)
        for name in ("a", "b")
    ]
    assert pictures[0].shape == (4, 6, 3) and np.array_equal(*pictures)


def as_shown(folder, name: str) -> np.ndarray:
    """The picture of a painted mesh, in steps of a byte from that of ``other.png``."""
    painted = trimesh.load(folder / f"result/painted/{name}.obj", process=False)
    own = images.to_display(images.read(folder / "other.png"))
    return np.asarray(painted.visual.material.image, int) - own


def test_files_of_bytes_that_a_builder_names_are_exported(folder, rng, monkeypatch):
    described = {"type": "scene", "sky": {"type": "constant"}, "eye": {"type": "perspective"}}
    for id, file in (("sought", "paint.png"), ("known", "other.png")):
        bitmap = {"type": "bitmap", "filename": str(folder / file)}
        described[id] = {"type": "cube", "bsdf": {"type": "diffuse", "reflectance": bitmap}}
    monkeypatch.setattr(built.allowed, "named", lambda *_: lambda: described)
    key = "sought.bsdf.reflectance.data"
    unknowns = {key: UnknownConfig(start=0.5)}
    config = SceneConfig(name="own", builder="own.build", unknowns=unknowns)
    arrays = {key: rng.random((4, 6, 3)).astype(np.float32)}
    path, told = export.write(config, arrays, folder / "result")
    assert np.allclose(found(path, {key: (4, 6, 3)})[key], arrays[key], atol=1e-6)
    assert np.abs(as_shown(folder, "known")).max() <= 1
    assert not any("outside 0 to 1" in line for line in told)
    assert glb.problems(path.with_suffix(".glb")) == []


def test_a_picture_that_is_to_be_kept_in_bytes_is_shown_as_it_is(folder):
    paint = '<bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
    paint += '<string name="filename" value="other.png"/><string name="format" value="uint8"/>'
    box = f'<shape type="cube" id="box">{paint}</texture></bsdf></shape></scene>'
    (folder / "scene.xml").write_text(SCENE.replace("</scene>", box))
    arrays = {RED: np.full(3, 0.5, np.float32)}
    path, told = export.write(scene(folder / "scene.xml", [RED]), arrays, folder / "result")
    assert np.abs(as_shown(folder, "box")).max() <= 1
    assert not any("outside 0 to 1" in line for line in told)
    assert 'name="format" value="uint8"' in path.read_text()


def test_ids_may_be_what_no_file_is_called(folder, rng):
    """As Blender's exporters name things in a collection."""
    text = SCENE.replace('"figure"', '"World/Cup"').replace('"paint"', '"World/Paint"')
    (folder / "scene.xml").write_text(text)
    key = PAINT.replace("paint", "World/Paint")
    poses = {"up": PoseConfig(kind="translation", objects=["World/Cup"])}
    arrays = {key: rng.random((4, 6, 3)), "up": np.array([0.0, 0.25, 0.0])}
    arrays = {name: array.astype(np.float32) for name, array in arrays.items()}
    path, _ = export.write(scene(folder / "scene.xml", arrays, poses), arrays, folder / "result")
    assert np.allclose(found(path, {key: (4, 6, 3)})[key], arrays[key], atol=1e-6)
    assert (folder / "result" / "World%2FCup.ply").is_file()


def test_files_of_others_keep_their_names(folder, rng):
    """What the scene names is brought beside them, the second time by the same name."""
    output = folder / "mine"
    output.mkdir()
    (output / "other.png").write_text("somebody's own")
    arrays = {PAINT: rng.random((4, 6, 3)).astype(np.float32)}
    names = []
    for _ in range(2):
        path, _ = export.write(scene(folder / "scene.xml", arrays), arrays, output)
        names.append(sorted(re.findall(r'value="([^"]+\.[a-z]+)"', path.read_text())))
    assert names[0] == names[1] and names[0]
    assert (output / "other.png").read_text() == "somebody's own"
