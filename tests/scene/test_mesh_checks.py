"""Loaded meshes: what is refused, what is warned of, and how much of a texture is used twice."""

import gc
import json

import mitsuba as mi
import numpy as np
import pytest
from isas_cli.scenes import library, meshes
from scipy.spatial import Delaunay
from xml_for_tests import camera

from isas_cli.cli.app import main
from isas_cli.runtime.errors import InputError
from isas_cli.scene import mesh_checks, scene_file
from isas_cli.scene.mesh_checks import check_scene, overlap
from isas_cli.unknowns.parameters import owner

MIRRORED = [[1, 0], [0, 0], [0, 1], [1, 1]]


def rectangle(x: float, y: float, width: float, height: float, corners=None) -> np.ndarray:
    """The two triangles of a chart, ``(2, 3, 2)``."""
    unit = np.array(corners or [[0, 0], [1, 0], [1, 1], [0, 1]], float)
    return (unit * [width, height] + [x, y])[[[0, 1, 2], [0, 2, 3]]]


# Charts, and the share of the used texels that two of their triangles claim.
CHARTS = {
    "half of each covers half of the other": (
        [rectangle(0, 0, 0.5, 0.5), rectangle(0.25, 0, 0.5, 0.5)],
        1 / 3,
    ),
    "side by side": ([rectangle(0, 0, 0.5, 0.5), rectangle(0.5, 0, 0.5, 0.5)], 0),
    "one above the other": ([rectangle(0, 0, 0.5, 0.3), rectangle(0, 0.3, 0.5, 0.7)], 0),
    "twice": ([rectangle(0.1, 0.2, 0.5, 0.5)] * 2, 1),
    "mirrored": ([rectangle(0, 0, 0.5, 1), rectangle(0, 0, 0.5, 1, MIRRORED)], 1),
    "across the seam": ([rectangle(0.3, 0.7, 1, 1)], 0),
    "a tile and a half": ([rectangle(-3.25, 0, 1.5, 1)], 0.5),
    "three tiles in height": ([rectangle(0, -1, 0.5, 3)], 1),
    "a tile apart": ([rectangle(0, 0, 0.5, 0.5), rectangle(7, -3, 0.5, 0.5)], 1),
    "without area": ([rectangle(0.5, 0, 0, 1), rectangle(0, 0.5, 1, 0)], 0),
    "none": ([np.zeros((0, 3, 2))], 0),
}


def test_made_normals_are_known_of_meshes_that_are_not_sound():
    corners, faces = np.eye(3, dtype=np.float32), np.array([[0, 1, 2]])
    normals = np.full((3, 3), 3**-0.5, np.float32)
    assert mesh_checks.made_normals(corners, faces, normals) == 1
    assert mesh_checks.made_normals(corners, faces[:, ::-1], normals) == -1
    assert mesh_checks.made_normals(corners, faces, normals[:0]) == 0, "it has none"
    for bad in (faces + 1, faces[:0]):
        assert mesh_checks.made_normals(corners, bad, normals) == 0
    assert mesh_checks.made_normals(corners * np.nan, faces, normals) == 0


@pytest.mark.parametrize("name", CHARTS)
def test_overlap_of_charts_is_what_geometry_says(name):
    charts, share = CHARTS[name]
    assert overlap(np.concatenate(charts)) == pytest.approx(share, abs=2e-3 if share % 1 else 0)


def test_overlap_is_what_counting_every_triangle_finds(rng, monkeypatch):
    """Triangles of all sizes, also beyond the unit square, against a test of each centre."""
    size = 24
    corners = rng.uniform(-1, 2, (12, 1, 2)) + rng.normal(size=(12, 3, 2)) * rng.choice(
        [0.02, 0.2, 0.4], (12, 1, 1)
    )
    centres = (np.arange(-6 * size, 7 * size) + 0.5) / size
    x, y = np.meshgrid(centres, centres)
    counts = np.zeros((size, size), int)
    for a, b, c in corners:
        sides = [
            (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
            for p, q in ((a, b), (b, c), (c, a))
        ]
        inside = np.all(np.array(sides) > 0, axis=0) | np.all(np.array(sides) < 0, axis=0)
        counts += inside.reshape(13, size, 13, size).sum(axis=(0, 2))
    exact = (counts > 1).sum() / (counts > 0).sum()
    assert 0.1 < exact < 0.95
    assert overlap(corners, size) == exact
    monkeypatch.setattr(mesh_checks, "_SPANS_AT_ONCE", 7)
    assert overlap(corners, size) == exact


def test_charts_that_tile_very_often_are_counted_on_a_coarser_grid(monkeypatch):
    """One column of texels overlaps: of 512 it is seen, of 16 it falls between two centres."""
    charts = np.concatenate([rectangle(0, 0, 0.5, 1), rectangle(0.5 - 1.4 / 512, 0, 0.4, 1)])
    assert overlap(charts) > 0
    monkeypatch.setattr(mesh_checks, "_MOST_SPANS", 40)
    assert overlap(charts) == 0


def test_triangles_of_a_dense_atlas_share_no_texel(rng):
    points = np.concatenate([rng.random((3000, 2)), [[0, 0], [1, 0], [0, 1], [1, 1]]])
    corners = points.astype(np.float32)[Delaunay(points).simplices]
    assert overlap(corners) == 0
    twice = np.concatenate([corners, corners[: len(corners) // 2]])
    assert 0.3 < overlap(twice) < 0.7


@pytest.mark.parametrize(
    "file, low, high", [("old_jar/old_jar.obj", 0, 0.001), ("chicken/chicken.obj", 0.03, 0.06)]
)
def test_overlap_of_assets(file, low, high):
    surface = meshes.read_obj(library.asset(f"models/{file}"))
    assert low <= overlap(surface.texcoords[surface.faces]) <= high


SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)


def write(path, uv=None, faces=((0, 1, 2), (0, 2, 3)), vertices=SQUARE) -> None:
    """A square as an OBJ file. ``uv (V, 2)`` or None."""
    lines = [f"v {x} {y} {z}" for x, y, z in vertices.tolist()]
    lines += [f"vt {u} {v}" for u, v in (() if uv is None else np.asarray(uv).tolist())]
    corner = "{0}/{0}" if uv is not None else "{0}"
    lines += ["f " + " ".join(corner.format(i + 1) for i in face) for face in faces]
    path.write_text("\n".join(lines) + "\n")


UV = SQUARE[:, :2] / 2 + 0.5
HALF = UV * [0.5, 1]
BITMAP = """<texture type="bitmap" name="{name}"><string name="filename" value="picture.png"/>
  {more}</texture>"""
PLAIN = '<bsdf type="diffuse"/>'
SCENE = f"""<scene version="3.0.0"><integrator type="path"/><emitter type="constant"/>
  {camera(width=8)}{{shapes}}</scene>"""


def paint(more: str = "", name: str = "reflectance") -> str:
    return f'<bsdf type="diffuse">{BITMAP.format(name=name, more=more)}</bsdf>'


def obj(name: str, inside: str, file: str = "mesh.obj") -> str:
    return f"""<shape type="obj" id="{name}"><string name="filename" value="{file}"/>
      {inside}</shape>"""


@pytest.fixture
def folder(tmp_path, monkeypatch, rng):
    from isas_cli.runtime import images

    images.write_png(tmp_path / "picture.png", (rng.random((8, 8, 3)) * 255).astype(np.uint8))
    write(tmp_path / "mesh.obj", UV)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def warnings_of(folder, shapes: str, *keys: str) -> list[str]:
    (folder / "scene.xml").write_text(SCENE.format(shapes=shapes))
    scene, _, _ = scene_file.load("scene.xml", None)
    params = mi.traverse(scene)
    for key in keys:
        assert key in params, list(params.keys())
    return check_scene(scene, {key: owner(params, key) for key in keys})


KEY = "quad.bsdf.reflectance.data"


def test_a_sound_scene_has_no_warning(folder):
    assert warnings_of(folder, obj("quad", paint()), KEY) == []


# Materials around the texture, and the key that it then has.
NESTED = {
    "plain": (paint(), KEY),
    "two-sided": (
        f'<bsdf type="twosided">{paint()}</bsdf>',
        "quad.bsdf.brdf_0.reflectance.data",
    ),
    "blended": (
        f'<bsdf type="twosided"><bsdf type="blendbsdf"><float name="weight" value="0.5"/>{PLAIN}'
        f"{paint()}</bsdf></bsdf>",
        "quad.bsdf.brdf_0.bsdf_1.reflectance.data",
    ),
    "light": (
        PLAIN + f'<emitter type="area">{BITMAP.format(name="radiance", more="")}</emitter>',
        "quad.emitter.radiance.data",
    ),
}


@pytest.mark.parametrize("name", NESTED)
def test_the_mesh_of_a_texture_is_found_however_deep_it_lies(folder, name):
    inside, key = NESTED[name]
    # Two triangles of one square in space, which lie side by side in the picture or fall together.
    write(folder / "folded.obj", [*HALF, *HALF], [[0, 1, 2], [4, 6, 7]], np.tile(SQUARE, (2, 1)))
    assert warnings_of(folder, obj("quad", inside, "folded.obj"), key) == []
    write(folder / "folded.obj", [*HALF, *HALF], [[0, 1, 2], [4, 5, 6]], np.tile(SQUARE, (2, 1)))
    (warning,) = warnings_of(folder, obj("quad", inside, "folded.obj"), key)
    assert warning == (
        "mesh quad: 100% of the texels that it uses belong to two or more places of the surface: "
        f"'{key}' is a compromise there"
    )
    # Nothing is unknown there: nothing to say.
    assert warnings_of(folder, obj("quad", inside, "folded.obj")) == []


@pytest.mark.parametrize("back", [[[0, 2, 1], [0, 3, 2]], [[3, 2, 1], [3, 1, 0]]])
def test_faces_with_a_back_share_nothing_with_it(folder, back):
    """Each twice, of which the second is turned round, as SketchUp has them; cut along the same
    diagonal or the other."""
    for faces in ([[0, 1, 2], [0, 2, 3], *back], [*back, [0, 1, 2], [0, 2, 3]]):
        write(folder / "mesh.obj", UV, faces)
        assert warnings_of(folder, obj("quad", paint()), KEY) == []
    uv, faces = np.concatenate([UV, UV + [0.5, 0]]), [[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]]
    write(folder / "mesh.obj", uv, faces, np.tile(SQUARE, (2, 1)))
    (warning,) = warnings_of(folder, obj("quad", paint()), KEY)
    assert "100% of the texels" in warning  # the back has other ones


@pytest.mark.parametrize("uv", [0 * UV, 0 * UV + 0.3, UV * [1, 0]])
def test_texture_coordinates_of_no_area_are_told(folder, uv):
    write(folder / "mesh.obj", uv)
    (warning,) = warnings_of(folder, obj("quad", paint()), KEY)
    assert warning.startswith("mesh quad: the triangles' texture coordinates span no area")
    assert KEY in warning and warning.endswith("unwrap it")
    assert warnings_of(folder, obj("quad", paint())) == []


def test_meshes_that_share_a_material_share_its_texels(folder):
    material = paint().replace("<bsdf ", '<bsdf id="paint" ', 1)
    both = obj("a", '<ref id="paint"/>', "left.obj") + obj("b", '<ref id="paint"/>', "right.obj")
    write(folder / "left.obj", HALF)
    write(folder / "right.obj", HALF + [0.5, 0])
    (folder / "scene.xml").write_text(SCENE.format(shapes=material + both))
    params = mi.traverse(scene_file.load("scene.xml", None)[0])
    key = next(k for k in params.keys() if k.endswith("reflectance.data"))
    assert warnings_of(folder, material + both, key) == []
    write(folder / "right.obj", HALF + [0.25, 0])
    (warning,) = warnings_of(folder, material + both, key)
    assert warning.startswith("meshes a, b: 33% of the texels that they use")
    # Two meshes with a texture each share nothing.
    apart = obj("a", paint(), "left.obj") + obj("b", paint(), "right.obj")
    keys = [f"{name}.bsdf.reflectance.data" for name in "ab"]
    assert warnings_of(folder, apart, *keys) == []


def test_the_textures_own_transformation_counts(folder):
    twice = '<transform name="to_uv"><scale x="2" y="1"/></transform>'
    (warning,) = warnings_of(folder, obj("quad", paint(twice)), KEY)
    assert "100%" in warning
    write(folder / "mesh.obj", UV * 2)
    half = '<transform name="to_uv"><scale x="0.5" y="0.5"/></transform>'
    assert warnings_of(folder, obj("quad", paint(half)), KEY) == []


def test_an_unknown_texture_needs_coordinates(folder):
    write(folder / "bare.obj")
    with pytest.raises(InputError, match=f"mesh quad has no texture coordinates.*'{KEY}'"):
        warnings_of(folder, obj("quad", paint(), "bare.obj"), KEY)
    # Another texture of the scene is the unknown one.
    both = obj("other", paint()) + obj("quad", paint(), "bare.obj")
    assert warnings_of(folder, both, KEY.replace("quad", "other")) == []


def test_triangles_without_area_are_a_warning_in_a_users_file(folder):
    write(folder / "mesh.obj", UV, [[0, 1, 2], [0, 2, 3], [1, 1, 2], [3, 3, 3]])
    (warning,) = warnings_of(folder, obj("quad", paint()), KEY)
    assert warning.startswith("mesh quad: 2 of 4 triangles have no area, the first is triangle 2")
    gc.collect()  # see assemble.bare: parts of earlier tests' scenes are traced too
    scene, _, _ = scene_file.load("scene.xml", None)
    assert np.isfinite(np.array(mi.render(scene, spp=64))).all()


@pytest.mark.parametrize(
    "field, value, parts",
    [
        ("vertices", np.nan, ["position of vertex 2 is not finite"]),
        ("texcoords", np.nan, ["texture coordinate of vertex 2 is not finite", "all of its faces"]),
        ("texcoords", 1e9, ["texture coordinate of vertex 2 is beyond ±1e+06", "1000000000.0"]),
    ],
)
def test_numbers_that_are_none_are_refused(field, value, parts):
    arrays = {"vertices": SQUARE.copy(), "texcoords": UV.copy()}
    arrays[field][2, 0] = value
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    normals = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    surface = meshes.Surface(faces=faces, normals=normals, **arrays)
    broken = meshes.shape("broken", surface, {"type": "diffuse"})
    scene = mi.load_dict({"type": "scene", "sound": {"type": "sphere"}, "broken": broken})
    with pytest.raises(InputError, match="mesh broken: ") as refused:
        check_scene(scene, {})
    for part in parts:
        assert part in str(refused.value)


def test_triangles_without_vertices_are_refused():
    """Seen in a fuzzed file."""
    faces = np.array([[0, 1, 2], [0, 1, 10616833]], np.uint32)
    with pytest.raises(InputError, match="triangle 1 has the vertex 10616833, and there are 3"):
        mesh_checks.check_values(np.eye(3), np.zeros((0, 2)), faces, "m")


def test_coordinates_in_metres_are_refused_for_an_unknown_texture_alone(folder):
    write(folder / "mesh.obj", UV * 2000)
    assert warnings_of(folder, obj("other", paint()), *[]) == []
    with pytest.raises(InputError, match="texture coordinate of vertex . is beyond ±1000"):
        warnings_of(folder, obj("quad", paint()), KEY)


@pytest.mark.parametrize("times, scale", [(2048, 1 / 2048), (1, 2048)])
def test_of_an_unknown_texture_coordinates_count_after_its_transformation(folder, times, scale):
    write(folder / "mesh.obj", UV * times)
    placed = paint(f'<transform name="to_uv"><scale x="{scale}" y="{scale}"/></transform>')
    if times > 1:
        assert warnings_of(folder, obj("quad", placed), KEY) == []
    else:
        with pytest.raises(InputError, match="texture coordinate of vertex . is beyond ±1000"):
            warnings_of(folder, obj("quad", placed), KEY)


def test_a_run_says_and_records_what_is_wrong_with_its_meshes(folder, capsys):
    write(folder / "mesh.obj", UV * [2, 1], [[0, 1, 2], [0, 2, 3], [1, 1, 2]])
    (folder / "scene.xml").write_text(SCENE.format(shapes=obj("quad", paint())))
    arguments = ["run", "scene=file", "scene.path=scene.xml", "budget.iterations=1"]
    arguments += ["frames.spp=2", "frames.snapshots=0", "target.spp=2", "estimator.batch=64"]
    arguments += [f'scene.unknowns={{"{KEY}": {{"start": 0.5}}}}', "hydra.run.dir=r"]
    assert main(arguments) == 0
    said = " ".join(capsys.readouterr().err.split())
    recorded = json.loads((folder / "r" / "summary.json").read_text())["warnings"]
    assert ["no area" in w for w in recorded] == [True, False]
    assert ["compromise" in w for w in recorded] == [False, True]
    for warning in recorded:
        assert f"warning: {warning}" in said

    write(folder / "mesh.obj")
    assert main([*arguments[:-1], "hydra.run.dir=s"]) == 2
    captured = capsys.readouterr().err
    assert captured.startswith("isas: mesh quad has no texture") and captured.count("\n") == 1
    assert not (folder / "s").exists()


ASCII = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
property float u
property float v
element face {faces}
property list uchar int vertex_indices
end_header
"""
CORNERS = "0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n"


@pytest.mark.parametrize(
    "body, faces",
    [
        (f"\n{CORNERS}\n3 0 1 2\n", 1),
        (CORNERS.replace("\n", " ") + "3 0 1 2\n", 1),
        (f"{CORNERS}3 0 1 2 3 2 1 0\n", 2),
    ],
    ids=["blank lines", "one line", "faces in one line"],
)
def test_an_ascii_ply_may_have_other_lines(tmp_path, body, faces):
    """As Mitsuba reads it, which takes no notice of them; what is damaged is said all the same."""
    file, scene = tmp_path / "it.ply", tmp_path / "it.xml"
    shape = '<shape type="ply"><string name="filename" value="it.ply"/></shape>'
    scene.write_text(f'<scene version="3.0.0">{shape}{camera()}</scene>')
    file.write_text(ASCII.format(faces=faces) + body)
    (mesh,) = scene_file.load(str(scene), None)[0].shapes()
    assert (mesh.vertex_count(), mesh.face_count()) == (3, faces)
    file.write_text(ASCII.format(faces=1) + f"{CORNERS}3 0 1 7\n")
    with pytest.raises(InputError, match="it.ply: triangles name vertices that are not there"):
        scene_file.load(str(scene), None)


GREEN = '<texture type="bitmap" name="reflectance"><string name="filename" value="a.png"/>'
BARE = f"""<scene version="3.0.0"><shape type="shapegroup" id="group">
  <shape type="ply" id="leaf"><string name="filename" value="bare.ply"/>
  <bsdf type="diffuse" id="green">{GREEN}</texture></bsdf></shape></shape>
  <shape type="instance"><ref id="group"/></shape>{camera()}<emitter type="constant"/></scene>"""


def test_meshes_in_groups_are_looked_at_as_well(tmp_path, refused):
    import trimesh
    from PIL import Image

    trimesh.creation.icosphere(1).export("bare.ply")
    Image.new("RGB", (4, 4), (90, 80, 70)).save("a.png")
    with open("group.xml", "w", encoding="utf-8") as file:
        file.write(BARE)
    unknown = "scene.unknowns={group.leaf.bsdf.reflectance.data: {start: 0.5}}"
    asked = ["run", "scene=file", "scene.path=group.xml", unknown]
    refused(asked, "mesh leaf has no texture coordinates, which 'group.leaf")


def test_a_distance_field_has_no_texture_coordinates():
    field = np.ones((3, 3, 3, 1), np.float32)
    field[1, 1, 1] = -1
    texels = mi.TensorXf(np.full((2, 2, 3), 0.5, np.float32))
    painted = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels, "raw": True}}
    shape = {"type": "sdfgrid", "grid": mi.TensorXf(field), "bsdf": painted}
    scene = mi.load_dict({"type": "scene", "field": shape}, optimize=False)
    params = mi.traverse(scene)
    (key,) = (key for key in params.keys() if key.endswith("reflectance.data"))
    with pytest.raises(InputError, match="shape field: has no texture coordinates"):
        check_scene(scene, {key: owner(params, key)})


@pytest.mark.parametrize("angle, told", [(0, False), (90, False), (45, True)])
def test_a_distance_field_that_stands_askew_is_told(angle, told):
    distances = np.ones((2, 2, 2, 1), np.float32)
    distances[0, 0, 0] = -1
    field = {"type": "sdfgrid", "grid": mi.TensorXf(distances)}
    place = mi.ScalarTransform4f().rotate([0, 0, 1], angle)
    described = {"type": "scene", "figure": {**field, "to_world": place}}
    warnings = check_scene(mi.load_dict(described, optimize=False), {})
    assert [w for w in warnings if "turned sdfgrid with holes" in w] == warnings
    assert bool(warnings) == told
