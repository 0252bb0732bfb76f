"""The scenes: each builds, and has an unknown; broken meshes are refused. What their views show:
test_tiny_scenes.py."""

import dataclasses
import fnmatch
import importlib
import re
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import yaml
from isas_cli.scenes import caustic_failure, earth, earth2mars, library, meshes, multires
from isas_cli.scenes.bake import bake, unfold
from isas_cli.scenes.lathe import turn
from isas_cli.scenes.subdivide import subdivide

from isas_cli.config import schema
from isas_cli.config.compose import compose
from isas_cli.engine import assemble
from isas_cli.runtime import backend
from isas_cli.runtime.errors import InputError
from isas_cli.scene import built

pytestmark = pytest.mark.usefixtures("two_threads")

ROOT = Path(__file__).resolve().parents[2]
NAMES = [
    "pottery",
    "jumpydumpy",
    "dodoco",
    "catcake",
    "multires",
    "earth2mars",
    "trashcan",
    "earth",
    "dodoco_a",
    "bowl",
    "caustic_failure",
]
# Textures of globes are half as high as wide.
GLOBES = {"earth.bsdf", "mars.bsdf", "globe.bsdf"}


def config(name: str) -> dict:
    return yaml.safe_load((ROOT / "configs" / "scene" / f"{name}.yaml").read_text())


def build(name: str) -> dict:
    """The scene dictionary at the size `tiny`, through the builder that the config names."""
    module, function = config(name)["builder"].rsplit(".", 1)
    builder = getattr(importlib.import_module(module), function)
    return builder(**config(name)["sizes"]["tiny"])


@pytest.fixture(scope="module", params=NAMES)
def loaded(request) -> tuple:
    """Config, scene and parameters of one scene at the size `tiny`, holding the truth."""
    scene = mi.load_dict(build(request.param), optimize=False)
    return config(request.param), scene, mi.traverse(scene)


def test_sensors_are_as_many_and_as_large_as_asked(loaded):
    wanted, scene, _ = loaded
    size = wanted["sizes"]["tiny"]
    assert len(scene.sensors()) == size.get("views", 1)
    for view, sensor in enumerate(scene.sensors()):
        assert sensor.id() == f"sensor_{view:03d}"
        assert list(sensor.film().size()) == [size["resolution"]] * 2
        assert "BoxFilter" in str(sensor.film().rfilter())


def test_unknowns_exist_and_truth_and_start_are_legal(loaded):
    wanted, _, parameters = loaded
    for key, unknown in wanted["unknowns"].items():
        truth = np.array(parameters[key])
        low, high = unknown["range"]
        assert low <= truth.min() and truth.max() <= high
        start = unknown["start"]
        if isinstance(start, dict):
            start = np.array(parameters[start["of"]])
            assert start.shape == truth.shape
        assert low < np.min(start) and np.max(start) < high
        assert np.abs(truth - start).mean() > 0.1


def test_textures_are_float32_of_the_size_asked_for(loaded):
    wanted, _, parameters = loaded
    for key in wanted["unknowns"]:
        if key.endswith(".data"):
            size = wanted["sizes"]["tiny"]["texture"]
            height = size // 2 if key.split(".base_color")[0] in GLOBES else size
            assert parameters[key].shape == (height, size, 3)
            assert dr.type_v(parameters[key]) == dr.VarType.Float32


def test_builders_are_deterministic(loaded):
    wanted, _, first = loaded
    second = mi.traverse(mi.load_dict(build(wanted["name"]), optimize=False))
    assert first.keys() == second.keys()
    for key in first.keys():
        if hasattr(first[key], "shape"):
            np.testing.assert_array_equal(np.array(first[key]), np.array(second[key]), key)


def test_the_depth_of_paths_is_a_setting():
    scene = schema.typed(compose(["scene=pottery", "size=tiny", "scene.max_depth=2"])).scene
    assert built.load(built.description(scene)).integrator().max_depth == 2


@pytest.fixture
def by(monkeypatch):
    """→ the settings of a scene of a ``build`` of one's own, with these arguments."""

    def scene(build, max_depth=None, **arguments) -> schema.SceneConfig:
        monkeypatch.setattr(built.allowed, "named", lambda *_: build)
        usual = schema.typed(compose(["scene=pottery", "size=tiny"])).scene
        own = {"builder": "own.build", "arguments": arguments, "max_depth": max_depth}
        return dataclasses.replace(usual, **own)

    return scene


def test_a_builder_may_keep_what_it_gives(by):
    held = {"type": "scene", "integrator": {"type": "prb"}}
    made = built.description(by(lambda: held, max_depth=2))
    assert made["integrator"] == {"type": "prb", "max_depth": 2}
    assert held["integrator"] == {"type": "prb"}


def test_a_builder_may_take_any_arguments_and_be_annotated_by_any_names(by):
    def build(first: int, *rest, **more) -> dict:
        return {"type": "scene", "first": first, **more}

    build.__annotations__["return"] = "nowhere.Scene"
    made = built.description(by(build, first=1, other=2))
    assert made == {"type": "scene", "first": 1, "other": 2}
    with pytest.raises(InputError, match="scene.arguments.first is missing"):
        built.description(by(build, other=2))


def test_what_a_builder_gives_is_checked(by):
    for wrong in (None, [], {"type": "sphere"}, mi.ScalarTransform4f()):
        with pytest.raises(InputError, match="scene.builder=own.build: gives no scene"):
            built.description(by(lambda: wrong))
    made = {"type": "scene", "integrator": mi.load_dict({"type": "prb"})}
    assert built.description(by(lambda: made)) is made
    with pytest.raises(InputError, match="scene.max_depth=2: .* has made its integrator already"):
        built.description(by(lambda: made, max_depth=2))
    slip = {"type": "scene", "ball": {"type": "sphere", "radios": 1.0}}
    with pytest.raises(InputError, match="scene.builder=own.build: Mitsuba cannot .*radios"):
        assemble.bare(by(lambda: slip))


def test_a_builder_s_files_are_not_looked_for_beside_an_earlier_scene(by, tmp_path):
    backend.look_beside(tmp_path)
    assert str(tmp_path) in list(mi.file_resolver())
    built.description(by(lambda: {"type": "scene"}))
    assert str(tmp_path) not in list(mi.file_resolver())


def test_surfaces_are_principled_or_clear_glass(loaded):
    """As in the paper; a principled lobe has no smooth limit, so glass has a model of its own."""
    _, scene, _ = loaded
    for shape in scene.shapes():
        text = str(shape.bsdf())
        models = ("Principled", "ThinDielectric", "SmoothDielectric")
        # Whatever has neither emits: the lamp of caustic_failure.
        assert any(model in text for model in models) or shape.is_emitter(), f"{shape.id()}: {text}"


def test_assets_are_attributed_and_licensed():
    listed = re.findall("`([^`]+)`", (ROOT / "ATTRIBUTION.md").read_text())
    files = [path for path in library.ASSETS.rglob("*") if path.is_file()]
    assert files
    for path in files:
        relative = path.relative_to(library.ASSETS).as_posix()
        assert any(fnmatch.fnmatchcase(relative, each) for each in listed), relative


def test_both_sides_of_the_globe_are_seen():
    """Its front straight on, its back in the mirror, which stands where it shows it."""
    dictionary = earth.build(resolution=64, texture=64)
    strength = []
    for without in ((), ("mirror", "board")):
        for name in without:
            del dictionary[name]
        scene = mi.load_dict(dictionary, optimize=False)
        parameters = mi.traverse(scene)
        key = "globe.bsdf.base_color.data"
        dr.enable_grad(parameters[key])
        parameters.update()
        dr.backward(dr.sum(mi.render(scene, parameters, spp=64)))
        strength.append(np.array(dr.grad(parameters[key])).mean(axis=2))
    both, front = strength
    # What is not seen straight on still lights other things a little.
    weak = 0.2 * np.median(front[front > np.median(front)])
    print((front > weak).mean(), (both > weak).mean())
    assert (both > weak).mean() > (front > weak).mean() + 0.2


def test_the_globe_under_glass_is_the_noisy_one():
    """Relative variance of a single path's radiance, over the pixels of either globe."""
    scene = mi.load_dict(earth2mars.build(views=1, resolution=48, texture=64), optimize=False)
    images = np.stack([np.array(mi.render(scene, spp=1, seed=i)).mean(axis=2) for i in range(64)])
    camera = scene.sensors()[0]
    v, u = (np.indices((48, 48)).reshape(2, -1) + 0.5) / 48
    ray, _ = camera.sample_ray(0.0, 0.0, mi.Point2f(u.astype(np.float32), v.astype(np.float32)), 0)
    relative = {}
    for name in ("earth", "mars"):
        globe = next(shape for shape in scene.shapes() if shape.id() == name)
        seen = images[:, np.array(globe.ray_test(ray)).reshape(48, 48)]
        assert seen.shape[1] > 0.05 * 48**2, f"{name} is small"
        relative[name] = seen.var(axis=0).mean() / seen.mean() ** 2
    print(relative)
    assert relative["mars"] > 3 * relative["earth"]


def test_the_ball_throws_a_caustic():
    """Floor beyond the ball is brighter than the same floor without it, and rarely found so."""
    dictionary = caustic_failure.build(resolution=48, texture=32)
    scene = mi.load_dict(dictionary, optimize=False)
    image = np.array(mi.render(scene, spp=2048)).mean(axis=2)
    once = np.array(mi.render(scene, spp=1, seed=1)).mean(axis=2)
    del dictionary["ball"]
    bare = np.array(mi.render(mi.load_dict(dictionary, optimize=False), spp=64)).mean(axis=2)
    lit = image > 5 * bare.max()
    assert 3 <= lit.sum() < 0.05 * lit.size
    assert (once[lit] < bare.min()).mean() > 0.5


def test_parts_of_the_cake_share_a_texture_without_sharing_texels():
    surface, albedo = multires._cake(64)
    assert albedo.shape == (64, 64, 3)
    assert 0 <= surface.texcoords.min() and surface.texcoords.max() <= 1
    middle = surface.texcoords[surface.faces][:, :, 1] < 0.5
    assert (middle.all(axis=1) | ~middle.any(axis=1)).all()
    assert 0 < middle.mean() < 1


@pytest.mark.parametrize("name", ["city", "forest", "sunrise", "sunset"])
def test_environment_maps_are_not_negative(name):
    pixels = np.array(library.environment(f"hdri/{name}.exr")["bitmap"])
    assert np.isfinite(pixels).all() and pixels.min() >= 0


def test_missing_asset_is_named():
    with pytest.raises(InputError, match="nothing.obj"):
        library.asset("models/nothing.obj")


def quad() -> meshes.Surface:
    """A unit square of two triangles in the plane z = 0, its atlas covering half the width."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)
    return meshes.Surface(
        vertices=np.hstack([corners, np.zeros((4, 1), dtype=np.float32)]),
        faces=np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32),
        texcoords=corners * np.array([0.5, 1.0], dtype=np.float32),
        normals=np.tile(np.array([[0, 0, 1]], dtype=np.float32), (4, 1)),
    )


@pytest.mark.parametrize(
    ("field", "index", "value", "message"),
    [
        ("texcoords", 2, [1e9, 0.0], "texture coordinate of vertex 2 .* beyond"),
        ("texcoords", 1, [np.nan, 0.0], "texture coordinate of vertex 1 is not finite"),
        ("vertices", 3, [np.inf, 0.0, 0.0], "position of vertex 3 is not finite"),
        ("faces", 1, [0, 2, 2], "triangle 1 has no area"),
    ],
)
def test_broken_meshes_are_refused(field, index, value, message):
    arrays = {name: getattr(quad(), name).copy() for name in ("vertices", "texcoords", "faces")}
    meshes.check(**arrays, name="quad")
    arrays[field][index] = value
    with pytest.raises(InputError, match=message):
        meshes.check(**arrays, name="quad")


def test_normals_of_a_thin_sheet_do_not_cancel():
    """Both sides of a triangle, which share its corners, keep normals of their own."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32)
    normals = meshes.corner_normals(positions, np.array([[0, 1, 2], [0, 2, 1]]))
    np.testing.assert_allclose(normals, [[[0, 0, 1]] * 3, [[0, 0, -1]] * 3])


def test_missing_and_incomplete_mesh_files_are_named(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        meshes.read_obj(tmp_path / "absent.obj")
    bare = tmp_path / "bare.obj"
    bare.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="bare.obj has no texture coordinates"):
        meshes.read_obj(bare)


def test_a_mesh_without_a_texture_needs_no_coordinates(tmp_path):
    bare = tmp_path / "bare.obj"
    bare.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    surface = meshes.read_obj(bare, textured=False)
    assert surface.texcoords.shape == (0, 2)
    shape = meshes.shape("bare", meshes.place(surface), {"type": "principled"})
    assert not shape.has_vertex_texcoords() and shape.face_count() == 1
    textured = meshes.read_obj(library.asset("models/cat/cat.obj"), textured=False)
    assert not len(textured.texcoords)


PARTS = """v 0 0 0
v 2 0 0
v 0 2 0
v 4 2 0
vt 0 0
vt 1 0
vt 0 1
usemtl Red
f 1/1 2/2 3/3
usemtl Sky Blue
f 2/1 4/2 3/3
f 2/1 4/2 2/1
"""


def test_a_material_is_a_part_of_its_mesh(tmp_path):
    path = tmp_path / "parts.obj"
    path.write_text(PARTS)
    red = meshes.read_obj(path, material="Red")
    assert len(red.faces) == 1
    np.testing.assert_allclose(red.vertices[red.faces[0]], [[0, 0, 0], [2, 0, 0], [0, 2, 0]])
    with pytest.raises(InputError, match="Sky Blue.*triangle 1 has no area"):
        meshes.read_obj(path, material="Sky Blue")
    blue = meshes.read_obj(path, material="Sky Blue", flat=True)
    np.testing.assert_allclose(blue.vertices[blue.faces], [[[2, 0, 0], [4, 2, 0], [0, 2, 0]]])
    with pytest.raises(InputError, match="no material 'Blue'; it has: Red, Sky Blue"):
        meshes.read_obj(path, material="Blue")


def test_parts_stay_together_when_placed(tmp_path):
    path = tmp_path / "parts.obj"
    path.write_text(PARTS)
    whole = meshes.read_obj(path, flat=True)
    parts = [meshes.read_obj(path, material=name, flat=True) for name in ("Red", "Sky Blue")]
    move = meshes.placement(whole, height=0.5, turn=40, at=(3.0, 1.0))
    together = np.concatenate([move(part).vertices for part in parts])
    placed = meshes.place(whole, height=0.5, turn=40, at=(3.0, 1.0)).vertices
    np.testing.assert_allclose(np.sort(together, axis=0), np.sort(placed, axis=0), atol=1e-6)
    # Each by itself would stand in the middle.
    alone = meshes.place(parts[0], height=0.5, turn=40, at=(3.0, 1.0)).vertices
    assert np.abs(move(parts[0]).vertices - alone).max() > 0.01


def test_a_turned_cylinder_looks_outwards_and_has_no_seam():
    cylinder = turn(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 3.0]]), 64)
    meshes.check(cylinder.vertices, cylinder.texcoords, cylinder.faces, "cylinder")
    corners = cylinder.vertices[cylinder.faces].astype(np.float64)
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middle = corners.mean(axis=1)
    wall = middle[:, 1] > 1e-6
    assert ((facing * middle)[wall][:, [0, 2]].sum(axis=1) > 0).all()
    assert (facing[~wall][:, 1] < 0).all()
    # The area of a disk and a wall, less what 64 corners cut off.
    areas = np.linalg.norm(facing, axis=1) / 2
    assert areas[wall].sum() == pytest.approx(2 * np.pi * 2 * 3, rel=0.002)
    assert areas[~wall].sum() == pytest.approx(np.pi * 4, rel=0.003)
    seam = np.abs(cylinder.vertices - [0, 3, 2]).max(axis=1) < 1e-6
    assert np.ptp(cylinder.texcoords[seam][:, 0]) == 1
    assert np.ptp(cylinder.normals[seam], axis=0).max() < 1e-6


def test_placed_mesh_stands_on_the_ground_at_its_place():
    surface = meshes.read_obj(library.asset("models/cat/cat.obj"))
    placed = meshes.place(surface, height=0.7, turn=30, at=(2.0, -1.0))
    low, high = placed.vertices.min(axis=0), placed.vertices.max(axis=0)
    np.testing.assert_allclose([low[1], high[1]], [0, 0.7], atol=1e-6)
    np.testing.assert_allclose((low + high)[[0, 2]] / 2, [2, -1], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(placed.normals, axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("relative", ["models/old_jar/old_jar.obj", "models/cat/cat.obj"])
def test_subdivision_keeps_a_closed_mesh_whole(relative):
    coarse = meshes.read_obj(library.asset(relative))
    fine = subdivide(coarse, levels=2, name=relative)
    meshes.check(fine.vertices, fine.texcoords, fine.faces, relative)
    assert np.isfinite(fine.normals).all()
    assert len(fine.faces) == 16 * len(coarse.faces)
    # Linear in texture space: the charts keep their total area.
    assert chart_area(fine) == pytest.approx(chart_area(coarse), rel=1e-4)
    # Closed and consistently oriented: the face vectors of a closed surface sum to zero.
    a, b, c = (fine.vertices[fine.faces[:, i]].astype(np.float64) for i in range(3))
    vectors = np.cross(b - a, c - a)
    assert np.abs(vectors.sum(axis=0)).max() < 1e-4 * np.abs(vectors).sum()


def chart_area(surface: meshes.Surface) -> float:
    a, b, c = (surface.texcoords[surface.faces[:, i]].astype(np.float64) for i in range(3))
    (x, y), (s, t) = (b - a).T, (c - a).T
    return float(np.abs(x * t - y * s).sum() / 2)


def test_subdivision_moves_the_vertices_of_an_octahedron_by_the_masks():
    corners = np.array(
        [[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]], np.float32
    )
    faces = np.array(
        [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    )
    octahedron = meshes.Surface(corners, faces, np.zeros((6, 2), np.float32), corners)
    fine = subdivide(octahedron, levels=1, name="octahedron")
    # Valence 4: weight (5/8 - (3/8)²) / 4 for each neighbour, and these cancel by symmetry.
    old = 1 - (5 / 8 - (3 / 8) ** 2)
    # Edge points: 3/8 of both ends, 1/8 of the opposite vertices, which cancel.
    middle = 3 / 8 * 2**0.5
    radii = np.unique(np.linalg.norm(fine.vertices, axis=1).round(5))
    np.testing.assert_allclose(radii, sorted([round(old, 5), round(middle, 5)]), atol=1e-5)


def test_open_meshes_are_not_subdivided():
    with pytest.raises(InputError, match="not closed"):
        subdivide(quad(), levels=1, name="quad")


def test_baked_paint_lies_where_the_renderer_looks_it_up():
    """Paint the position itself; a texture lookup at a texel's centre gives it back."""
    size = 8
    positions, normals, covered = unfold(quad(), size)
    assert covered[:, : size // 2].all() and not covered[:, size // 2 :].any()
    np.testing.assert_allclose(normals[covered], np.tile([[0, 0, 1]], (size * size // 2, 1)))
    image = bake(quad(), size, lambda place, _: place)
    np.testing.assert_allclose(image[:, : size // 2], positions[:, : size // 2], atol=1e-3)
    # Texels outside the chart repeat the nearest one inside.
    np.testing.assert_allclose(image[:, -1, 1], image[:, size // 2 - 1, 1], atol=1e-6)
    texture = mi.load_dict(library.texture(image))
    hit = dr.zeros(mi.SurfaceInteraction3f)
    hit.uv = mi.Point2f((2 + 0.5) / size, (5 + 0.5) / size)
    np.testing.assert_allclose(np.array(texture.eval(hit)).ravel(), positions[5, 2], atol=1e-3)
