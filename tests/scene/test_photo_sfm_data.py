"""Cameras of AliceVision (Meshroom) and OpenMVG: files as their source writes them, of cameras that
are known, and numbers of AliceVision's own samples."""

import json

import numpy as np
import photo_sets
import pytest
from photo_sets import CENTRE, FOCAL, POSES, SIZE, Files, rigid, strings
from PIL import Image
from scipy.spatial.transform import Rotation
from test_photo_cameras import POINTS, browns
from test_photo_programs import agree, from_first, refused

from isas_cli.config.photographs import PhotosConfig
from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos import finding, photographs, reading

FORMS = {"meshroom": "cameras.sfm", "openmvg": "sfm_data.json"}


@pytest.fixture(params=FORMS)
def form(request) -> str:
    return request.param


def make(form: str, folder, **more) -> dict:
    return getattr(photo_sets, form)(Files(folder, POSES), **more)


def change(folder, form: str, edit) -> None:
    file = folder / FORMS[form]
    content = json.loads(file.read_text())
    edit(content)
    photo_sets.write(file, content)


def first(folder, **more):
    return reading.read(str(folder), **more).cameras[0]


def test_cameras_are_those_of_transforms_json(tmp_path, form):
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
    photo_sets.transforms(Files(tmp_path / "one", POSES))
    make(form, tmp_path / "other")
    found, wanted = (reading.read(str(tmp_path / each)).cameras for each in ("other", "one"))
    for one, other in zip(found, wanted, strict=True):
        for name in ("width", "height", "fx", "fy", "cx", "cy", "to_world"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-6)
        assert one.lens == other.lens


def test_files_are_found_and_told(tmp_path, form):
    make(form, tmp_path)
    capture = agree(tmp_path)
    assert capture.kind == {"meshroom": "Meshroom", "openmvg": "OpenMVG"}[form]
    assert [camera.name for camera in capture.cameras] == [f"view_{n}.png" for n in range(3)]
    assert capture.notes[0].endswith(f"{FORMS[form]}: 1 views have no pose, first lost.png")
    # JSON says by itself whose it is.
    (tmp_path / "below").mkdir()
    (tmp_path / FORMS[form]).rename(tmp_path / "below" / "mine.json")
    assert agree(tmp_path, cameras="below/mine.json").kind == capture.kind


LENSES = {
    "radial1": ("pinhole_radial_k1", "radialk1", "disto_k1", (0.1,)),
    "radial3": ("pinhole_radial_k3", "radialk3", "disto_k3", (0.1, -0.05, 0.02)),
    "brown": ("pinhole_brown_t2", "brown", "disto_t2", (0.1, -0.05, 0.02, 0.003, 0.002)),
    "fisheye4": ("fisheye", "fisheye", "fisheye", (0.1, -0.05, 0.02, -0.01)),
    "fisheye1": (None, "fisheye1", None, (0.9,)),
}


def bent(kind: str, numbers) -> np.ndarray:
    """``addDistortion`` and ``add_disto``, written out: pixels from the corner."""
    x, y = from_first()
    r = np.hypot(x, y)
    if kind == "fisheye4":
        t = np.arctan(r)
        by = (t + sum(k * t ** (2 * n + 3) for n, k in enumerate(numbers))) / r
        x, y = x * by, y * by
    elif kind == "fisheye1":
        by = np.arctan(2 * r * np.tan(numbers[0] / 2)) / numbers[0] / r
        x, y = x * by, y * by
    else:
        k1, k2, k3, t1, t2 = (*numbers, *(0.0,) * (5 - len(numbers)))
        x, y = browns(x, y, (k1, k2, k3, 0.0), t1, t2)
    return np.stack([x * FOCAL + CENTRE[0], y * FOCAL + CENTRE[1]], 1)


@pytest.mark.parametrize("kind", LENSES)
def test_lenses(tmp_path, kind):
    of_openmvg, later, under, numbers = LENSES[kind]
    wanted = bent(kind, numbers)
    make("meshroom", tmp_path, type=kind, distortionParams=numbers)
    np.testing.assert_allclose(first(tmp_path).project(POINTS)[0], wanted, atol=1e-9)
    kinds = {"distortionType": later, "undistortionType": "none"}
    make("meshroom", tmp_path, version=(1, 2, 8), distortionParams=numbers, **kinds)
    np.testing.assert_allclose(first(tmp_path).project(POINTS)[0], wanted, atol=1e-9)
    (tmp_path / "cameras.sfm").unlink()
    if of_openmvg is not None:
        make("openmvg", tmp_path, kind=of_openmvg, **{under: numbers})
        np.testing.assert_allclose(first(tmp_path).project(POINTS)[0], wanted, atol=1e-9)


# AliceVision's src/aliceVision/sfmDataIO/compatibilityData: one camera, by each version.
PIXELS = {"pxFocalLength": [1000, 2000]}
SAMPLES = {
    (1, 2, 0): {**PIXELS, "principalPoint": [2020, 1040]},
    (1, 2, 1): PIXELS,
    (1, 2, 2): {"focalLength": 8.7976539589442808, "pixelRatio": 0.5},
    (1, 2, 4): {"focalLength": 8.7976539589442808, "pixelRatio": 0.5},
    (1, 2, 5): {"focalLength": 8.7976539589442808, "pixelRatio": 2},
    (1, 2, 8): {"focalLength": 8.7976539589442808, "pixelRatio": 2},
    (1, 2, 11): {"focalLength": 17.595307917888562, "pixelRatio": 2},
    (1, 2, 14): {"focalLength": 17.595307917888562, "pixelRatio": 2},
}


@pytest.mark.parametrize("version", SAMPLES, ids=lambda version: ".".join(map(str, version)))
def test_versions_of_alicevision(tmp_path, version):
    told = {"principalPoint": [-26, 16], "width": 4092, "height": 2048, **SAMPLES[version]}
    make("meshroom", tmp_path, version=version, **told)
    camera = first(tmp_path)
    assert (camera.fx, camera.fy) == pytest.approx((1000, 2000), rel=1e-12)
    # Of the corner, not of the first pixel's middle.
    assert (camera.cx, camera.cy) == (2020.5, 1040.5)
    np.testing.assert_allclose(camera.to_world, POSES[0], atol=1e-12)


def test_the_first_version_of_alicevision(tmp_path):
    """One focal length, the principal point from the first pixel on."""
    told = {"pxFocalLength": FOCAL, "principalPoint": [c - 0.5 for c in CENTRE]}
    make("meshroom", tmp_path, version=(1, 0, 0), **told)
    agree(tmp_path)


def test_millimetres_of_a_picture_on_edge(tmp_path):
    """The sensor is as wide as the picture, and from 1.2.11 on as its longer side."""
    for version, side in (((1, 2, 6), 30), ((1, 2, 11), 40)):
        focal = FOCAL * 36 / side
        make("meshroom", tmp_path, version=version, width=30, height=40, focalLength=focal)
        assert first(tmp_path).fx == first(tmp_path).fy == pytest.approx(FOCAL)


def test_rotations_of_alicevision_go_column_after_column(tmp_path):
    """Numbers of scene_v1.2.8.json, whose generator turns its pose 0 by (-1, -1, -1), from world to
    camera, and says that it stands there."""
    a, b, c = 0.22629564095020641, -0.18300791965761709, 0.95671227870741093
    make("meshroom", tmp_path)

    def edit(content):
        transform = content["poses"][0]["pose"]["transform"]
        transform.update(strings({"rotation": [a, b, c, c, a, b, b, c, a], "center": [-1] * 3}))

    change(tmp_path, "meshroom", edit)
    found = first(tmp_path, world="file").to_world
    turn = Rotation.from_rotvec([-1, -1, -1]).as_matrix()
    np.testing.assert_allclose(found[:3, :3], turn.T, atol=1e-12)
    np.testing.assert_allclose(found[:3, 3], -1)


def test_meshrooms_meshes_are_turned(tmp_path):
    """y and z are negated in a mesh and not in JSON, since 1.2.3."""
    make("meshroom", tmp_path)
    mesh, file = (first(tmp_path, world=world).project for world in ("mesh", "file"))
    np.testing.assert_allclose(mesh(POINTS)[0], file(POINTS * [1, -1, -1])[0], atol=1e-9)
    capture = agree(tmp_path)
    assert "half a turn about x" in capture.notes[-1] and "photos.world=file" in capture.notes[-1]
    make("meshroom", tmp_path, version=(1, 2, 2))
    assert len(agree(tmp_path).notes) == 1
    with pytest.raises(InputError, match="photos.world=file: .*tells of no other world"):
        reading.read(str(tmp_path), world="file")


def test_rigs_of_alicevision(tmp_path):
    """A view's pose is its sub-pose times its rig's, both from the world's side to the camera's."""
    make("meshroom", tmp_path)
    subs = [np.eye(4) for _ in range(3)]
    for n, sub in enumerate(subs):
        sub[:3, :3] = Rotation.from_rotvec([0.3, -0.2 * n, 0.5]).as_matrix()
        sub[:3, 3] = 0.1, 0.2 * n, -0.3
    turn = np.diag([1.0, -1.0, -1.0, 1.0])

    def edit(content):
        for n in (0, 1):
            content["views"][n].update(rigId="7", subPoseId=str(n), isPoseIndependant="false")
            to_rig = np.linalg.inv(subs[n]) @ np.linalg.inv(turn @ POSES[n])
            transform = strings(rigid(np.linalg.inv(to_rig)))
            content["poses"][n]["pose"]["transform"] = transform
        content["views"][2].update(rigId="7", subPoseId="2")  # for the time being by itself
        told = [{"status": "estimated", "pose": rigid(np.linalg.inv(sub))} for sub in subs]
        content["rigs"] = strings([{"rigId": 7, "subPoses": told}])

    change(tmp_path, "meshroom", edit)
    assert "1 views have no pose" in agree(tmp_path).notes[0]
    change(
        tmp_path, "meshroom", lambda c: c["rigs"][0]["subPoses"][0].update(status="uninitialized")
    )
    capture = reading.read(str(tmp_path))
    assert len(capture.cameras) == 2 and "2 views have no pose, first view_0" in capture.notes[0]


def test_pictures_are_where_the_file_has_them_or_below_the_set(tmp_path, form):
    make(form, tmp_path)
    far = tmp_path / "far"
    for number in range(3):
        (far / f"cam{number}").mkdir(parents=True)
        (tmp_path / f"view_{number}.png").rename(far / f"cam{number}" / "a.png")

    def moved(content, above):
        for n, view in enumerate(content["views"][:3]):
            if form == "meshroom":
                view["path"] = f"{above}\\cam{n}\\a.png"
            else:
                view["value"]["ptr_wrapper"]["data"].update(
                    local_path=f"cam{n}\\", filename="a.png"
                )
        if form == "openmvg":
            content["root_path"] = above
        del content["views"][3:]

    change(tmp_path, form, lambda content: moved(content, str(far)))
    names = [f"cam{n}/a.png" for n in range(3)]
    assert [camera.name for camera in agree(tmp_path).cameras] == names
    change(tmp_path, form, lambda content: moved(content, "D:\\pictures"))
    refused(tmp_path, "view cam0/a.png: its picture .*cam0/a.png does not exist")
    far.rename(tmp_path / "images")
    assert [camera.name for camera in agree(tmp_path).cameras] == names


def test_pictures_that_are_missing(tmp_path, form):
    make(form, tmp_path)
    (tmp_path / "view_1.png").unlink()
    refused(tmp_path, f"{FORMS[form]}: view view_1.png: its picture .*photos.missing=skip")
    with finding.looking(PhotosConfig(missing="skip"), tmp_path) as sources:
        capture = reading.read(str(tmp_path))
    assert [camera.name for camera in capture.cameras] == ["view_0.png", "view_2.png"]
    assert sources.missing == ["view_1.png"]


def test_pictures_that_were_resized(tmp_path, form):
    make(form, tmp_path)
    half = SIZE[0] // 2, SIZE[1] // 2
    for path in tmp_path.glob("*.png"):
        with Image.open(path) as picture:
            picture.resize(half).save(path)
    asked = dict(path=str(tmp_path), sphere=[0.0, 0.0, 0.0, 0.5])
    with pytest.raises(InputError, match="photos.scale=auto"):
        photographs.load(PhotosConfig(**asked))
    camera = photographs.load(PhotosConfig(**asked, scale="auto")).shown[0].camera
    assert (camera.width, camera.fx) == (half[0], pytest.approx(FOCAL / 2))


@pytest.mark.parametrize(
    "more, told",
    [
        (dict(type="equidistant", distortionType="none"), "intrinsic 5: lens equidistant; valid: "),
        (dict(type="3deanamorphic4"), "3deanamorphic4; valid: pinhole.*CameraInit.*exportColmap"),
        (dict(undistortionType="radialk3"), "lens undistortion radialk3; valid: pinhole, radial1"),
        (dict(type="radial3", distortionParams=[0.1]), "distortionParams=.*no list of 3 numbers"),
        (dict(sensorWidth=0), "intrinsic 5: sensorWidth 0: must be above 0"),
        (dict(pxFocalLength="wide"), "pxFocalLength='wide': no number"),
        (dict(principalPoint=[1]), "principalPoint=.*no list of 2 numbers"),
        (dict(intrinsicId=6), "view view_0.png: its intrinsic 5 is not in the file"),
        (dict(version=(1, 3, 0)), "cameras.sfm: version 1.3.0: none beyond 1.2 .*exportColmap"),
    ],
)
def test_what_of_meshroom_is_refused(tmp_path, more, told):
    make("meshroom", tmp_path, **more)
    refused(tmp_path, told)


@pytest.mark.parametrize(
    "edit, told",
    [
        (lambda c: c.update(poses=""), "no view has a pose: take what StructureFromMotion wrote"),
        (lambda c: c.update(views={}), "no view has a pose"),
        (lambda c: c.update(views=[1]), "cameras.sfm: views is no list of JSON objects"),
        (lambda c: c.pop("version"), "cameras.sfm: version=None: no list of 3 numbers"),
        (lambda c: c["poses"][0].pop("pose"), "view view_0.png: its pose: has no pose"),
        (
            lambda c: c["poses"][0]["pose"]["transform"].update(rotation=["1", "0"]),
            "view view_0.png: rotation=.*no list of 9 numbers",
        ),
        (
            lambda c: c["poses"][0]["pose"]["transform"].update(center=["nan", "0", "0"]),
            "view view_0.png: center=nan: must be a finite number",
        ),
    ],
)
def test_what_is_wrong_with_a_file_of_meshroom(tmp_path, edit, told):
    make("meshroom", tmp_path)
    change(tmp_path, "meshroom", edit)
    refused(tmp_path, told)


@pytest.mark.parametrize(
    "edit, told",
    [
        (lambda c: c.update(extrinsics=[]), "no view has a pose: take what was written after"),
        (lambda c: c["views"][0]["value"].pop("ptr_wrapper"), "view 0: has no ptr_wrapper"),
        (
            lambda c: c["intrinsics"][0]["value"].pop("polymorphic_name"),
            "intrinsic 0: camera None; valid: pinhole, ",
        ),
        (lambda c: c["intrinsics"].pop(1), "view view_1.png: its intrinsic 1 is not in the file"),
        (
            lambda c: c["intrinsics"][0]["value"].update(polymorphic_name="spherical"),
            "intrinsic 0: camera spherical; valid: .*Spherical2Cubic.*openMVG2Colmap",
        ),
        (
            lambda c: c["intrinsics"][0]["value"].update(polymorphic_name="fisheye"),
            "intrinsic 0: fisheye=.*no list of 4 numbers",
        ),
        (lambda c: c["extrinsics"][0]["value"].update(rotation=7), "rotation: no 3 rows"),
        (
            lambda c: c["extrinsics"][0]["value"]["rotation"].__setitem__(1, [0, 1]),
            "view view_0.png: rotation=.*no list of 3 numbers",
        ),
    ],
)
def test_what_of_openmvg_is_refused(tmp_path, edit, told):
    make("openmvg", tmp_path)
    change(tmp_path, "openmvg", edit)
    refused(tmp_path, told)


@pytest.mark.parametrize("name", ["sfm.abc", "sfm_data.bin"])
def test_binary_files_are_refused_with_the_way_out(tmp_path, name):
    photo_sets.transforms(Files(tmp_path, POSES))
    (tmp_path / name).write_bytes(b"\0\xff")
    with pytest.raises(InputError, match="convertSfMFormat.*ConvertSfM_DataFormat.*exportColmap"):
        reading.read(str(tmp_path), cameras=name)
