"""`transforms.json` as nerfstudio, instant-ngp and Blender write it: lenses, angles, paths, and
what was applied to the poses."""

import json
import math

import numpy as np
import photo_sets
import pytest
from photo_sets import FOCAL, POSES, SIZE, Files, change
from test_photo_lenses import MODELS, POINTS

from isas_cli.cli.app import main
from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos import models, reading

# What nerfstudio's colmap_to_json writes: y and z of COLMAP's world to z up.
TURN = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]])


def first(folder, **more):
    return reading.read(str(folder), **more).cameras[0]


@pytest.mark.parametrize(
    "model, per_frame", [(m, False) for m in (*MODELS, "PERSPECTIVE")] + [("FULL_OPENCV", True)]
)
def test_camera_models_by_name(tmp_path, model, per_frame):
    """nerfstudio's names and COLMAP's, at the top or with a frame, mean what COLMAP means."""
    read = "OPENCV" if model == "PERSPECTIVE" else model
    names = models.PARAMETERS[read].split()
    values = dict(zip(names, MODELS[read]))
    for name, both in (("f", ("fl_x", "fl_y")), ("fx", ("fl_x",)), ("fy", ("fl_y",))):
        if name in values:
            values |= dict.fromkeys(both, values.pop(name))
    photo_sets.transforms(Files(tmp_path, POSES), fl_x=1.0, fl_y=1.0)
    told = {**values, "camera_model": model}
    change(tmp_path, lambda c: (c["frames"][0] if per_frame else c).update(told))
    camera = first(tmp_path)
    pixels = camera.project(POINTS @ POSES[0][:3, :3].T + POSES[0][:3, 3])[0]
    pycolmap = pytest.importorskip("pycolmap")
    if read not in pycolmap.CameraModelId.__members__:
        pytest.skip(f"pycolmap {pycolmap.__version__} has no {read}")
    theirs = pycolmap.Camera(model=read, width=40, height=30, params=MODELS[read], camera_id=1)
    np.testing.assert_allclose(pixels, [theirs.img_from_cam(p) for p in POINTS], atol=1e-8)


def test_the_fourth_radial_factor(tmp_path):
    """Alone it is nerfstudio's, of r⁸; with a fifth or sixth OpenCV's, below the fraction."""
    photo_sets.transforms(Files(tmp_path, POSES), k1=0.1, k4=0.02)
    assert first(tmp_path).lens.radial == (0.1, 0, 0, 0.02) and not first(tmp_path).lens.below
    change(tmp_path, lambda c: c.update(k6=0.01))
    assert first(tmp_path).lens.radial == (0.1, 0, 0, 0)
    assert first(tmp_path).lens.below == (0.02, 0, 0.01)


def test_a_byte_order_mark_is_no_letter(tmp_path):
    photo_sets.transforms(Files(tmp_path, POSES))
    file = tmp_path / "transforms.json"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert len(reading.read(str(tmp_path)).cameras) == 3


def test_instant_ngps_fisheye(tmp_path):
    photo_sets.transforms(Files(tmp_path, POSES), is_fisheye=True, k1=0.05, k2=0.01)
    assert first(tmp_path).lens.kind == "fisheye"
    assert first(tmp_path).lens.radial == (0.05, 0.01, 0, 0)
    change(tmp_path, lambda c: c.update(fisheye_crop_radius=12.0))
    (note,) = reading.read(str(tmp_path)).notes
    assert "fisheye_crop_radius is not heeded" in note


def angle(axis: int) -> float:
    return 2 * math.atan(SIZE[axis] / 2 / FOCAL)


@pytest.mark.parametrize(
    "told",
    [
        {"x_fov": math.degrees(angle(0))},
        {"y_fov": math.degrees(angle(1))},
        {"fov_x": math.degrees(angle(0))},
        {"fov_y": math.degrees(angle(1))},
        {"camera_angle_x": angle(0)},
        {"camera_angle_y": angle(1)},
        {"camera_angle_x": angle(0), "camera_angle_y": angle(1)},
        {"fl_y": FOCAL},
    ],
    ids=lambda told: "-".join(told),
)
def test_focal_lengths_and_angles(tmp_path, told):
    photo_sets.transforms(Files(tmp_path, POSES))
    change(tmp_path, lambda c: (c.pop("fl_x"), c.pop("fl_y"), c.update(told)))
    camera = first(tmp_path)
    np.testing.assert_allclose((camera.fx, camera.fy), FOCAL)


def test_what_a_frame_says_of_its_focal_length_stands_before_the_top(tmp_path):
    """In whichever words: instant-ngp reads the top first, then the frame."""
    photo_sets.transforms(Files(tmp_path, POSES), fl_x=2 * FOCAL, fl_y=3 * FOCAL)
    change(tmp_path, lambda c: c["frames"][0].update(camera_angle_x=angle(0)))
    one, other = reading.read(str(tmp_path)).cameras[:2]
    np.testing.assert_allclose((one.fx, one.fy), FOCAL)
    assert (other.fx, other.fy) == (2 * FOCAL, 3 * FOCAL)


@pytest.mark.parametrize("name", ["images\\view_0.png", ".\\images\\view_0", "./images/view_0"])
def test_paths_of_windows_and_without_endings(tmp_path, name):
    content = photo_sets.transforms(Files(tmp_path, POSES))
    (tmp_path / "images").mkdir()
    Files(tmp_path / "images", POSES).names(".png")
    content["frames"][0]["file_path"] = name
    photo_sets.write(tmp_path / "transforms.json", {**content, "test_filenames": [name]})
    camera = first(tmp_path)
    assert camera.image == tmp_path / "images" / "view_0.png"
    assert camera.name == name.replace("\\", "/").removeprefix("./")
    capture = reading.read(str(tmp_path), "given")
    assert reading.split(capture, "given")[1] == [capture.cameras[0]]


def applied(folder, turn=TURN, scale=1.0) -> None:
    """As nerfstudio writes what it applied: poses of the new world."""
    whole = np.vstack([turn, [0, 0, 0, 1]])

    def edit(content) -> None:
        for frame in content["frames"]:
            pose = whole @ np.array(frame["transform_matrix"])
            pose[:3, :3] /= np.cbrt(np.linalg.det(whole))
            pose[:3, 3] *= scale
            frame["transform_matrix"] = pose.tolist()
        content.update(applied_transform=turn.tolist())
        if scale != 1:
            content.update(applied_scale=scale)

    change(folder, edit)


@pytest.mark.parametrize("turn", [TURN, TURN + [[0, 0, 0, 0.5]] * 3, 2 * TURN], ids="rms")
@pytest.mark.parametrize("scale", [1.0, 0.25])
def test_what_was_applied_is_undone(tmp_path, turn, scale):
    """A mesh of the world before is seen where it was, and it is said."""
    photo_sets.transforms(Files(tmp_path, POSES))
    applied(tmp_path, turn, scale)
    capture = reading.read(str(tmp_path))
    for camera, pose in zip(capture.cameras, POSES):
        np.testing.assert_allclose(camera.to_world, pose, atol=1e-9)
    (note,) = capture.notes
    assert "applied_transform" in note and "undone" in note and "photos.world=file" in note
    stay = reading.read(str(tmp_path), world="file")
    whole = np.vstack([turn, [0, 0, 0, 1]])
    wanted = (whole @ POSES[0])[:3, 3] * scale
    np.testing.assert_allclose(stay.cameras[0].to_world[:3, 3], wanted, atol=1e-9)
    assert "stay" in stay.notes[0]


def test_nothing_is_said_where_nothing_was_applied(tmp_path):
    photo_sets.transforms(Files(tmp_path, POSES), applied_transform=np.eye(4)[:3].tolist())
    assert not reading.read(str(tmp_path)).notes
    with pytest.raises(InputError, match="photos.world=file: .*transforms.json tells of no other"):
        reading.read(str(tmp_path), world="file")
    # Where instant-ngp puts the scene in its own cube changes no pose.
    ngp = {"aabb_scale": 16, "scale": 0.33, "offset": [0.5, 0.5, 0.5]}
    change(tmp_path, lambda c: c.update(ngp))
    np.testing.assert_allclose(first(tmp_path).to_world, POSES[0], atol=1e-12)


def test_isas_photos_says_what_was_applied(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    photo_sets.transforms(Files(tmp_path, POSES))
    applied(tmp_path)
    assert main(["photos", ".", "photos.sphere=[0,0,0,0.4]"]) == 0
    out = " ".join(capfd.readouterr().out.split())
    assert "note: transforms.json: applied_transform undone" in out and "warning" not in out


@pytest.mark.parametrize(
    "edit, told",
    [
        (dict(camera_model="ORTHOPHOTO"), "camera_model ORTHOPHOTO; valid: .*image_undistorter"),
        (dict(camera_model="FISHEYE624"), "camera_model FISHEYE624; valid"),
        (dict(camera_model=[7]), r"camera_model \[7\]; valid"),
        (dict(equirectangular=True), "frame 0: equirectangular; valid"),
        (dict(ftheta_p0=0.1), "frame 0: ftheta_p0; valid"),
        (dict(rolling_shutter=[0, [1, 2], 0]), "rolling_shutter .*moves"),
        (dict(rolling_shutter=[0, 0, 1, 0]), "rolling_shutter .*moves"),
        (dict(camera_model="OPENCV_FISHEYE", k1="a"), "k1='a': no number"),
        (dict(fl_x=None, x_fov=200), "x_fov=200: degrees, between"),
        (dict(fl_x=None, fov_x=0.7), "fov_x=0.7: degrees.*radians are camera_angle_x"),
        (dict(applied_transform=[[1, 0]]), "applied_transform: no matrix"),
        (dict(applied_transform=np.diag([1, 1, -1, 1]).tolist()), "cannot be undone"),
        (dict(applied_scale=0), "applied_scale cannot be undone"),
        (dict(applied_scale="big"), "applied_scale='big': no number"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, edit, told):
    photo_sets.transforms(Files(tmp_path, POSES))

    def put(content) -> None:
        content.update(edit)
        for name in [name for name, value in edit.items() if value is None]:
            del content[name]

    change(tmp_path, put)
    with pytest.raises(InputError, match=told) as error:
        reading.read(str(tmp_path))
    assert "\n" not in str(error.value) and str(error.value).startswith(str(tmp_path))


def test_the_turn_that_an_older_nerfstudio_did_not_write_is_undone(tmp_path):
    """Rows of COLMAP's poses as it wrote them, beside the model that they are of."""
    photo_sets.transforms(Files(tmp_path, POSES))

    def edit(content) -> None:
        for frame in content["frames"]:
            pose = np.array(frame["transform_matrix"])[[1, 0, 2, 3]]
            pose[2] *= -1
            frame["transform_matrix"] = pose.tolist()

    change(tmp_path, edit)
    (tmp_path / "colmap/sparse/0").mkdir(parents=True)
    capture = reading.read(str(tmp_path))
    for camera, pose in zip(capture.cameras, POSES):
        np.testing.assert_allclose(camera.to_world, pose, atol=1e-9)
    (note,) = capture.notes
    assert "an older nerfstudio's turn of COLMAP's world (colmap/sparse/0 is there) undone" in note
    stay = reading.read(str(tmp_path), world="file")
    assert "stay" in stay.notes[0] and not np.allclose(stay.cameras[0].to_world, POSES[0])
    # Later versions say what they applied, and instant-ngp turns otherwise.
    for word in ({"ply_file_path": "sparse_pc.ply"}, {"aabb_scale": 16}):
        content = json.loads((tmp_path / "transforms.json").read_text())
        photo_sets.write(tmp_path / "transforms.json", content | word)
        assert not reading.read(str(tmp_path)).notes
        photo_sets.write(tmp_path / "transforms.json", content)


def test_axes_that_nerfstudio_changes_without_a_word_are_doubted(tmp_path):
    photo_sets.transforms(Files(tmp_path, POSES), orientation_override="none")
    (note,) = reading.read(str(tmp_path)).notes
    assert "may be nerfstudio's of Polycam or Metashape" in note
    change(tmp_path, lambda c: c.update(applied_transform=TURN.tolist()))
    (note,) = reading.read(str(tmp_path)).notes
    assert "applied_transform undone" in note
