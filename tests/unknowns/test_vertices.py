"""The vertices of a mesh as an unknown: welded, started, written, measured, saved."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
import trimesh
from isas_cli.scenes import kirby, meshes
from PIL import Image
from scenes_for_tests import without_targets
from scipy import sparse
from scipy.sparse import linalg
from shapes_for_tests import KEY, ball, problem, shaped
from xml_for_tests import camera, paths

from isas_cli.config import schema
from isas_cli.config.compose import compose, translate
from isas_cli.config.schema import OptimizerConfig, UnknownConfig
from isas_cli.engine import assemble
from isas_cli.engine.optimiser import Stepper
from isas_cli.rendering import turntable
from isas_cli.runtime.errors import InputError
from isas_cli.scene.mesh_files import upwards
from isas_cli.scene.shape_error import Sampled, apart
from isas_cli.scene.topology import Topology
from isas_cli.unknowns.kind import Surface
from isas_cli.unknowns.mesh import Mesh

MATT = {"type": "diffuse"}


def test_vertices_at_one_place_are_one_and_go_back_to_all_of_the_files():
    shared, apart_ = problem(views=1, side=8), problem(views=1, side=8, seams=True)
    for p in (shared, apart_):
        assert p.unknowns[KEY].truth.shape == (642, 3)
        p.unknowns.write(p.unknowns.truths())
        mesh = mi.traverse(p.scene)
        positions = np.array(mesh["figure.vertex_positions"]).reshape(-1, 3)
        faces = np.array(mesh["figure.faces"]).reshape(-1, 3)
        normals = np.array(mesh["figure.vertex_normals"]).reshape(-1, 3)
        vertices, corners = np.unique(positions, axis=0, return_inverse=True)
        expected = meshes.corner_normals(vertices, corners.ravel()[faces])
        np.testing.assert_allclose(normals[faces], expected, atol=1e-5)


def test_steps_are_spread_by_the_laplacian_and_no_vertex_goes_farther_than_the_rate():
    p = problem(views=1, side=8)
    kind, rng = p.unknowns[KEY].kind, np.random.default_rng(3)
    gradient = rng.normal(size=(642, 3))
    dense = np.eye(642) + kind._mesh.stiffness * kind.topology.laplacian().toarray()
    spread = np.linalg.solve(dense, np.linalg.solve(dense, gradient))
    np.testing.assert_allclose(kind.smoothed(gradient), spread, atol=1e-12)
    stepper = Stepper(p.unknowns, OptimizerConfig(lr=0.01))
    before = np.array(stepper.values[KEY])
    stepper.step({KEY: kind.value(gradient.astype(np.float32))}, 0.0)
    moved = np.array(stepper.values[KEY]) - before
    np.testing.assert_allclose(moved, -0.01 * spread / np.abs(spread).max(), atol=1e-6)


def test_the_laplacian_counts_neighbours_and_has_its_weight_by_the_vertices():
    kind = problem(views=1, side=8).unknowns[KEY].kind
    assert kind._mesh.stiffness == pytest.approx(19 * 642 / 10_000)
    found, faces = kind.topology.laplacian().toarray(), kind.topology.faces
    # Of a closed mesh as many neighbours as faces.
    valence = np.bincount(faces.ravel())
    assert set(valence) == {5, 6} and np.array_equal(np.diag(found), valence)
    wanted = np.diag(valence.astype(np.float64))
    for corner in range(3):
        wanted[faces[:, corner], faces[:, corner - 1]] = -1
        wanted[faces[:, corner - 1], faces[:, corner]] = -1
    assert np.array_equal(found, wanted) and not found.sum(axis=1).any()


def test_one_path_seen_edge_on_does_not_slow_a_shape():
    """Steps along one direction, with a derivative a thousand times as large at the sixth: the rest
    goes on at more than half of the pace of a run that met none, and growth of all is followed."""
    p = problem(views=1, side=8)
    kind, rng = p.unknowns[KEY].kind, np.random.default_rng(3)
    ordinary = rng.normal(size=(642, 3))
    ordinary[0] = 0  # the first vertex is no measure of the others

    def pace(gradients: list[np.ndarray]) -> float:
        """The mean length of the last step, where every step has a gradient."""
        stepper = Stepper(p.unknowns, OptimizerConfig(lr=0.01, schedule="constant"))
        for gradient in gradients:
            before = np.array(stepper.values[KEY])
            stepper.step({KEY: kind.value(gradient.astype(np.float32))}, 0.0)
        return np.abs(np.array(stepper.values[KEY]) - before).mean()

    outlier = ordinary.copy()
    outlier[7] *= 1e3
    quiet = pace(40 * [ordinary])
    assert abs(quiet / pace([ordinary]) - 1) < 1e-3, "what is ordinary is not cut"
    assert quiet / 2 < pace(6 * [ordinary] + [outlier] + 33 * [ordinary]) <= 1.01 * quiet
    assert pace(6 * [ordinary] + 34 * [100 * ordinary]) > quiet / 2


def test_both_solvers_spread_alike(monkeypatch):
    pytest.importorskip("cholespy")
    gradient, found = np.random.default_rng(3).normal(size=(642, 3)), []
    for installed in (True, False):
        kind = problem(views=1, side=8).unknowns[KEY].kind
        if not installed:
            monkeypatch.setitem(sys.modules, "cholespy", None)
        found.append(kind.smoothed(gradient))
    np.testing.assert_allclose(*found, atol=1e-12)


def test_a_factor_of_the_matrix_stays_sparse(monkeypatch):
    monkeypatch.setitem(sys.modules, "cholespy", None)
    topology = problem(views=1, side=8).unknowns[KEY].kind.topology
    mesh = Mesh(topology, topology.faces)
    matrix = sparse.identity(topology.count) + mesh.stiffness * topology.laplacian()
    assert mesh.solve.__self__.nnz < 0.9 * linalg.splu(matrix.tocsc()).nnz


def test_what_is_no_result_is_said():
    kind = problem(views=1, side=8).unknowns[KEY].kind
    assert kind.doubt(kind.present) is None
    assert "inside out" in kind.doubt(-kind.present)
    assert "20 times as long" in kind.doubt(20 * kind.present)
    rough = np.random.default_rng(3).normal(size=kind.present.shape).astype(np.float32)
    assert "folded" in kind.doubt(kind.present + rough)


def of(vertices: np.ndarray, faces: np.ndarray):
    """The unknown that a mesh is, the scene around it left out of account."""
    scene = kirby.build(1, 8, 1) | {"figure": shaped(vertices, faces)}
    return without_targets(scene, {KEY: UnknownConfig(start="smooth")}).unknowns[KEY].kind


def test_small_meshes_are_moved_as_finely_as_their_coordinates_are_rounded():
    vertices, faces = ball(2)
    kind = of((0.1 * vertices).astype(np.float32), faces)
    assert kind.scale == pytest.approx(0.1 * np.abs(vertices).max())


def two(apart: float) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = ball(3)
    beside = vertices[:, [1, 2, 0]] + [apart, 0.03, 0.05]
    return np.concatenate([vertices, beside]), np.concatenate([faces, faces + len(vertices)])


def test_a_mesh_that_passes_through_itself_is_warned_of_and_is_no_result(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    kind = of(*two(2.1))
    assert kind.warnings() == [] and kind.doubt(kind.present) is None
    moved = kind.present.copy()
    moved[kind.present[:, 0] > 1.05, 0] -= 0.6
    assert "triangles of 'figure' pass through each other" in kind.doubt(moved)
    Path("start.ply").write_bytes(kind.files(moved)["ply"])
    scene = kirby.build(1, 8, 1) | {"figure": shaped(*two(2.1))}
    begun = without_targets(scene, {KEY: UnknownConfig(start="start.ply")})
    (said,) = assemble._doubtful_starts(list(begun.unknowns))
    assert said.startswith("start of 'figure.vertices'") and said.endswith("through each other")
    assert kind.numbers(kind.present, None)["crossed"] == 0
    share = kind.numbers(moved, None)["crossed"]
    (warning,) = of(*two(1.5)).warnings()
    count = round(share * len(kind.topology.faces))
    assert f"{count} of its {len(kind.topology.faces)} triangles pass through each" in warning


def test_open_and_unwelded_meshes_are_warned_of():
    vertices, faces = ball(2)
    (warning,) = of(vertices, faces[1:]).warnings()
    assert "3 of its 480 edges are open" in warning
    corners = vertices[faces] + 1e-7 * np.random.default_rng(1).random((len(faces), 3, 3))
    apart = np.arange(3 * len(faces)).reshape(-1, 3)
    opened, unwelded = of(corners.reshape(-1, 3), apart).warnings()[:2]
    assert "edges are open" in opened and "weld them" in unwelded


def test_errors_of_balls_are_known():
    vertices, faces = ball(4)
    one, two = Sampled.of(vertices, faces), Sampled.of(1.1 * vertices, faces, 2)
    found = apart(two, one)
    assert abs(found["chamfer"] - 0.1) < 1e-3 and abs(found["hausdorff"] - 0.1) < 3e-3
    assert found["normals"] < 3 and abs(found["volume"] - 1.1**3) < 1e-6
    assert abs(found["overlap"] - 1.1**-3) < 0.02

    # Also of more triangles than there are points on either.
    for level in (4, 6):
        vertices, faces = ball(level)
        same = apart(Sampled.of(vertices, faces, 7), Sampled.of(vertices, faces))
        assert same["chamfer"] < 5e-5 and same["hausdorff"] < 5e-3 and same["normals"] < 0.1


def test_folds_and_flaws_are_told():
    vertices, faces = ball(3)
    whole = Topology.of(vertices, faces)
    assert whole.flaws() == [] and whole.folded(vertices) == 0
    crumpled = vertices + np.random.default_rng(1).normal(size=vertices.shape)
    assert whole.folded(crumpled) > 0.1
    assert "3 of its" in Topology.of(vertices, faces[1:]).flaws()[0]
    assert "gradients biased" in Topology.of(vertices, faces[1:]).flaws()[0]
    doubled = np.concatenate([faces, [[faces[0, 0], faces[0, 1], 99]]])
    assert any("more than two faces" in flaw for flaw in Topology.of(vertices, doubled).flaws())


def globe(columns: int = 32, rows: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """By longitude and latitude: at the poles every other triangle has two corners at one place."""
    down = np.linspace(0, np.pi, rows + 1)[:, None]
    around = np.arange(columns) * (2 * np.pi / columns)
    radius = np.sin(down) * (np.abs(np.cos(down)) < 1)
    places = radius * np.cos(around), radius * np.sin(around), np.cos(down) + 0 * around
    vertices = np.stack(places, axis=-1).reshape(-1, 3) + 0.0  # -0 is 0
    number = np.arange((rows + 1) * columns).reshape(rows + 1, columns)
    a, b, c, d = number[:-1], number[1:], np.roll(number[1:], -1, 1), np.roll(number[:-1], -1, 1)
    return vertices, np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)


def test_triangles_with_two_corners_at_one_place_have_no_edges():
    vertices, faces = globe()
    whole = Topology.of(vertices, faces)
    flat = (whole.faces == np.roll(whole.faces, 1, axis=1)).any(axis=1)
    assert flat.sum() == 64 and whole.flaws() == []
    edges = whole.edges
    assert not flat[edges.faces].any() and len(edges.ends) == 3 * (~flat).sum() / 2
    for side in range(2):  # by the file's own numbers
        three = np.sort(np.column_stack([edges.ends, edges.across[:, side]]))
        assert np.array_equal(three, np.sort(whole.faces[edges.faces[:, side]]))
    assert len(Topology.of(vertices[:1], np.zeros((2, 3), int)).edges.ends) == 1
    with np.errstate(invalid="ignore"):
        kind = of(vertices, faces)
    assert np.ptp(np.linalg.norm(kind.start("sphere", "start"), axis=1)) < 1e-5


def described(smooth: bool = True) -> dict:
    scene = kirby.build(1, 8, 1)
    if not smooth:
        vertices, faces = ball(1)
        mesh = mi.Mesh("figure", len(vertices), len(faces))
        values = mi.traverse(mesh)
        values["vertex_positions"] = vertices.astype(np.float32).ravel()
        values["faces"] = faces.astype(np.uint32).ravel()
        values.update()
        scene["figure"] = mesh
    return scene


@pytest.mark.parametrize(
    "start, smooth, words",
    (
        (0.0, True, "all vertices are at one place"),
        ("nowhere.ply", True, "sphere, smooth, or a PLY or OBJ file that exists"),
        ("sphere", False, "face normals"),
    ),
)
def test_what_cannot_be_found_or_started_is_refused(start, smooth, words):
    with pytest.raises(InputError, match=words):
        without_targets(described(smooth), {KEY: UnknownConfig(start=start)})


def test_a_start_from_a_file_has_the_same_faces(tmp_path):
    p = problem(views=1, side=8)
    kind = p.unknowns[KEY].kind
    for extension, content in kind.files(kind.present * 0.5).items():
        path = tmp_path / f"half.{extension}"
        path.write_bytes(content)
        found = kind.start(str(path), "start")
        np.testing.assert_allclose(found, kind.present * 0.5, atol=1e-6)
    small = tmp_path / "small.ply"
    vertices, faces = ball(1)
    import trimesh

    trimesh.Trimesh(vertices, faces).export(small)
    with pytest.raises(InputError, match="has 42 vertices, the mesh 'figure' 642"):
        kind.start(str(small), "start")


def written(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    """An OBJ of places and triangles alone."""
    lines = ["v {} {} {}".format(*each) for each in vertices]
    lines += ["f {} {} {}".format(*each) for each in faces + 1]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_start_like_the_scenes_own_obj(tmp_path, rng):
    """Mitsuba numbers vertices as faces name them; lines that none names are no vertices to it."""
    vertices, faces = ball(1)
    order = rng.permutation(len(vertices))
    vertices, faces = vertices[order], np.argsort(order)[faces]
    vertices = np.insert(vertices, 5, [9.0, 9.0, 9.0], axis=0)
    faces = faces + (faces >= 5)
    own, other = (written(tmp_path / f"{x}.obj", x * vertices, faces) for x in (1, 0.5))
    scene = kirby.build(1, 8, 1)
    scene["figure"] = {"type": "obj", "filename": str(own), "bsdf": MATT}
    kind = without_targets(scene, {KEY: UnknownConfig(start=str(other))}).unknowns[KEY].kind
    assert len(kind.present) == 42
    np.testing.assert_allclose(kind.start(str(other), "start"), 0.5 * kind.present, atol=1e-6)


@pytest.mark.parametrize("ending", ["ply", "obj"])
def test_a_start_with_a_number_that_is_none_is_refused_by_name(tmp_path, ending):
    kind, path = problem(views=1, side=8).unknowns[KEY].kind, tmp_path / f"start.{ending}"
    broken = kind.present.copy()
    broken[7, 1] = np.nan
    path.write_bytes(kind.files(broken)[ending])
    with pytest.raises(InputError, match=f"{path}: the position of vertex 7 is not finite"):
        kind.start(str(path), "start")


def test_vertices_that_no_face_names_do_not_count(tmp_path):
    """Files of cropped meshes keep them."""
    vertices, faces = ball(2)
    scene, path = kirby.build(1, 8, 1), tmp_path / "cropped.ply"
    kept = np.concatenate([vertices, [[50.0, 0, 0], [50.0, 0, 1e-6]]])
    trimesh.Trimesh(kept, faces, process=False).export(path)
    scene["figure"] = {"type": "ply", "filename": str(path), "bsdf": MATT}
    kind = without_targets(scene, {KEY: UnknownConfig(start="smooth")}).unknowns[KEY].kind
    assert len(kind.present) == len(vertices) + 2
    np.testing.assert_allclose(kind.start("sphere", "start")[:-2], vertices, atol=1e-3)
    larger = np.concatenate([3 * kind.present[:-2], kind.present[-2:]])
    path.write_bytes(kind.files(larger)["ply"])
    kind.start(str(path), "start")
    assert any("is 3 times as large as" in line for line in kind.warnings())


@pytest.mark.parametrize("unit", [1.0, 200.0])
@pytest.mark.parametrize("lr", [None, 0.5])
def test_a_shape_without_a_rate_moves_by_a_share_of_its_size(tmp_path, rng, unit, lr):
    vertices, faces = ball(2)
    trimesh.Trimesh(unit * vertices, faces, process=False).export(tmp_path / "figure.ply")
    figure = '<shape type="ply" id="figure"><string name="filename" value="figure.ply"/></shape>'
    text = f'<scene version="3.0.0">{paths(2)}{camera()}<emitter type="constant"/>{figure}</scene>'
    (tmp_path / "scene.xml").write_text(text)
    given = {KEY: {"start": "smooth"} | ({} if lr is None else {"lr": lr})}
    words = ["scene=file", f"scene.path={tmp_path / 'scene.xml'}"]
    words.append(f"scene.unknowns={json.dumps(given)}")
    made, _, _ = assemble.bare(schema.typed(compose(translate(words))).scene)
    stepper = Stepper(made.unknowns, OptimizerConfig(schedule="constant"))
    before = np.array(stepper.values[KEY])
    gradient = rng.normal(size=before.shape).astype(np.float32)
    stepper.step({KEY: made.unknowns[KEY].kind.value(gradient)}, 0.0)
    moved = np.abs(np.array(stepper.values[KEY]) - before).max()
    assert moved == pytest.approx(lr or 0.002 * unit * 2 * 3**0.5, rel=0.05)
    assert stepper.rate(0.0) == pytest.approx(moved, rel=1e-3)


def test_a_turntable_shows_the_same_in_any_unit(monkeypatch):
    monkeypatch.setattr(turntable, "_FRAMES", 1)
    vertices, faces = ball(2)

    def shown(times: float, *more: list) -> np.ndarray:
        points = np.concatenate([times * vertices, np.reshape(more, (-1, 3))]).astype(np.float32)
        file = turntable.made({"result": Surface(points, faces, None)})
        return np.asarray(Image.open(io.BytesIO(file)).convert("RGB"), np.float32)

    plain = shown(1.0)
    assert plain.std() > 10
    for other in (shown(3e-3), shown(1e4), shown(1.0, [50.0, 0, 0])):
        assert np.abs(other - plain).mean() < 2


@pytest.mark.parametrize(
    "times, shift, told", [(1, 0.1, None), (1, 30, "lies beside"), (3, 0, "is 3 times as large as")]
)
def test_a_start_from_a_file_that_is_elsewhere_is_told(tmp_path, times, shift, told):
    """As where to_world places the scene's own file."""
    kind, path = problem(views=1, side=8).unknowns[KEY].kind, tmp_path / "start.ply"
    middle = kind.present.mean(axis=0)
    moved = middle + times * (kind.present - middle) + shift
    path.write_bytes(kind.files(moved.astype(np.float32))["ply"])
    kind.start(str(path), "start")
    lines = [line for line in kind.warnings() if line.startswith("start of")]
    assert len(lines) == (told is not None)
    assert all(f"{path} {told}" in line and "after to_world" in line for line in lines)


def test_the_result_keeps_texture_coordinates(tmp_path):
    import trimesh

    vertices, faces = ball(1)
    corners = vertices[faces]
    coordinates = np.random.default_rng(2).random((len(faces), 3, 2))
    surface = meshes.from_corners(corners, coordinates, corners)
    scene = kirby.build(1, 8, 1) | {"figure": meshes.shape("figure", surface, MATT)}
    p = without_targets(scene, {KEY: UnknownConfig(start="smooth")})
    kind = p.unknowns[KEY].kind
    text = kind.files(kind.present)["obj"].decode()
    read = trimesh.load(io.StringIO(text), file_type="obj", process=False)
    assert len(read.vertices) == len(corners) * 3
    # As Mitsuba and Blender read it: v runs up the picture in such a file.
    (tmp_path / "figure.obj").write_text(text)
    again = mi.load_dict({"type": "obj", "filename": str(tmp_path / "figure.obj")})
    found = np.array(mi.traverse(again)["vertex_texcoords"]).reshape(-1, 2)
    np.testing.assert_allclose(found, coordinates.reshape(-1, 2), atol=1e-5)
    np.testing.assert_allclose(read.visual.uv, upwards(found), atol=1e-5)


def test_hard_edges_are_told():
    assert not any("normals of its file" in line for line in of(*ball(2)).warnings())
    cube = trimesh.creation.box()
    apart = meshes.from_corners(
        cube.vertices[cube.faces],
        np.zeros((0, 2)),
        np.repeat(cube.face_normals[:, None], 3, axis=1),
    )
    scene = kirby.build(1, 8, 1) | {"figure": meshes.shape("figure", apart, {"type": "diffuse"})}
    kind = without_targets(scene, {KEY: UnknownConfig(start="smooth")}).unknowns[KEY].kind
    (line,) = (line for line in kind.warnings() if "normals of its file" in line)
    assert "lie more than 20° beside those of the surface" in line and "look round" in line


@pytest.mark.parametrize("side", [1, -1])
def test_normals_that_point_the_other_way_than_triangles_turn_are_refused(side):
    """As where to_world mirrors: the shape's own are those of its triangles, and it was black."""
    to_world = mi.ScalarTransform4f().scale([side, 1, 1])
    scene = kirby.build(1, 8, 1) | {"figure": {"type": "cube", "to_world": to_world, "bsdf": MATT}}
    if side > 0:
        without_targets(scene, {KEY: UnknownConfig(start="smooth")})
        return
    told = "'figure' point the other way than its triangles turn, as where to_world mirrors"
    with pytest.raises(InputError, match=told):
        without_targets(scene, {KEY: UnknownConfig(start="smooth")})
