"""Cameras of every format: where they see known points, and what is refused."""

import dataclasses
import re

import mitsuba as mi
import numpy as np
import photo_sets
import pytest
import trimesh
from photo_sets import CENTRE, FOCAL, POSES, SIZE, Files
from PIL import Image
from test_photo_maps import built

from isas_cli.config.photographs import PhotosConfig
from isas_cli.config.schema import OptimizerConfig
from isas_cli.engine.optimiser import Stepper
from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos import building, photographs, reading
from isas_cli.scene.photos.camera import Camera
from isas_cli.scene.photos.lens import Lens

POINTS = np.array([[0.0, 0.0, 0.0], [0.3, -0.2, 0.1], [-0.25, 0.3, 0.2], [0.1, 0.2, -0.4]])
FORMATS = ["transforms", "blender", "ours", "colmap"]


def expected(pose: np.ndarray, centre=CENTRE) -> np.ndarray:
    """By the textbook: pixels from the picture's corner."""
    x, y, z = (np.linalg.inv(pose) @ np.column_stack([POINTS, np.ones(len(POINTS))]).T)[:3]
    return np.column_stack([FOCAL * x / z + centre[0], FOCAL * y / z + centre[1]])


def in_opengl(matrix, centre) -> np.ndarray:
    """The same of a matrix whose camera has y up and looks along -z, without turning its axes."""
    x, y, z = (np.linalg.inv(matrix) @ np.column_stack([POINTS, np.ones(len(POINTS))]).T)[:3]
    return np.column_stack([FOCAL * x / -z + centre[0], centre[1] - FOCAL * y / -z])


@pytest.fixture(params=FORMATS)
def cameras(request, tmp_path) -> tuple[list[Camera], tuple]:
    getattr(photo_sets, request.param)(Files(tmp_path, POSES))
    middle = SIZE[0] / 2, SIZE[1] / 2
    centre = middle if request.param == "blender" else CENTRE
    return reading.read(str(tmp_path)).cameras, centre


def test_each_format_sees_known_points_where_they_are(cameras):
    found, centre = cameras
    assert len(found) == len(POSES)
    for camera, pose in zip(found, POSES):
        pixels, depth = camera.project(POINTS)
        np.testing.assert_allclose(pixels, expected(pose, centre), atol=1e-6)
        assert (depth > 0).all()
        assert camera.image.is_file() and (camera.width, camera.height) == SIZE


def test_matrices_of_nerf_mean_what_opengl_says(tmp_path):
    told = photo_sets.transforms(Files(tmp_path, POSES))
    for frame, camera in zip(told["frames"], reading.read(str(tmp_path)).cameras):
        pixels, _ = camera.project(POINTS)
        np.testing.assert_allclose(pixels, in_opengl(frame["transform_matrix"], CENTRE), atol=1e-6)


def test_mitsubas_rays_go_through_the_points(cameras):
    """Of every format: the ray through the pixel where a point is seen passes through it."""
    found, _ = cameras
    for camera in found:
        sensor = mi.load_dict(building.sensor(camera, np.zeros(3), 1.0))
        pixels, _ = camera.project(POINTS)
        at = mi.Point2f((pixels / SIZE).T)
        ray, _ = sensor.sample_ray_differential(0.0, 0.0, at, mi.Point2f(0.5))
        origin, direction = np.array(ray.o).T.reshape(-1, 3), np.array(ray.d).T
        way = POINTS - origin
        off = np.linalg.norm(np.cross(way, direction), axis=1)
        assert off.max() < 1e-4, off
        assert (np.einsum("nk,nk->n", way, direction) > 0).all()


def browns(x, y, k, p1, p2):
    """OpenCV's formula, written out."""
    r2 = x * x + y * y
    radial = 1 + k[0] * r2 + k[1] * r2**2 + k[2] * r2**3 + k[3] * r2**4
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def test_a_lens_is_browns():
    wanted = browns(0.3, -0.2, (0.1, -0.05, 0.02, 0.01), 0.003, 0.002)
    np.testing.assert_allclose(lens().lens.distort(np.array([0.3, -0.2])), wanted, rtol=1e-12)


def lens(radial=(0.1, -0.05, 0.02, 0.01), tangential=(0.003, 0.002), **more) -> Camera:
    values = dict(
        name="a.png",
        image=None,
        width=SIZE[0],
        height=SIZE[1],
        fx=FOCAL,
        fy=FOCAL,
        cx=20.0,
        cy=15.0,
        to_world=np.eye(4),
        lens=Lens(radial, tangential),
    )
    return Camera(**values | more)


def test_models_of_colmap(tmp_path):
    numbers = FOCAL, FOCAL + 1, *CENTRE, 0.1, -0.2, 0.01, 0.02
    photo_sets.colmap(Files(tmp_path, POSES), "OPENCV", numbers)
    capture = reading.read(str(tmp_path))
    camera = capture.cameras[0]
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == numbers[:4]
    assert (*camera.lens.radial[:2], *camera.lens.tangential) == numbers[4:]
    numbers, places = capture.observed["view_0.png"]
    assert list(capture.observed) == ["view_0.png"]
    np.testing.assert_allclose(capture.points[numbers], [[0.1, 0.2, 0.3]])
    np.testing.assert_allclose(places, [[1.5, 2.5]])


def test_the_chessboards_own_corners_are_where_its_cameras_say():
    """Real photographs: corners found in the pictures lie within a pixel of where they should, on
    average a quarter, without a bias, which half a pixel would be."""
    from isas_cli.config.schema import PhotosConfig
    from isas_cli.scene.photos import checks, photographs

    taken = photographs.load(PhotosConfig(path="chessboard"))
    apart = [view.apart for view in checks.views(taken)]
    assert len(apart) == 13 and max(apart) < 1 and np.median(apart) < 0.3
    biases = []
    for each in taken.all:
        view = checks.View(each, False)
        checks._reproject(view, each.camera, taken)
        pixels, _ = each.camera.project(taken.capture.points)
        biases.append((view.points[1] - pixels[view.points[0]]).mean(axis=0))
    assert np.abs(np.median(biases, axis=0)).max() < 0.1


def pose(content) -> list:
    return content["frames"][1]["transform_matrix"]


@pytest.mark.parametrize(
    "edit, told",
    [
        (lambda c: c["frames"][1].pop("transform_matrix"), "frame 1 has no transform_matrix"),
        (lambda c: c["frames"][1].update(file_path="gone.png"), "frame 1: its picture .*gone.png"),
        (lambda c: pose(c)[0].__setitem__(3, float("nan")), "frame 1.*NaN"),
        (lambda c: [row.__setitem__(0, -row[0]) for row in pose(c)[:3]], "view_1.*mirrored.*-1"),
        (lambda c: [row.__setitem__(0, 2 * row[0]) for row in pose(c)[:3]], "view_1.*no rotation"),
        (lambda c: pose(c).__setitem__(3, [0, 0, 1, 1]), "last row"),
        (
            lambda c: c.update(camera_model="EQUIRECTANGULAR"),
            "EQUIRECTANGULAR; valid: SIMPLE_PINHOLE, P",
        ),
        (lambda c: c.update(fl_x="wide"), "fl_x='wide': no number"),
        (lambda c: c.update(fl_x=-3.0), "focal length -3"),
        (lambda c: c.update(w=40.5), "w=40.5: a whole number"),
        (lambda c: (c.pop("fl_x"), c.pop("fl_y")), "none of fl_x, camera_angle_x, x_fov"),
        (lambda c: c.update(frames=[]), "no list of frames"),
        (lambda c: c["frames"][1].update(exposure=0), "frame 1: exposure=0: must be above 0"),
        (lambda c: c["frames"][1].update(exposure=[1, -1, 1]), "frame 1: exposure=.*above 0"),
        (lambda c: c["frames"][1].update(exposure=[1, 2]), "frame 1: exposure=.*no list of 3"),
        (lambda c: c["frames"][1].update(exposure=float("nan")), "frame 1: exposure=nan: must be"),
        (lambda c: c["frames"][1].update(exposure="bright"), "exposure='bright': no number"),
        (lambda c: c["frames"].append(c["frames"][0]), "view_0.exr is listed 2 times"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, edit, told):
    photo_sets.transforms(Files(tmp_path, POSES))
    photo_sets.change(tmp_path, edit)
    with pytest.raises(InputError, match=told) as error:
        reading.read(str(tmp_path))
    assert "\n" not in str(error.value)


def test_an_unknown_model_of_colmap(tmp_path):
    photo_sets.colmap(Files(tmp_path, POSES), "EQUIRECTANGULAR", SIZE)
    told = "cameras.txt:2: camera model EQUIRECTANGULAR; valid: SIMPLE_PINHOLE.*image_undistorter"
    with pytest.raises(InputError, match=told):
        reading.read(str(tmp_path))


def test_resized_pictures_of_a_file_without_sizes(tmp_path):
    """K is of the pictures as they were; half of it is not seen, and `photos.scale` says so."""
    photo_sets.neus(Files(tmp_path, POSES))
    for path in (tmp_path / "image").glob("*.png"):
        with Image.open(path) as picture:
            picture.resize((SIZE[0] // 2, SIZE[1] // 2)).save(path)
    asked = PhotosConfig(path=str(tmp_path), sphere=[0.0, 0.0, 0.0, 0.5])
    assert any("principal point more than a quarter" in w for w in photographs.load(asked).warnings)
    taken = photographs.load(dataclasses.replace(asked, scale=0.5))
    assert not any("principal point" in w for w in taken.warnings)
    camera = taken.shown[0].camera
    assert (camera.width, camera.fx) == (SIZE[0] // 2, pytest.approx(FOCAL / 2))
    assert (camera.cx, camera.cy) == pytest.approx((CENTRE[0] / 2, CENTRE[1] / 2))


def test_pictures_that_are_not_in_the_folder_given(tmp_path, monkeypatch):
    photo_sets.transforms(Files(tmp_path, POSES))
    asked = PhotosConfig(path=str(tmp_path), sphere=[0.0, 0.0, 0.0, 0.5], images="small")
    small = tmp_path / "small"
    small.mkdir()
    with pytest.raises(InputError, match="none of the pictures is there, first view_0.exr"):
        photographs.load(asked)
    (tmp_path / "view_1.exr").rename(small / "view_1.exr")
    elsewhere = tmp_path / "cwd"
    (elsewhere / "small").mkdir(parents=True)  # of another set
    monkeypatch.chdir(elsewhere)
    taken = photographs.load(asked)
    assert taken.shown[1].camera.image == small / "view_1.exr"
    assert any("2 of 3 pictures are not in" in note for note in taken.capture.notes)


def test_what_does_not_fit_into_memory_is_refused_before_it_is_read(tmp_path, monkeypatch):
    photo_sets.transforms(Files(tmp_path, POSES))
    monkeypatch.setattr(photographs.memory, "available", lambda: 40_000.0)
    asked = PhotosConfig(path=str(tmp_path), sphere=[0.0, 0.0, 0.0, 0.5])
    with pytest.raises(InputError, match=r"3 views need .*photos.width=(\d+) makes") as error:
        photographs.load(asked)
    width = int(re.search(r"width=(\d+)", str(error.value))[1])
    assert photographs.load(dataclasses.replace(asked, width=width)).shown[0].camera.width == width


def test_cameras_json_of_another_program_gives_way(tmp_path):
    photo_sets.transforms(Files(tmp_path, POSES))
    (tmp_path / "cameras.json").write_text('[{"id": 0, "img_name": "a", "rotation": []}]')
    assert reading.read(str(tmp_path)).cameras[0].described.endswith("transforms.json")
    (tmp_path / "transforms.json").unlink()
    with pytest.raises(InputError, match="cameras.json is another program's of that name"):
        reading.read(str(tmp_path))


def test_distortion_of_nerfstudio_in_one_list(tmp_path):
    numbers = {"k1": 0.1, "k2": -0.05, "p1": 0.003, "p2": 0.002}
    listed = [0.1, -0.05, 0.0, 0.0, 0.003, 0.002]
    lenses = []
    for name, more in (("one", numbers), ("other", {"distortion_params": listed})):
        (tmp_path / name).mkdir()
        photo_sets.transforms(Files(tmp_path / name, POSES), **more)
        lenses.append(reading.read(str(tmp_path / name)).cameras[0].lens)
    assert lenses[0] == lenses[1]


def test_no_cameras(tmp_path):
    with pytest.raises(InputError, match="looked for cameras.json, transforms.json"):
        reading.read(str(tmp_path))
    with pytest.raises(
        InputError, match="no such folder; sets that come with isas: chessboard, head"
    ):
        reading.read(str(tmp_path / "nowhere"))
    (tmp_path / "transforms.json").write_text("{")
    with pytest.raises(InputError, match="transforms.json: cannot be read as JSON"):
        reading.read(str(tmp_path))


def test_views_are_held_out_by_name_and_by_number(tmp_path):
    photo_sets.transforms(Files(tmp_path, POSES))
    capture = reading.read(str(tmp_path))
    cameras = capture.cameras

    def held(test) -> list[str]:
        shown, held = reading.split(capture, test)
        assert {c.name for c in shown}.isdisjoint(c.name for c in held)
        assert len(shown) + len(held) == len(cameras)
        return [c.name for c in held]

    assert held(None) == []
    assert held(2) == ["view_1.exr"]
    assert held(["view_2", "view_0.exr"]) == ["view_0.exr", "view_2.exr"]
    for test, told in (
        (["view_7"], "no view view_7; did you mean"),
        (1, "at least 2"),
        (5, "holds none out"),
        (["view_0", "view_1", "view_2"], "every view"),
    ):
        with pytest.raises(InputError, match=told):
            reading.split(capture, test)


def given(folder) -> tuple[list[str], list[str]]:
    """Names of the views to learn from and of those that the files hold out."""
    parts = reading.split(reading.read(str(folder), "given"), "given")
    return tuple([camera.name for camera in part] for part in parts)


def test_views_that_files_hold_out(tmp_path):
    lists = {"val_filenames": ["./view_2.exr"], "test_filenames": ["view_0.exr"]}
    photo_sets.transforms(Files(tmp_path, POSES), train_filenames=["view_1.exr"], **lists)
    assert given(tmp_path) == (["view_1.exr"], ["view_0.exr", "view_2.exr"])
    assert len(reading.split(reading.read(str(tmp_path)), None)[0]) == 3
    for listed, told in ((["view_7"], "view_7 is the file_path of no frame"), (7, "no list")):
        photo_sets.change(tmp_path, lambda content: content.update(test_filenames=listed))
        with pytest.raises(InputError, match=f"transforms.json: test_filenames.*{told}"):
            given(tmp_path)


def test_views_that_blender_sets_hold_out(tmp_path):
    content = photo_sets.blender(Files(tmp_path, POSES))
    for part, frames in (("train", content["frames"][:2]), ("test", content["frames"][2:])):
        photo_sets.write(tmp_path / f"transforms_{part}.json", {**content, "frames": frames})
    assert given(tmp_path) == (["view_0", "view_1"], ["view_2"])
    assert len(reading.read(str(tmp_path)).cameras) == 2


@pytest.mark.parametrize("name", FORMATS)
def test_files_that_hold_no_view_out(tmp_path, name):
    getattr(photo_sets, name)(Files(tmp_path, POSES))
    told = "photos.test=given: .*: looked for test_filenames .* transforms_test.json"
    with pytest.raises(InputError, match=told) as error:
        given(tmp_path)
    assert "\n" not in str(error.value)


def test_from_within_a_room_its_walls_are_seen(cameras):
    """From its very middle as well, which is no distance to go by."""
    camera = dataclasses.replace(cameras[0][0], to_world=np.eye(4))
    sensor = mi.load_dict(building.sensor(camera, np.full(3, 1e-4), 17.0))
    assert sensor.far_clip() > 17 > 1 > sensor.near_clip()


def test_a_pixel_is_as_wide_as_what_a_camera_sees(tmp_path):
    """Of one end of a long wall, which is as far away as that; not as its middle."""
    pose = np.eye(4)
    pose[:3, 3] = 20, 0, -3
    photo_sets.transforms(Files(tmp_path, [pose]))
    trimesh.creation.box((50, 2, 0.01)).export(tmp_path / "wall.ply")
    taken = photographs.load(PhotosConfig(path=str(tmp_path), mesh=str(tmp_path / "wall.ply")))
    (turn, shift), camera = building.pixels(taken)[0], taken.all[0].camera
    assert turn == 1 / camera.fx and shift == pytest.approx(3 / camera.fx, rel=0.01)


@pytest.mark.parametrize("times, usual", [(1.0, True), (500.0, False), (0.004, False)])
def test_a_light_begins_in_the_unit_of_the_pictures(tmp_path, times, usual):
    pictures = [np.full((*SIZE[::-1], 3), 0.3 * times, np.float32)] * len(POSES)
    photo_sets.transforms(Files(tmp_path, POSES, pictures))
    taken = photographs.load(PhotosConfig(path=str(tmp_path), sphere=[0.0, 0.0, 0.0, 0.5]))
    found = building.unknowns(taken, {}, {})["sky.data"]
    bright = 1.0 if usual else 0.6 * times
    assert found.start == pytest.approx(bright) and found.lr is None
    settings = "scene=photos", f"photos.path={tmp_path}", "photos.sphere=[0,0,0,0.5]"
    unknowns = built([*settings, "photos.texture=4"])[1].unknowns
    rate = Stepper(unknowns, OptimizerConfig(lr=0.1)).moments(0.0).rate
    assert rate["sky.data"] == pytest.approx(0.1 * bright)
    assert rate["object.bsdf.brdf_0.base_color.data"] == pytest.approx(0.1)
    taken.exposures = np.array([[1.0], [128.0]]), 0.1
    assert building._exposure(taken).range == [0.01, 256.0]


def test_a_light_begins_as_at_exposure_1(tmp_path):
    """Of pictures that are 500 times as bright, which their file says."""
    pictures = [np.full((*SIZE[::-1], 3), 0.3 * 500, np.float32)] * len(POSES)
    content = photo_sets.transforms(Files(tmp_path, POSES, pictures))
    for frame in content["frames"]:
        frame["exposure"] = 500
    photo_sets.write(tmp_path / "transforms.json", content)
    taken = photographs.load(PhotosConfig(path=str(tmp_path), sphere=[0.0, 0.0, 0.0, 0.5]))
    assert building.unknowns(taken, {}, {})["sky.data"].start == 1.0
