"""COLMAP's models: read as pycolmap reads them, and found where people have them."""

import shutil

import numpy as np
import photo_sets
import pytest
from photo_sets import CENTRE, FOCAL, POSES, Files

from isas_cli.cli.app import main
from isas_cli.config.photographs import PhotosConfig
from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos import layouts, photographs, reading

NAMES = [f"view_{number}.png" for number in range(3)]


def model(folder, place="sparse/0", poses=POSES, pictures="images") -> None:
    """A text model at ``place``."""
    photo_sets.colmap(Files(folder, poses))
    if pictures != "images":
        (folder / pictures).parent.mkdir(parents=True, exist_ok=True)
        shutil.move(folder / "images", folder / pictures)
    if place != "sparse/0":
        (folder / place).mkdir(parents=True, exist_ok=True)
        for file in (folder / "sparse" / "0").iterdir():
            shutil.move(file, folder / place / file.name)
        (folder / "sparse" / "0").rmdir()
        if not any((folder / "sparse").iterdir()):
            (folder / "sparse").rmdir()


def edit(file, change) -> None:
    file.write_text(change(file.read_text()))


def theirs(folder, place="sparse/0") -> dict:
    """Of every image of a model, as pycolmap has it: world to camera, ``(3, 4)``."""
    pycolmap = pytest.importorskip("pycolmap")
    found = pycolmap.Reconstruction(str(folder / place))
    return {image.name: image.cam_from_world().matrix() for image in found.images.values()}


def ours(folder, **more) -> dict:
    cameras = reading.read(str(folder), **more).cameras
    return {camera.name: np.linalg.inv(camera.to_world)[:3] for camera in cameras}


def agree(folder) -> None:
    mine, wanted = ours(folder), theirs(folder)
    assert list(mine) == NAMES[: len(mine)] and set(mine) == set(wanted)
    for name, matrix in wanted.items():
        np.testing.assert_allclose(mine[name], matrix, atol=1e-9)


def image(lines: str, number: int) -> tuple[list[str], int]:
    """The lines of images.txt, and where an image's is."""
    found = lines.splitlines()
    at = next(n for n, line in enumerate(found) if line.startswith(f"{number} "))
    return found, at


def with_blank(text: str, number: int, count: int) -> str:
    lines, at = image(text, number)
    return "\n".join(lines[:at] + [""] * count + lines[at:]) + "\n"


def without_points(text: str) -> str:
    """pycolmap wants points to know of what sees them."""
    return text.replace("1.5 2.5 7 3.0 4.0 -1", "1.5 2.5 -1 3.0 4.0 -1")


@pytest.mark.parametrize("number, count", [(1, 1), (2, 1), (3, 1), (2, 2)])
def test_empty_lines_before_a_record_are_skipped(tmp_path, number, count):
    model(tmp_path)
    file = tmp_path / "sparse" / "0" / "images.txt"
    edit(file, lambda text: with_blank(without_points(text), number, count))
    (tmp_path / "sparse" / "0" / "points3D.txt").write_text("")
    agree(tmp_path)
    assert len(ours(tmp_path)) == 3


def test_the_last_line_may_be_missing_and_lines_may_be_of_windows(tmp_path):
    """Of the last image, COLMAP 4.2 loses that; here it counts."""
    model(tmp_path)
    file = tmp_path / "sparse" / "0" / "images.txt"
    file.write_bytes(without_points(file.read_text()).strip().replace("\n", "\r\n").encode())
    (tmp_path / "sparse" / "0" / "points3D.txt").write_text("")
    mine, wanted = ours(tmp_path), theirs(tmp_path)
    assert list(mine) == NAMES and set(wanted) <= set(mine)
    for name, matrix in wanted.items():
        np.testing.assert_allclose(mine[name], matrix, atol=1e-9)


def test_pictures_that_are_all_missing_are_told_from_a_model_of_none(tmp_path):
    model(tmp_path)
    shutil.rmtree(tmp_path / "images")
    asked = PhotosConfig(path=str(tmp_path), sphere=[0.0, 0.0, 0.0, 0.5], missing="skip")
    with pytest.raises(InputError, match="none of 3 pictures exists, first view_0.png"):
        photographs.load(asked)
    (tmp_path / "sparse/0/images.txt").write_text("# nothing\n")
    with pytest.raises(InputError, match="images.txt lists no image"):
        photographs.load(asked)


def test_a_second_line_that_is_missing_is_told(tmp_path):
    """Then the next image's line is taken for points."""
    model(tmp_path)
    file = tmp_path / "sparse" / "0" / "images.txt"

    def drop(text: str) -> str:
        lines, at = image(text, 2)
        return "\n".join(lines[: at + 1] + lines[at + 2 :]) + "\n"

    edit(file, drop)
    with pytest.raises(InputError, match=r"images.txt:5: of an image's second line.*no multiple"):
        ours(tmp_path)


def rig(folder, write: str, moved: float = 0.0) -> dict:
    """Two cameras on a rig, two frames: a text or binary model of pycolmap; poses of images."""
    pycolmap = pytest.importorskip("pycolmap")
    if not hasattr(pycolmap, "Rig"):
        pytest.skip(f"pycolmap {pycolmap.__version__} has no rigs")
    found = pycolmap.Reconstruction()
    first = pycolmap.Camera(
        model="PINHOLE", width=40, height=30, params=[FOCAL, FOCAL, *CENTRE], camera_id=1
    )
    second = pycolmap.Camera(
        model="SIMPLE_RADIAL", width=40, height=30, params=[50, 20, 15, 0.05], camera_id=2
    )
    for camera in (first, second):
        found.add_camera(camera)
    turn = np.array([0.1, 0.2, 0.05, 0.97]) / np.linalg.norm([0.1, 0.2, 0.05, 0.97])
    there = pycolmap.Rigid3d(pycolmap.Rotation3d(turn), np.array([0.3, 0.1, 0.02]))
    made = pycolmap.Rig(rig_id=7)
    made.add_ref_sensor(first.sensor_id)
    made.add_sensor(second.sensor_id, there)
    found.add_rig(made)
    number = 0
    names = Files(folder, POSES).names(".png") + ["view_3.png"]
    shutil.copy(folder / names[0], folder / names[3])
    for at, pose in enumerate(POSES[:2], 1):
        frame, images = pycolmap.Frame(frame_id=at, rig_id=7), []
        for camera in (first, second):
            number += 1
            name = names[number - 1]
            each = pycolmap.Image(name=name, camera_id=camera.camera_id, image_id=number)
            frame.add_data_id(each.data_id)
            images.append(each)
        frame.rig_from_world = pycolmap.Rigid3d(np.linalg.inv(pose)[:3])
        found.add_frame(frame)
        for each in images:
            each.frame_id = at
            found.add_image(each)
        found.register_frame(at)
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    getattr(found, f"write_{write}")(str(sparse))
    return theirs(folder)


@pytest.mark.parametrize("write", ["text", "binary"])
def test_rigs(tmp_path, write):
    wanted = rig(tmp_path, write)
    mine = ours(tmp_path)
    assert set(mine) == set(wanted) and len(mine) == 4
    for name, matrix in wanted.items():
        np.testing.assert_allclose(mine[name], matrix, atol=1e-9)
    assert not reading.read(str(tmp_path)).notes


def test_poses_are_those_of_frames(tmp_path):
    """Where images.txt differs, COLMAP takes frames.txt; and so it does without images' poses."""
    rig(tmp_path, "text")
    file = tmp_path / "sparse" / "0" / "images.txt"
    lines, at = image(file.read_text(), 2)
    words = lines[at].split()
    lines[at] = " ".join([*words[:5], "9", *words[6:]])
    file.write_text("\n".join(lines) + "\n")
    wanted, mine = theirs(tmp_path), ours(tmp_path)
    for name, matrix in wanted.items():
        np.testing.assert_allclose(mine[name], matrix, atol=1e-9)
    (note,) = reading.read(str(tmp_path)).notes
    assert "images.txt: poses of 1 images differ" in note


def test_frames_that_lack_something(tmp_path):
    rig(tmp_path, "text")
    rigs, frames = (tmp_path / "sparse" / "0" / f"{name}.txt" for name in ("rigs", "frames"))
    kept = rigs.read_text(), frames.read_text()
    rigs.write_text(kept[0].replace("CAMERA 2 1 ", "CAMERA 2 0 ").split("CAMERA 2 0")[0])
    with pytest.raises(InputError, match="images.txt:.*rigs.txt has no pose of camera 2"):
        ours(tmp_path)
    rigs.write_text(kept[0])
    frames.write_text(kept[1].replace("2 CAMERA 1 1 CAMERA 2 2", "1 CAMERA 1 1"))
    with pytest.raises(InputError, match="images.txt:.*image 2 is in no frame of frames.txt"):
        ours(tmp_path)


@pytest.mark.parametrize(
    "place, pictures",
    [
        (".", "images"),
        ("sparse", "images"),
        ("sparse/1", "images"),
        ("colmap/sparse/0", "images"),
        ("dense/0/sparse", "dense/0/images"),
        ("dense/sparse", "dense/images"),
        ("0/sparse", "0/images"),
    ],
)
def test_models_where_people_have_them(tmp_path, place, pictures):
    model(tmp_path, place, pictures=pictures)
    found = reading.read(str(tmp_path))
    assert [camera.name for camera in found.cameras] == NAMES and not found.notes
    assert all(camera.image.parent == tmp_path / pictures for camera in found.cameras)


def test_undistorted_pictures_go_with_their_cameras(tmp_path):
    """A dense model's pictures are its own, although the others have the same names."""
    model(tmp_path, "dense/0/sparse", pictures="dense/0/images")
    shutil.copytree(tmp_path / "dense" / "0" / "images", tmp_path / "images")
    (camera, *_) = reading.read(str(tmp_path)).cameras
    assert camera.image.parent == tmp_path / "dense" / "0" / "images"


@pytest.mark.parametrize("binary", [False, True])
def test_of_several_models_the_largest_is_taken(tmp_path, binary, capfd, monkeypatch):
    model(tmp_path)
    sparse = tmp_path / "sparse"
    edit(sparse / "0" / "images.txt", without_points)
    (sparse / "0" / "points3D.txt").write_text("")
    shutil.copytree(sparse / "0", sparse / "1")
    shutil.copytree(sparse / "0", sparse / "10")
    for small in ("0", "10"):
        lines, at = image((sparse / small / "images.txt").read_text(), 3)
        (sparse / small / "images.txt").write_text("\n".join(lines[:at]) + "\n")
    if binary:
        pycolmap = pytest.importorskip("pycolmap")
        for number in ("0", "1", "10"):
            pycolmap.Reconstruction(str(sparse / number)).write_binary(str(sparse / number))
            for file in (sparse / number).glob("*.txt"):
                file.unlink()
    found = reading.read(str(tmp_path))
    assert len(found.cameras) == 3
    (note,) = found.notes
    told = "sparse/1 is taken of sparse/0 (2 images), sparse/1 (3 images), sparse/10 (2 images)"
    assert told in note and "photos.cameras=sparse/0" in note
    other = reading.read(str(tmp_path), cameras="sparse/0")
    assert len(other.cameras) == 2 and not other.notes
    monkeypatch.chdir(tmp_path)
    assert main(["photos", "."]) == 0
    assert told in " ".join(capfd.readouterr().out.split())


def test_of_models_alike_the_first_by_number_is_taken(tmp_path):
    model(tmp_path, "sparse/10")
    shutil.copytree(tmp_path / "sparse" / "10", tmp_path / "sparse" / "9")
    (note,) = reading.read(str(tmp_path)).notes
    assert note.startswith("sparse/9 is taken of sparse/9 (3 images), sparse/10 (3 images)")


def test_a_binary_model_without_points(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    model(tmp_path)
    place = tmp_path / "sparse/0"
    wanted = ours(tmp_path)
    pycolmap.Reconstruction(str(place)).write_binary(str(place))
    for name in ("cameras.txt", "images.txt", "points3D.txt", "points3D.bin"):
        (place / name).unlink()
    found = ours(tmp_path)
    assert found.keys() == wanted.keys()
    for name in found:
        np.testing.assert_allclose(found[name], wanted[name], atol=1e-6)


def test_messages_name_the_users_files(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    model(tmp_path)
    sparse = tmp_path / "sparse" / "0"
    edit(sparse / "images.txt", without_points)
    (sparse / "points3D.txt").write_text("")
    found = pycolmap.Reconstruction(str(sparse))
    found.write_binary(str(sparse))
    for file in sparse.glob("*.txt"):
        file.unlink()
    (tmp_path / "images" / "view_1.png").unlink()
    with pytest.raises(InputError) as error:
        ours(tmp_path)
    told = str(error.value)
    assert told.startswith(f"{sparse}/images.bin: entry 2: its picture") and "/tmp/tmp" not in told
    assert str(tmp_path / "images" / "view_1.png") in told
    (sparse / "images.bin").write_bytes(b"\3\0")
    with pytest.raises(InputError, match="cameras.bin: pycolmap cannot read the model") as error:
        ours(tmp_path)
    assert "\n" not in str(error.value)


def test_cameras_that_are_named(tmp_path):
    """Beside a transforms.json, and what is no camera."""
    model(tmp_path)
    photo_sets.transforms(Files(tmp_path, POSES[:2]))
    assert reading.read(str(tmp_path)).kind == "transforms.json"
    for name in ("sparse", "sparse/0", "sparse/0/cameras.txt"):
        assert reading.read(str(tmp_path), cameras=name).kind == "COLMAP"
    assert reading.read(str(tmp_path), cameras="transforms.json").kind == "transforms.json"
    for name, told in (("gone", "no such file or folder"), ("view_0.exr", "of no format")):
        with pytest.raises(InputError, match=f"photos.cameras={name}: .*{told}"):
            reading.read(str(tmp_path), cameras=name)


@pytest.mark.parametrize("readable, taken", [(True, "cameras.bin"), (False, "cameras.txt")])
def test_of_a_model_in_both_forms_the_binary_one_counts(tmp_path, monkeypatch, readable, taken):
    """As COLMAP has it; and it is said."""
    photo_sets.colmap(Files(tmp_path, POSES))
    model = tmp_path / "sparse/0"
    found = object() if readable else None
    monkeypatch.setattr(layouts.importlib.util, "find_spec", lambda name: found)
    (model / "cameras.bin").touch()
    assert layouts.chosen(tmp_path)[0].name == "cameras.txt"  # what is not whole does not count
    for name in ("images", "points3D"):
        (model / f"{name}.bin").touch()
    assert layouts.chosen(tmp_path)[0].name == taken
    (note,) = layouts.notes(model, tmp_path)
    assert f"holds its model twice: {taken} is taken" in note


def test_a_table_of_angles_is_no_model(tmp_path):
    """Metashape's, which its dialogue offers to call cameras.txt; other cameras stand before it."""
    told = "# Cameras (1)\n# PhotoID, X, Y, Z, Omega, Phi, Kappa, r11, r12, r13\n"
    (tmp_path / "cameras.txt").write_text(told + "a 1.txt\t0\t0\t2\t0\t0\t0\t1\t0\t0\n")
    with pytest.raises(InputError, match="cameras.txt: is no COLMAP file.*Metashape.*XML") as error:
        reading.read(str(tmp_path))
    assert "\n" not in str(error.value)
    photo_sets.neus(Files(tmp_path, POSES))
    assert reading.read(str(tmp_path)).kind == "NeuS"
