"""`isas photos`: the table, the sheet, the warnings."""

import json

import numpy as np
import photo_sets
import pytest
import trimesh
from isas_cli.scenes.meshes import Surface
from photo_sets import POSES, SIZE, Files

from isas_cli.config.schema import PhotosConfig
from isas_cli.runtime import images
from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos import corners, photographs, shape

# What is said of each mesh as trimesh makes it.
BARE = "{} has no texture coordinates: one colour for all of it; unwrap it for a texture"


@pytest.fixture
def called(isas, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    return isas


def ball(folder, at=(0.0, 0.0, 0.0), radius=0.4) -> str:
    mesh = trimesh.creation.icosphere(2, radius)
    mesh.apply_translation(at)
    mesh.export(folder / "ball.ply")
    return str(folder / "ball.ply")


def test_the_chessboard(called, tmp_path):
    status, out, _ = called("photos", "chessboard", "photos.test=[left03.png]")
    assert status == 0
    assert "12 views to learn from, 1 held out" in out and "left03.png (held out)" in out
    assert "0.22 px" in out
    # The board was moved, and so turned in the light.
    assert (
        out.count("warning: ") == out.count("times as bright in left05.png as in left11.png") == 1
    )
    sheet = images.read(tmp_path / "photos-chessboard.png")
    assert sheet.shape == (792, 1636, 3)
    # Outlines, expected corners and found ones are drawn.
    for colour in ((0, 230, 80), (255, 60, 40), (60, 160, 255)):
        wanted = images.srgb_decode(np.array(colour) / 255)
        assert (np.abs(sheet - wanted).max(axis=2) < 0.02).sum() > 100


def test_an_outline_is_where_the_object_ends(tmp_path):
    """Of a ball, seen from outside: a closed curve through the points whose rays touch it."""
    from isas_cli.scene.photos.edges import Outline

    photo_sets.transforms(Files(tmp_path, POSES))
    taken = photographs.load(PhotosConfig(path=str(tmp_path), sphere=[0.0, 0.0, 0.0, 0.4]))
    camera = taken.shown[0].camera
    lines = Outline(taken.surface).seen(camera)
    distance = np.linalg.norm(camera.centre)
    rotation = camera.to_world[:3, :3]
    pixels = lines.reshape(-1, 2)
    rays = (
        np.column_stack([(pixels - [camera.cx, camera.cy]) / camera.fx, np.ones(len(pixels))])
        @ rotation.T
    )
    towards = -camera.centre / distance
    angle = np.arccos(rays @ towards / np.linalg.norm(rays, axis=1))
    assert len(lines) > 50
    np.testing.assert_allclose(angle, np.arcsin(0.4 / distance), rtol=0.02)


@pytest.mark.parametrize(
    "place, told",
    [
        (dict(radius=0.4), None),
        (dict(at=(40.0, 0, 0)), "outside the picture of|behind"),
        (dict(radius=0.004), "fills less than 1%"),
        (dict(radius=4), "3 cameras stand inside the mesh"),
    ],
)
def test_warnings(called, tmp_path, place, told):
    photo_sets.transforms(Files(tmp_path, POSES))
    status, out, _ = called("photos", ".", f"photos.mesh={ball(tmp_path, **place)}")
    assert status == 0
    out = " ".join(out.split())
    bare = "warning: " + BARE.format(tmp_path / "ball.ply")
    assert bare in out
    out = out.replace(bare, "")
    assert any(t in out for t in told.split("|")) if told else "warning: " not in out, out


def test_axes_of_another_format_look_the_other_way(called, tmp_path):
    """OpenCV's matrices in a file whose format has OpenGL's."""
    content = photo_sets.transforms(Files(tmp_path, POSES))
    for frame, pose in zip(content["frames"], POSES):
        frame["transform_matrix"] = pose.tolist()
    photo_sets.write(tmp_path / "transforms.json", content)
    status, out, _ = called("photos", ".", f"photos.mesh={ball(tmp_path)}")
    assert status == 0 and "lies behind 3 of 3 cameras" in " ".join(out.split())


def test_known_points_of_colmap_that_lie_off(called, tmp_path):
    photo_sets.colmap(Files(tmp_path, POSES))
    status, out, _ = called("photos", ".")
    out = " ".join(out.split())
    assert status == 0 and "more than 2 pixels off in 1 views, most in view_0.png" in out
    assert "no object is given" in out


def test_views_that_the_files_hold_out(called, tmp_path):
    content = photo_sets.blender(Files(tmp_path, POSES))
    for part, frames in (("train", content["frames"][:2]), ("test", content["frames"][2:])):
        photo_sets.write(tmp_path / f"transforms_{part}.json", {**content, "frames": frames})
    status, out, _ = called("photos", ".", "photos.test=given")
    out = " ".join(out.split())
    assert status == 0 and "2 views to learn from, 1 held out" in out and "view_2 (held out)" in out


@pytest.mark.parametrize(
    "arguments, told",
    [
        (["nowhere"], "photos.path=nowhere: no such folder"),
        ([], "give one folder"),
        (["a", "b"], "give one folder"),
        (["."], "no cameras there"),
        (["chessboard", "photos.mesh=gone.obj"], "photos.mesh=gone.obj: no such file"),
        (["chessboard", "photos.mesh=."], "photos.mesh=.: no such file"),
        (["chessboard", "photos.mash=a.obj"], "photos.mash: no such setting; did you mean"),
        (["chessboard", "photos.width=0"], "photos.width=0: at least 1"),
        (["chessboard", "photos.exposure=auto"], "valid: fixed, scale, channels"),
        (["chessboard", "photos.plane=[0,0,1,1]", "photos.sphere=[0,0,0,1]"], "one shape alone"),
        (["chessboard", "seed=1"], "settings of photographs"),
        (["chessboard", "--fast"], "no such flag"),
    ],
)
def test_what_is_mistyped_is_one_line(called, tmp_path, arguments, told):
    status, out, err = called("photos", *arguments)
    assert status == 2 and told in err and err.count("\n") == 1, err
    assert not list(tmp_path.iterdir())


def test_corners_are_found_within_a_tenth_of_a_pixel():
    """Of a drawn board, slanted and blurred, from guesses a pixel off; not where there is none."""
    rows, columns = np.indices((120, 160)) + 0.5
    x, y = columns - 40.3, rows - 30.7
    u, v = x * 0.9 + y * 0.2, y * 0.95 - x * 0.1
    board = np.tanh(np.sin(np.pi * u / 14) * np.sin(np.pi * v / 14) * 6)
    wanted = []
    for i, j in ((0, 0), (2, 1), (4, 3)):
        wanted.append(np.linalg.solve([[0.9, 0.2], [-0.1, 0.95]], [14 * i, 14 * j]) + [40.3, 30.7])
    wanted = np.array(wanted)
    numbers, places = corners.found(board, wanted + [0.8, -0.7])
    assert list(numbers) == [0, 1, 2]
    assert np.linalg.norm(places - wanted, axis=1).max() < 0.1
    flat = np.ones((120, 160))
    assert len(corners.found(flat, wanted)[0]) == 0


def test_meshes_from_files(tmp_path):
    """What trimesh writes, with and without coordinates, is the same surface; edges stay sharp."""

    def read(path) -> Surface:
        asked = PhotosConfig(mesh=str(path))
        return shape.parts(asked, photographs.Capture([], "none"))["object"]

    box = trimesh.creation.box((1, 2, 3))
    for ending in ("obj", "ply", "stl", "glb"):
        path = tmp_path / f"box.{ending}"
        box.export(path)
        found = read(path)
        assert len(found.faces) == 12 and found.texcoords.shape == (0, 2)
        np.testing.assert_allclose(np.ptp(found.vertices, axis=0), [1, 2, 3])
        # Each normal along an axis, away from the middle.
        np.testing.assert_allclose(np.abs(found.normals).max(axis=1), 1, atol=1e-6)
        assert (np.einsum("vk,vk->v", found.normals, found.vertices) > 0).all()
    (tmp_path / "square.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
        "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    )
    square = read(tmp_path / "square.obj")
    np.testing.assert_allclose(square.texcoords[:, 0], square.vertices[:, 0])
    np.testing.assert_allclose(square.texcoords[:, 1], 1 - square.vertices[:, 1])
    for name, text, told in (
        ("bad.obj", "v a b c\n", "bad.obj"),
        ("bad.glb", "no", "cannot be read"),
        ("bad.png", "", "a mesh is one of"),
        ("empty.ply", "", "empty.ply"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match=told):
            read(tmp_path / name)


def test_the_size_of_a_picture_is_its_header(tmp_path):
    images.write_png(tmp_path / "a.png", np.zeros((SIZE[1], SIZE[0], 3), np.uint8))
    assert images.size(tmp_path / "a.png") == SIZE
    assert images.read_alpha(tmp_path / "a.png") is None
    with pytest.raises(InputError, match="no such picture"):
        images.size(tmp_path / "b.png")
    assert json.dumps(images.size(tmp_path / "a.png"))  # plain numbers


def test_places_too_far_from_the_origin_are_said(tmp_path):
    """A surveyor's coordinates, of which 32 bits keep half units: the mesh has another shape."""
    for offset, doubted in ((0.0, False), (5.4e6, True)):
        content = photo_sets.transforms(Files(tmp_path, POSES))
        for frame in content["frames"]:
            frame["transform_matrix"] = np.array(frame["transform_matrix"], np.float64)
            frame["transform_matrix"][1, 3] += offset
            frame["transform_matrix"] = frame["transform_matrix"].tolist()
        photo_sets.write(tmp_path / "transforms.json", content)
        asked = PhotosConfig(path=str(tmp_path), mesh=ball(tmp_path, (0.0, offset, 0.0)))
        told = [w for w in photographs.load(asked).warnings if "32 bits" in w]
        assert len(told) == doubted
        assert not doubted or "5.4e+06 units from the origin" in told[0]


def test_an_object_that_rays_leave_far_above_its_surface_is_said(tmp_path):
    """In its unit it is as small as the renderer's own offset, which no picture tells."""
    for size, said in ((1.0, False), (2e-3, True)):
        content = photo_sets.transforms(Files(tmp_path, POSES))
        for frame in content["frames"]:
            pose = np.array(frame["transform_matrix"], np.float64)
            pose[:3, 3] *= size
            frame["transform_matrix"] = pose.tolist()
        photo_sets.write(tmp_path / "transforms.json", content)
        asked = PhotosConfig(path=str(tmp_path), mesh=ball(tmp_path, radius=0.4 * size))
        told = [w for w in photographs.load(asked).warnings if "bounces begin" in w]
        assert len(told) == said
        assert not said or "scale the mesh and all cameras up alike" in told[0]


def test_a_mesh_whose_picture_is_missing_is_read_quietly(called, tmp_path, caplog):
    """MeshLab's PLY names it; trimesh would log a traceback, which looks like a defect."""
    photo_sets.transforms(Files(tmp_path, POSES))
    (tmp_path / "flat.ply").write_text(
        "ply\nformat ascii 1.0\ncomment TextureFile gone.png\nelement vertex 3\n"
        "property float x\nproperty float y\nproperty float z\nproperty float s\n"
        "property float t\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "-0.4 -0.4 0 0 0\n0.4 -0.4 0 1 0\n0 0.4 0 0.5 1\n3 0 1 2\n"
    )
    status, out, errors = called("photos", str(tmp_path), "photos.mesh=flat.ply")
    assert status == 0 and "Traceback" not in out + errors
    assert not [
        each for each in caplog.records if each.name.startswith("trimesh")
    ]  # else on stderr
