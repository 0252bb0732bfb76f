"""Meshes as people have them: several materials, several nodes; and the sphere in place of one."""

import base64
import io
import json
import struct
import tracemalloc

import mitsuba as mi
import numpy as np
import photo_sets
import pytest
import trimesh
from photo_sets import POSES, Files
from PIL import Image
from test_photo_maps import built

from isas_cli.config import schema
from isas_cli.config.compose import compose, translate
from isas_cli.config.schema import PhotosConfig
from isas_cli.engine import assemble
from isas_cli.runtime import backend, memory
from isas_cli.runtime.errors import InputError
from isas_cli.scene import export
from isas_cli.scene.photos import photographs, shape
from isas_cli.scene.photos.base import Capture
from isas_cli.scene.topology import Topology

CORNERS = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\n"
LEFT, RIGHT = "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n", "f 2/{} 5/{} 6/{}\nf 2/{} 6/{} 3/{}\n"
OWN = "vt 0 0\nvt 0.4 0\nvt 0.4 1\nvt 0 1\nvt 0.6 0\nvt 1 0\nvt 1 1\nvt 0.6 1\n"
APART = RIGHT.format(5, 6, 7, 5, 7, 8)
OVER = RIGHT.format(1, 2, 3, 1, 3, 4)  # the same texels


def obj(folder, text: str) -> str:
    (folder / "mesh.obj").write_text(CORNERS + OWN + text)
    return str(folder / "mesh.obj")


def parts(path: str, **settings) -> dict:
    return shape.parts(PhotosConfig(mesh=path, **settings), Capture([], "none"))


def as_in_the_file(part, left: float, right: float) -> bool:
    """Whether u goes from ``left`` to ``right`` along x, and v is 1 - y, as the file says."""
    u, v = part.texcoords.T
    x, y = part.vertices[:, 0], part.vertices[:, 1]
    wanted = left + (right - left) * (x - x.min())
    return np.allclose(u, wanted, atol=1e-6) and np.allclose(v, 1 - y, atol=1e-6)


@pytest.mark.parametrize("library", [True, False])
@pytest.mark.parametrize("words", ["usemtl {}\n", "o {0}\nusemtl {0}\n"])
@pytest.mark.parametrize("second", [APART, OVER])
def test_a_map_each(tmp_path, library, words, second):
    """Of the file's own coordinates, whether they overlap or not, whether the file of materials is
    there or not."""
    text = f"{words.format('wood')}{LEFT}{words.format('red paint.2')}{second}"
    path = obj(tmp_path, f"mtllib mesh.mtl\n{text}")
    if library:
        (tmp_path / "mesh.mtl").write_text("newmtl wood\nKd 1 0 0\nnewmtl red paint.2\nKd 1 1 0\n")
    found = parts(path)
    assert list(found) == ["object_wood", "object_red_paint_2"]
    assert as_in_the_file(found["object_wood"], 0, 0.4)
    assert as_in_the_file(found["object_red_paint_2"], *((0.6, 1) if second == APART else (0, 0.4)))
    assert len(shape.joined(list(found.values())).faces) == 4


def test_one_map_where_coordinates_do_not_overlap(tmp_path):
    path = obj(tmp_path, f"usemtl a\n{LEFT}usemtl b\n{APART}")
    found = parts(path, materials="one")
    assert list(found) == ["object"] and len(found["object"].texcoords) == 12
    path = obj(tmp_path, f"usemtl a\n{LEFT}usemtl b\n{OVER}")
    with pytest.raises(InputError, match="2 materials of .*mesh.obj share .*photos.materials=each"):
        parts(path, materials="one")


def test_materials_without_coordinates(tmp_path):
    """A colour each; beside one that has some, too."""
    plain = LEFT.replace("/1", "").replace("/2", "").replace("/3", "").replace("/4", "")
    path = obj(tmp_path, f"usemtl a\n{plain}usemtl b\n{APART}")
    found = parts(path)
    assert len(found["object_a"].texcoords) == 0 and as_in_the_file(found["object_b"], 0.6, 1)
    with pytest.raises(InputError, match="material a of .* has no texture coordinates"):
        parts(path, materials="one")
    path = obj(tmp_path, plain + APART)
    with pytest.raises(InputError, match="only some have texture coordinates: unwrap"):
        parts(path)


def test_nodes_of_gltf(tmp_path):
    """Where they stand; those of one material are one."""
    square = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    uv = [[0, 0], [1, 0], [1, 1], [0, 1]]
    scene = trimesh.Scene()
    for number, name in enumerate(("red", "blue", "red")):
        each = square.copy()
        colour = [255 * (name == "red"), 0, 255 * (name == "blue"), 255]
        material = trimesh.visual.material.PBRMaterial(name=name, baseColorFactor=colour)
        each.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
        place = trimesh.transformations.translation_matrix([2 * number, 0, 0])
        scene.add_geometry(each, transform=place)
    scene.export(tmp_path / "mesh.glb")
    found = parts(str(tmp_path / "mesh.glb"))
    assert {name: len(part.faces) for name, part in found.items()} == {
        "object_red": 4,
        "object_blue": 2,
    }
    assert as_in_the_file(found["object_blue"], 0, 1)
    assert sorted(set(found["object_red"].vertices[:, 0].tolist())) == [0, 1, 4, 5]


def test_edges_between_materials_stay_smooth(tmp_path):
    """Normals are those of the whole surface."""
    ball = trimesh.creation.icosphere(3)
    lines = ["v {} {} {}".format(*v) for v in ball.vertices] + ["usemtl a"]
    for number, face in enumerate(ball.faces + 1):
        lines += ["usemtl b"] * (number == 600) + ["f {} {} {}".format(*face)]
    (tmp_path / "ball.obj").write_text("\n".join(lines))
    found = parts(str(tmp_path / "ball.obj"))
    assert len(found) == 2
    for part in found.values():
        np.testing.assert_allclose(part.normals, part.vertices, atol=0.02)


def test_normals_of_many_corners_at_one_place_take_little_memory(monkeypatch):
    """Of a flat cone, whose tip is smooth."""
    count = 1000
    angle, number = np.linspace(0, 2 * np.pi, count, endpoint=False), np.arange(count)
    rim = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    vertices = np.vstack([[0, 0, 0.3], rim]).astype(np.float32)
    faces = np.column_stack([0 * number, 1 + number, 1 + (number + 1) % count]).astype(np.uint32)
    whole = shape._smoothed(vertices, faces, np.zeros((0, 2), np.float32))
    tip = whole.normals.reshape(-1, 3, 3)[:, 0]
    np.testing.assert_allclose(tip, [[0, 0, 1]] * count, atol=1e-5)
    monkeypatch.setattr(memory, "_PART", 4096)
    tracemalloc.start()
    again = shape._smoothed(vertices, faces, np.zeros((0, 2), np.float32))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_allclose(again.normals, whole.normals, atol=1e-6)
    assert most < 8e6  # of all pairs at once: 72e6


@pytest.fixture
def two(tmp_path) -> list[str]:
    photo_sets.transforms(Files(tmp_path, POSES))
    path = obj(tmp_path, f"usemtl a\n{LEFT}usemtl b\n{OVER}")
    return ["scene=photos", f"photos.path={tmp_path}", f"photos.mesh={path}", "photos.texture=8"]


def test_each_is_an_unknown_and_leaves_again(two, tmp_path, rng):
    cfg, made, _ = built([*two, "photos.sky=4", "photos.roughness=true"])
    keys = [f"object_{name}.bsdf.brdf_0.{what}" for name in "ab" for what in ("base_color.data",)]
    assert set(keys) < set(made.unknowns.keys) and len(made.unknowns.keys) == 5
    arrays = {u.key: rng.uniform(0.3, 0.6, u.start.shape).astype(np.float32) for u in made.unknowns}
    path, _ = export.write(cfg, arrays, tmp_path / "result")
    with backend.loading():  # of EXR files, for which a worker's one thread is not enough
        params = mi.traverse(mi.load_file(str(path), optimize=False))
    for name in "ab":
        (key,) = [k for k in params.keys() if k.startswith(f"object_{name}.") and "r.data" in k]
        np.testing.assert_allclose(
            params[key], arrays[f"object_{name}.bsdf.brdf_0.base_color.data"]
        )
        assert (tmp_path / f"result/painted/object_{name}.png").is_file()


@pytest.mark.parametrize("key", ["object.vertices", "object_a.vertices", "object.bsdf.x"])
def test_what_would_tear_it_is_one_line(two, key):
    unknowns = json.dumps({key: {"start": "smooth"}})
    with pytest.raises(InputError, match="object_a, object_b.*photos.materials=one") as error:
        built([*two, f"scene.unknowns={unknowns}"])
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("sphere", [[0, 0, 0, 0.5], [0.1, -3, 7, 1e-4], [1, 2, 3, 200]])
def test_a_sphere_is_closed(sphere):
    found = shape.parts(PhotosConfig(sphere=sphere), Capture([], "none"))["object"]
    whole = Topology.of(found.vertices, found.faces.astype(np.int64))
    assert whole.flaws() == [] and whole.count == 63 * 128 + 2
    out = (found.vertices - np.float32(sphere[:3])) / sphere[3]
    np.testing.assert_allclose(found.normals, out, atol=0.02)


def said(folder, *more: str) -> str:
    photo_sets.transforms(Files(folder, POSES))
    settings = ["scene=photos", f"photos.path={folder}", "photos.sphere=[0,0,0,0.4]", *more]
    cfg = schema.typed(compose(translate([*settings, "photos.texture=8", "photos.sky=4"]))).scene
    made, taken, every = assemble.bare(cfg)
    assemble._take(taken, made, every)
    return " | ".join(made.warnings)


SHAPE = 'scene.unknowns={"object.vertices": {"start": "smooth"}}'


def test_what_is_said_of_shapes(tmp_path):
    assert "photos.background=true, but only where" in said(tmp_path, SHAPE)
    assert "open" not in said(tmp_path, SHAPE)  # the sphere is no user's mesh
    assert "photos.background" not in said(tmp_path, SHAPE, "photos.background=true")
    moved = {"object.bsdf.brdf_0.base_color.data": {"start": 0.5}, "move": {"start": 0.0}}
    pose = [
        'scene.poses={"move": {"kind": "translation", "objects": ["object"]}}',
        f"scene.unknowns={json.dumps(moved)}",
    ]
    assert "runs away" not in said(tmp_path, *pose)
    assert "photos.background=false, unless" in said(tmp_path, *pose, "photos.background=true")
    single = said(tmp_path, *pose, "photos.test=[view_1,view_2]")
    assert "some texture shows a single view" in single and "background=true" not in single


CORNER = np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]])
LAID = np.column_stack([CORNER[:, :1], 1 - CORNER[:, 1:], np.zeros((6, 2))]).astype("f4")


def glb(folder, texture: np.ndarray, change=lambda tree: None, **primitive) -> str:
    """A square of two triangles with texture coordinates of any type, ``(6, 4)``, of which the last
    two fill up what accessors have to be multiples of; ``change``: what is done to its tree."""
    places = np.column_stack([CORNER, np.zeros(6)]).astype("<f4")
    kind = {"f": 5126, "B": 5121, "H": 5123}[texture.dtype.char]
    tree = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, **primitive}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 6, "type": "VEC3"},
            {"bufferView": 1, "componentType": kind, "count": 6, "type": "VEC2"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 72},
            {"buffer": 0, "byteOffset": 72, "byteLength": texture.nbytes},
        ],
        "buffers": [{"byteLength": 72 + texture.nbytes}],
        "materials": [{"name": "paint"}],
    }
    tree["bufferViews"][1]["byteStride"] = texture.strides[0]
    tree["accessors"][1]["normalized"] = kind != 5126
    if "extensions" in primitive:
        tree["extensionsRequired"] = list(primitive["extensions"])
    change(tree)
    text, data = json.dumps(tree).encode(), places.tobytes() + texture.tobytes()
    text += b" " * (-len(text) % 4)
    path = folder / "mesh.glb"
    path.write_bytes(
        struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + len(data), len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(data), b"BIN\0")
        + data
    )
    return str(path)


@pytest.mark.parametrize("primitive", [{}, {"material": 0}], ids=["bare", "painted"])
@pytest.mark.parametrize("kind", ["f4", "u1", "u2"])
def test_texture_coordinates_of_gltf(tmp_path, kind, primitive):
    """Without a material, too, and of whole numbers that stand for 0 to 1. glTF's v is downwards,
    as Mitsuba's."""
    most = 1 if kind == "f4" else np.iinfo(kind).max
    texture = np.column_stack([CORNER[:, :1], 1 - CORNER[:, 1:], np.zeros((6, 2))]) * most
    path = glb(tmp_path, texture.astype(kind), **primitive)
    assert as_in_the_file(parts(path)["object"], 0, 1)


def test_places_of_gltf_that_are_whole_numbers(tmp_path):
    def change(tree: dict):
        tree["accessors"].append({**tree["accessors"][1], "type": "VEC3"})
        tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = 2

    (found,) = parts(glb(tmp_path, (LAID * 65535).astype("u2"), change)).values()
    np.testing.assert_allclose(found.vertices.max(axis=0), [1, 1, 0])


@pytest.mark.parametrize(
    "extension, called",
    [("EXT_meshopt_compression", "meshopt"), ("KHR_draco_mesh_compression", "Draco")],
)
def test_compressed_gltf(tmp_path, monkeypatch, extension, called):
    monkeypatch.setattr(shape.glb, "find_spec", lambda name: None)
    path = glb(tmp_path, np.zeros((6, 4), "f4"), extensions={extension: {}})
    with pytest.raises(InputError, match=f"compressed by {called}: export it without compression"):
        parts(path)


@pytest.mark.parametrize(
    "change, told",
    [
        (lambda tree: tree["accessors"][0].update(sparse={}), "sparse accessors: export it with"),
        (lambda tree: tree["accessors"][1].update(sparse={}), "sparse accessors: export it with"),
        (lambda tree: tree["accessors"][0].pop("bufferView"), "is compressed: export it without"),
        (lambda tree: tree["accessors"][1].pop("bufferView"), "is compressed: export it without"),
        (lambda tree: tree["meshes"][0]["primitives"][0].update(mode=6), "fans: export triangles"),
        (
            lambda tree: tree.update(extensionsRequired=["EXT_mesh_gpu_instancing"]),
            "needs EXT_mesh_gpu_instancing, which is not read: export it without",
        ),
    ],
)
def test_gltf_that_would_be_read_as_less_than_it_is(tmp_path, change, told):
    with pytest.raises(InputError, match=told) as error:
        parts(glb(tmp_path, LAID, change))
    assert "\n" not in str(error.value)


def test_gltf_that_needs_what_is_of_its_looks_is_read(tmp_path):
    needed = ["KHR_mesh_quantization", "KHR_texture_transform", "KHR_materials_unlit"]
    path = glb(tmp_path, LAID, lambda tree: tree.update(extensionsRequired=needed))
    assert as_in_the_file(parts(path)["object"], 0, 1)


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda tree: tree["nodes"][0].update(skin=0), True),
        (lambda tree: tree["nodes"][0].update(weights=[0, 0.5]), True),
        (lambda tree: tree["meshes"][0].update(weights=[0.5]), True),
        (lambda tree: tree["meshes"][0].update(weights=[0]), False),
    ],
)
def test_bones_and_shape_keys_are_told(tmp_path, change, said):
    capture = Capture([], "none")
    shape.parts(PhotosConfig(mesh=glb(tmp_path, LAID, change)), capture)
    assert any("bones and shape keys are not heeded" in note for note in capture.notes) == said


LENS = {"type": "perspective", "perspective": {"znear": 0.1, "aspectRatio": 1, "yfov": 1}}
LINE = {"primitives": [{"attributes": {"POSITION": 0}, "mode": 3}]}


@pytest.mark.parametrize(
    "nodes, roots",
    [
        ([{"mesh": 0, "name": "m"}, {"camera": 0, "children": [0]}], [1]),
        ([{"mesh": 0, "name": "m"}, {"camera": 0, "translation": [5, 0, 0]}], [0, 1]),
        ([{"mesh": 0, "name": "m"}, {"mesh": 1, "children": [0]}], [1]),
    ],
    ids=["under a camera", "called as a camera", "under lines"],
)
def test_meshes_of_gltf_stand_where_they_do_whatever_is_beside(tmp_path, nodes, roots):
    def change(tree: dict):
        tree.update(nodes=nodes, scenes=[{"nodes": roots}], cameras=[{"name": "m", **LENS}])
        tree["meshes"].append(LINE)

    (found,) = parts(glb(tmp_path, LAID, change)).values()
    np.testing.assert_array_equal(found.vertices.max(axis=0), [1, 1, 0])


def cut_picture() -> bytes:
    """A PNG file that ends too soon."""
    stream = io.BytesIO()
    pixels = np.random.default_rng(0).integers(0, 256, (64, 64, 3)).astype(np.uint8)
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()[:2000]


def test_pictures_of_a_mesh_are_not_asked_for(tmp_path):
    """Nor what else its materials have."""

    def change(tree: dict):
        uri = f"data:image/png;base64,{base64.b64encode(cut_picture()).decode()}"
        tree.update(images=[{"uri": uri}], textures=[{"source": 0}])
        picture = {"baseColorTexture": {"index": 0}}
        tree["materials"] = [{"pbrMetallicRoughness": picture, "extras": ["a", "b"]}]

    assert as_in_the_file(parts(glb(tmp_path, LAID, change, material=0))["object"], 0, 1)
    (tmp_path / "cut.png").write_bytes(cut_picture())
    (tmp_path / "mesh.mtl").write_text("newmtl wood\nmap_Kd cut.png\n")
    path = obj(tmp_path, f"mtllib mesh.mtl\nusemtl wood\n{LEFT}")
    assert as_in_the_file(parts(path)["object"], 0, 0.4)


def test_materials_of_gltf_are_told_apart_by_all_they_have(tmp_path):
    def change(tree: dict):
        (primitive,) = tree["meshes"][0]["primitives"]
        tree["meshes"][0]["primitives"] = [{**primitive, "material": n} for n in range(3)]
        coats = ({"KHR_materials_clearcoat": {"clearcoatFactor": x}} for x in (0.1, 0.9, 0.1))
        tree["materials"] = [{"extensions": coat} for coat in coats]

    found = parts(glb(tmp_path, LAID, change))
    assert [len(part.faces) for part in found.values()] == [4, 2]


def test_colours_beside_a_material_are_told(tmp_path):
    def change(tree: dict):
        tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = 0

    plain = CORNERS + OWN + f"mtllib mesh.mtl\nusemtl wood\n{LEFT}"
    coloured = plain.replace(CORNERS, CORNERS.replace("\n", " 1 0 0\n"))
    for name, text, said in (("a.obj", plain, False), ("b.obj", coloured, True)):
        (tmp_path / name).write_text(text)
        assert any(piece.coloured for piece in shape._pieces(tmp_path / name, [])) == said
    capture = Capture([], "none")
    shape.parts(PhotosConfig(mesh=glb(tmp_path, LAID, change, material=0)), capture)
    assert any("mesh.glb has colours at its vertices" in note for note in capture.notes)


@pytest.mark.parametrize(
    "first, up",
    # A fan from the first or the fourth corner would do.
    [*((first, "{0} {1} 0") for first in range(6)), (1, "0 {0} {1}"), (1, "{1} {0} {0}")],
)
def test_faces_with_notches(tmp_path, first, up):
    """An L, from whichever corner, as one face: of area 3, seen from the same side."""
    ell = np.roll([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], first, axis=0)
    text = "".join(f"v {up.format(*each)}\nvt {each[0]} {each[1]}\n" for each in ell)
    (tmp_path / "ell.obj").write_text(f"{text}f -6/1 2/2 3/3 4/4 5/5 6/6\n")
    part = parts(str(tmp_path / "ell.obj"))["object"]
    a, b, c = np.moveaxis(part.texcoords[part.faces].astype(float), 1, 0)
    doubled = np.linalg.det(np.stack([b - a, c - a], axis=1))
    assert len(doubled) == 4 and np.isclose(np.abs(doubled).sum(), 6)
    assert (doubled < 0).all()  # v is downwards


@pytest.mark.parametrize("at", [0.0, 5e4])
def test_a_closed_mesh_that_is_inside_out_is_turned(tmp_path, at):
    """And an open one, which has no inside, is as its file says."""
    box = trimesh.creation.box((1, 2, 3))
    box.apply_translation([at, -at, at])
    for whole in (True, False):
        faces = box.faces if whole else box.faces[:8]
        trimesh.Trimesh(box.vertices, faces[:, ::-1], process=False).export(tmp_path / "box.ply")
        (found,) = parts(str(tmp_path / "box.ply")).values()
        corners = found.vertices[found.faces].astype(np.float64)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        out = corners.mean(axis=1) - [at, -at, at]
        assert (np.sign((normals * out).sum(axis=1)) == (1 if whole else -1)).all()


def test_a_scan_with_small_holes_that_is_inside_out_is_turned(tmp_path):
    ball = trimesh.creation.icosphere(2)
    faces = np.delete(ball.faces, [0, 100], axis=0)[:, ::-1]
    trimesh.Trimesh(ball.vertices, faces, process=False).export(tmp_path / "ball.ply")
    (found,) = parts(str(tmp_path / "ball.ply")).values()
    a, b, c = np.moveaxis(found.vertices[found.faces].astype(np.float64), 1, 0)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) > 0).all()
    tube = np.abs(ball.vertices[ball.faces].mean(axis=1)[:, 2]) < 0.7
    faces = ball.faces[tube][:, ::-1]
    trimesh.Trimesh(ball.vertices, faces, process=False).export(tmp_path / "ball.ply")
    (found,) = parts(str(tmp_path / "ball.ply")).values()
    a, b, c = np.moveaxis(found.vertices[found.faces].astype(np.float64), 1, 0)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0).all()


def test_a_mesh_without_coordinates_has_one_colour_which_is_said(tmp_path):
    """And what speaks of textures or materials, and has no effect, is refused."""
    photo_sets.transforms(Files(tmp_path, POSES))
    ball = trimesh.creation.icosphere(2, 0.4)
    ball.visual.vertex_colors = np.full((len(ball.vertices), 4), (255, 0, 0, 255), np.uint8)
    ball.export(tmp_path / "ball.ply")

    def load(**settings) -> photographs.Photographs:
        mesh = str(tmp_path / "ball.ply")
        return photographs.load(PhotosConfig(str(tmp_path), mesh=mesh, **settings))

    (told,) = load().warnings
    assert "ball.ply has no texture coordinates: one colour for all of it; unwrap it" in told
    (note,) = load().capture.notes
    assert "ball.ply has colours at its vertices or faces, which are not taken" in note
    with pytest.raises(InputError, match="photos.texture=64: .*ball.ply has no texture coordinate"):
        load(texture=64)
    with pytest.raises(InputError, match="photos.materials=one: .*ball.ply has one material alone"):
        load(materials="one")
    plain = LEFT.replace("/1", "").replace("/2", "").replace("/3", "").replace("/4", "")
    mesh = obj(tmp_path, f"usemtl a\n{plain}usemtl b\n{APART}")
    taken = photographs.load(PhotosConfig(str(tmp_path), mesh=mesh, texture=64))
    assert any("mesh.obj (object_a) has no texture" in line for line in taken.warnings)


def test_faces_that_go_on_after_a_backslash(tmp_path):
    """As CAD programs break lines; at the end of a comment it is a folder's."""
    text = "# C:\\scans\\\nf 1/1 2/2 \\\n3/3 \\\n4/4\nf 2/5 \\\n 5/6 6/7 3/8\n"
    found = parts(obj(tmp_path, text))["object"]
    assert len(found.faces) == 4
    left, right = (shape._part(found, chosen, False) for chosen in sides(found))
    assert as_in_the_file(left, 0, 0.4) and as_in_the_file(right, 0.6, 1)


def sides(found) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of the left square and of the right one."""
    left = found.vertices[found.faces][..., 0].max(axis=1) <= 1
    return left, ~left


PLACES = [[0, 0], [0.5, 0], [0.5, 1], [0, 1], [1, 0], [1, 1]]
UNLIKE = [[1, 4, 5], [0, 1, 2, 3], [1, 5, 2]]


@pytest.mark.parametrize(
    "form, texture",
    [
        *(("<", name) for name in ("s t", "texture_u texture_v", "texcoord", None)),
        *((">", "texcoord"), *(("ascii", name) for name in ("s t", "texcoord", None))),
    ],
)
def test_a_ply_of_triangles_and_quadrilaterals(tmp_path, form, texture):
    """As Blender writes an ordinary mesh; coordinates of vertices, or of faces."""
    of_faces = texture == "texcoord"
    names = ["x", "y", "z", *(texture.split() if texture and not of_faces else [])]
    kind = {"<": "binary_little_endian", ">": "binary_big_endian"}.get(form, form)
    head = f"ply\nformat {kind} 1.0\nelement vertex 6\n"
    head += "".join(f"property float {name}\n" for name in names)
    coloured = form == "<"
    head += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue") if coloured)
    head += "element face 3\nproperty list uchar uint vertex_indices\n"
    head += "property list uchar float texcoord\n" * of_faces
    rows = [[x, y, 0, x, y][: len(names)] for x, y in PLACES]
    lists = [([face, np.ravel([PLACES[n] for n in face]).tolist()]) for face in UNLIKE]
    if form == "ascii":
        lines = [*rows, *([len(f), *f, *([len(t), *t] if of_faces else [])] for f, t in lists)]
        body = "".join(" ".join(map(str, line)) + "\n" for line in lines).encode()
    else:
        body = b"".join(np.array(row, f"{form}f4").tobytes() + b"abc" * coloured for row in rows)
        for face, own in lists:
            body += struct.pack(f"{form}B{len(face)}I", len(face), *face)
            body += struct.pack(f"{form}B{len(own)}f", len(own), *own) if of_faces else b""
    (tmp_path / "mesh.ply").write_bytes((head + "end_header\n").encode() + body)
    found = parts(str(tmp_path / "mesh.ply"))["object"]
    corners = found.vertices[found.faces].astype(float)
    a, b, c = np.moveaxis(corners[..., :2], 1, 0)
    doubled = np.linalg.det(np.stack([b - a, c - a], axis=1))
    assert len(doubled) == 4 and (doubled > 0).all() and np.isclose(doubled.sum(), 2)
    assert as_in_the_file(found, 0, 1) if texture else not len(found.texcoords)
    assert all(piece.coloured == coloured for piece in shape._pieces(tmp_path / "mesh.ply", []))


@pytest.mark.parametrize("of_faces", [False, True])
def test_a_ply_whose_vertices_have_lists(tmp_path, of_faces):
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 6\n"
    head += "".join(f"property float {name}\n" for name in "xyz")
    head += "property list uchar float bones\n"
    head += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    head += "element face 3\nproperty list uchar uint vertex_indices\n"
    head += "property list uchar float texcoord\n" * of_faces
    body = b""
    for number, (x, y) in enumerate(PLACES):
        bones = [0.5] * (number % 3)
        body += struct.pack(f"<3fB{len(bones)}f3B", x, y, 0, len(bones), *bones, 1, 2, 3)
    for face in UNLIKE:
        own = np.ravel([PLACES[n] for n in face]).tolist() if of_faces else []
        body += struct.pack(f"<B{len(face)}I", len(face), *face)
        body += struct.pack(f"<B{len(own)}f", len(own), *own) if of_faces else b""
    (tmp_path / "mesh.ply").write_bytes((head + "end_header\n").encode() + body)
    found = parts(str(tmp_path / "mesh.ply"))["object"]
    a, b, c = np.moveaxis(found.vertices[found.faces].astype(float)[..., :2], 1, 0)
    assert np.isclose(np.linalg.det(np.stack([b - a, c - a], axis=1)).sum(), 2)
    assert as_in_the_file(found, 0, 1) if of_faces else not len(found.texcoords)
    assert all(piece.coloured for piece in shape._pieces(tmp_path / "mesh.ply", []))


def test_a_ply_of_faces_with_notches(tmp_path):
    """Alike in their number of corners: an L, and another beside it."""
    ell = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])
    rows = [f"{x} {y} 0" for x, y in [*ell, *(ell + [3, 0])]]
    rows += [f"6 {' '.join(map(str, range(first, first + 6)))}" for first in (0, 6)]
    head = "ply\nformat ascii 1.0\nelement vertex 12\nproperty float x\nproperty float y\n"
    head += "property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "ell.ply").write_text(head + "\n".join(rows) + "\n")
    found = parts(str(tmp_path / "ell.ply"))["object"]
    a, b, c = np.moveaxis(found.vertices[found.faces].astype(float)[..., :2], 1, 0)
    doubled = np.linalg.det(np.stack([b - a, c - a], axis=1))
    assert len(doubled) == 8 and (doubled > 0).all() and np.isclose(doubled.sum(), 12)


def test_a_corner_that_is_none_is_refused(tmp_path):
    (tmp_path / "it.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n")
    with pytest.raises(InputError, match="it.off: triangle 0 has the vertex -1"):
        parts(str(tmp_path / "it.off"))


def test_a_ply_that_is_cut_short_is_refused(tmp_path):
    trimesh.creation.box().export(tmp_path / "box.ply")
    whole = (tmp_path / "box.ply").read_bytes()
    (tmp_path / "box.ply").write_bytes(whole[:-7])
    with pytest.raises(InputError, match="box.ply: cannot be read: ") as error:
        parts(str(tmp_path / "box.ply"))
    assert "\n" not in str(error.value)


def test_an_off_of_many_corners(tmp_path):
    """An L as one face, which is not convex, beside a triangle."""
    ell = "0 0 0\n2 0 0 # a corner\n2 1 0\n1 1 0\n1 2 0\n0 2 0\n3 0 0\n3 1 0\n"
    faces = "6 0 1 2 3 4 5\n3 1 6 7 255 0 0\n"
    (tmp_path / "ell.off").write_text(f"OFF\n8 2 0\n\n{ell}{faces}")
    found = parts(str(tmp_path / "ell.off"))["object"]
    a, b, c = np.moveaxis(found.vertices[found.faces].astype(float)[..., :2], 1, 0)
    doubled = np.linalg.det(np.stack([b - a, c - a], axis=1))
    assert len(doubled) == 5 and (doubled > 0).all() and np.isclose(doubled.sum(), 7)


@pytest.mark.parametrize(
    "name, uri",
    [
        ("my scan.bin", "my%20scan.bin"),
        ("Büste.bin", "B%C3%BCste.bin"),
        ("50%25.bin", "50%25.bin"),
        ("plain.bin", "plain.bin"),
        ("../buffers/mesh.bin", "../buffers/mesh.bin"),
        ("../buffers/mesh.bin", "link.bin"),
        ("plain.bin", "C:/scans/plain.bin"),
        ("plain.bin", "C:\\scans\\plain.bin"),
        ("../buffers/mesh.bin", "..\\buffers\\mesh.bin"),
    ],
)
def test_gltf_names_files_as_uris(tmp_path, name, uri):
    """Also as programs write them that do not know of that; above its folder, behind links, or, of
    a folder that is gone, beside it."""
    with open(glb(tmp_path, LAID), "rb") as file:
        whole = file.read()
    end = 20 + struct.unpack("<I", whole[12:16])[0]
    tree = json.loads(whole[20:end])
    tree["buffers"][0]["uri"] = uri
    folder = tmp_path / "scan"
    for each in (folder, tmp_path / "buffers"):
        each.mkdir()
    (folder / name).write_bytes(whole[end + 8 :])
    if uri == "link.bin":
        (folder / uri).symlink_to(folder / name)
    (folder / "my scan.gltf").write_text(json.dumps(tree))
    assert as_in_the_file(parts(str(folder / "my scan.gltf"))["object"], 0, 1)


def test_corners_below_zero_count_from_their_face(tmp_path):
    """Block after block, as programs write it that number backwards."""
    one = "v {0} 0 0\nv {1} 0 0\nv {1} 1 0\nf -3 -2 -1 # the -last\n"
    (tmp_path / "mesh.obj").write_text(one.format(0, 1) + one.format(2, 3))
    (found,) = parts(str(tmp_path / "mesh.obj")).values()
    assert len(found.faces) == 2
    assert found.vertices[:, 0].min() == 0 and found.vertices[:, 0].max() == 3


def moved_texture(folder, quantized: bool, **told) -> str:
    """A glTF file of one triangle whose picture is moved on it."""
    mesh = trimesh.Trimesh(np.eye(3), [[0, 1, 2]], process=False)
    picture = Image.new("RGB", (4, 4), (200, 100, 50))
    mesh.visual = trimesh.visual.TextureVisuals(uv=np.eye(3)[:, :2], image=picture)
    files = mesh.export(file_type="gltf")
    tree = json.loads(files["model.gltf"])
    for name, content in files.items():
        (folder / name).write_bytes(content)
    (material,) = tree["materials"]
    material["name"] = "paint"
    material["pbrMetallicRoughness"]["baseColorTexture"] |= told
    (primitive,) = tree["meshes"][0]["primitives"]
    if quantized:
        tree["accessors"][primitive["attributes"]["TEXCOORD_0"]]["componentType"] = 5123
    (folder / "model.gltf").write_text(json.dumps(tree))
    return str(folder / "model.gltf")


def test_a_picture_that_is_moved_on_its_mesh_is_told(tmp_path):
    moved = {"extensions": {"KHR_texture_transform": {"offset": [0.5, 0]}}}
    layers = ({"extensions": {"KHR_texture_transform": {"texCoord": n}}} for n in (1, 0))
    other, same = (told | {"texCoord": n} for told, n in zip(layers, (0, 1)))
    cases = (moved, True), ({"texCoord": 1}, True), (other, True), (same, False), ({}, False)
    for told, said in cases:
        path, capture = moved_texture(tmp_path, False, **told), Capture([], "none")
        shape.parts(PhotosConfig(mesh=path), capture)
        assert any("paint are moved" in note for note in capture.notes) == said
    with pytest.raises(InputError, match="material paint are whole numbers.*quantization"):
        parts(moved_texture(tmp_path, True, **moved))
    gloss = {"KHR_materials_pbrSpecularGlossiness": {"diffuseTexture": moved}}
    for material in ({"extensions": gloss}, {"normalTexture": moved}):

        def change(tree: dict, material=material):
            tree["materials"] = [{"name": "paint", **material}]

        capture = Capture([], "none")
        shape.parts(PhotosConfig(mesh=glb(tmp_path, LAID, change, material=0)), capture)
        assert any("paint are moved" in note for note in capture.notes)
        with pytest.raises(InputError, match="material paint are whole numbers.*quantization"):
            parts(glb(tmp_path, LAID.astype("u2"), change, material=0))


def test_points_are_no_mesh(tmp_path):
    """As COLMAP's fused.ply holds them."""
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "fused.ply")
    with pytest.raises(InputError, match="it has points and no triangles: make a mesh of them"):
        parts(str(tmp_path / "fused.ply"))
