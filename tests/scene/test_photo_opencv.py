"""OpenCV's habits: distortion of every shape, rvec and tvec, and its own storage."""

import json

import numpy as np
import photo_sets
import pytest
from photo_sets import CENTRE, FOCAL, POSES, SIZE, Files
from scipy.spatial.transform import Rotation
from test_photo_cameras import POINTS, expected
from test_photo_lenses import DISTORTION

from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos import reading
from isas_cli.scene.photos.lens import of_opencv

INNER = [[FOCAL, 0, CENTRE[0] - 0.5], [0, FOCAL, CENTRE[1] - 0.5], [0, 0, 1]]
INVERSE = [np.linalg.inv(pose) for pose in POSES]
TURNS = [Rotation.from_matrix(matrix[:3, :3]).as_rotvec().tolist() for matrix in INVERSE]
SHIFTS = [matrix[:3, 3].tolist() for matrix in INVERSE]
NAMES = [f"view_{number}.png" for number in range(3)]

# As cv2.FileStorage writes these (OpenCV 5.0.0); OpenCV 4 begins YAML by %YAML:1.0.
YAML = """%YAML{version}
---
image_width: 40
image_height: 30
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 55., 0., 23., 0., 55., 10.75, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 0.10000000000000001, -0.20000000000000001, 0.001, 0.002,
       2.9999999999999999e-02 ]
"""
XML = """<?xml version="1.0"?>
<opencv_storage>
<image_width>40</image_width>
<image_height>30</image_height>
<camera_matrix type_id="opencv-matrix">
  <rows>3</rows>
  <cols>3</cols>
  <dt>d</dt>
  <data>
    55. 0. 23. 0. 55. 10.75 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix">
  <rows>5</rows>
  <cols>1</cols>
  <dt>d</dt>
  <data>
    0.10000000000000001 -0.20000000000000001 0.001 0.002
    2.9999999999999999e-02</data></distortion_coefficients>
"""
LENS = of_opencv((0.1, -0.2, 0.001, 0.002, 0.03))


def numbers(values) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(values))


def yaml_matrix(name: str, values, rows: int, cols: int, indent: str = "") -> str:
    data = numbers(values).replace(" ", ", ")
    body = f"rows: {rows}\ncols: {cols}\ndt: d\ndata: [ {data} ]"
    return f"{indent}{name}: !!opencv-matrix\n" + "".join(
        f"{indent}   {line}\n" for line in body.splitlines()
    )


def xml_matrix(name: str, values, rows: int, cols: int) -> str:
    return (
        f'<{name} type_id="opencv-matrix"><rows>{rows}</rows><cols>{cols}</cols><dt>d</dt>'
        f"<data>{numbers(values)}</data></{name}>\n"
    )


def views_yaml() -> str:
    each = [
        f'   -\n      image: "{name}"\n'
        + yaml_matrix("rvec", turn, 3, 1, "      ")
        + yaml_matrix("tvec", shift, 3, 1, "      ")
        for name, turn, shift in zip(NAMES, TURNS, SHIFTS)
    ]
    return "views:\n" + "".join(each)


def views_xml() -> str:
    each = [
        f"<_><image>{name}</image>"
        + xml_matrix("rvec", turn, 3, 1)
        + xml_matrix("tvec", shift, 3, 1)
        + "</_>"
        for name, turn, shift in zip(NAMES, TURNS, SHIFTS)
    ]
    return "<views>\n" + "\n".join(each) + "</views>\n"


# Rows of rvec and tvec, as OpenCV's calibration sample writes them, and the names it lacks.
TABLE = np.hstack([TURNS, SHIFTS])
LISTED = {
    "yaml": yaml_matrix("extrinsic_parameters", TABLE, 3, 6)
    + 'images:\n   - "view_0.png"\n   - "view_1.png"\n   - view_2.png\n',
    "xml": xml_matrix("extrinsic_parameters", TABLE, 3, 6)
    + '<images>\n  view_0.png "view_1.png" view_2.png</images>\n',
}
FILES = {
    "views-4.yml": YAML.format(version=":1.0") + views_yaml(),
    "views-5.yaml": YAML.format(version=" 1.2") + views_yaml(),
    "views.xml": XML + views_xml() + "</opencv_storage>\n",
    "listed.yml": YAML.format(version=":1.0") + LISTED["yaml"],
    "listed.xml": XML + LISTED["xml"] + "</opencv_storage>\n",
}


@pytest.mark.parametrize("name", FILES)
def test_storage(tmp_path, name):
    Files(tmp_path, POSES).names(".png")
    (tmp_path / name).write_text(FILES[name])
    capture = reading.read(str(tmp_path))
    assert [camera.name for camera in capture.cameras] == NAMES
    for camera, pose in zip(capture.cameras, POSES):
        np.testing.assert_allclose(camera.to_world, pose, atol=1e-9)
        assert camera.lens == LENS and (camera.cx, camera.cy) == CENTRE
        assert (camera.width, camera.height) == SIZE
    assert reading.read(str(tmp_path), cameras=name).kind == name


def test_json_storage(tmp_path):
    """cv2.FileStorage writes JSON, too: matrices with a type_id."""
    content = photo_sets.ours(Files(tmp_path, POSES))
    flat = {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d"}
    content["camera_matrix"] = {**flat, "data": np.ravel(INNER).tolist()}
    wanted = {**flat, "rows": 1, "cols": 5, "data": [0.1, -0.2, 0.001, 0.002, 0.03]}
    content["distortion_coefficients"] = wanted
    photo_sets.write(tmp_path / "cameras.json", content)
    (camera, *_) = reading.read(str(tmp_path)).cameras
    assert camera.lens == LENS and (camera.cx, camera.cy) == CENTRE


def test_ros(tmp_path):
    """camera_info's own way: a fisheye, matrices without a tag."""
    Files(tmp_path, POSES).names(".png")
    told = (
        "image_width: 40\nimage_height: 30\ncamera_name: head\ndistortion_model: equidistant\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{numbers(INNER).replace(' ', ', ')}]\n"
        "distortion_coefficients:\n  rows: 1\n  cols: 4\n  data: [0.05, -0.02, 0.01, -0.003]\n"
    )
    (tmp_path / "head.yaml").write_text(told + views_yaml())
    (camera, *_) = reading.read(str(tmp_path)).cameras
    assert camera.lens == of_opencv((0.05, -0.02, 0.01, -0.003), fisheye=True)
    (tmp_path / "head.yaml").write_text(told.replace("equidistant", "omni") + views_yaml())
    with pytest.raises(InputError, match="distortion_model omni; valid: plumb_bob"):
        reading.read(str(tmp_path))


@pytest.mark.parametrize(
    "count, shape", [*((n, (-1,)) for n in (4, 5, 8, 12, 14)), (5, (-1, 1)), (5, (1, -1))]
)
def test_distortion_of_every_shape(tmp_path, count, shape):
    told = np.array(DISTORTION[:count])
    photo_sets.ours(Files(tmp_path, POSES), distortion=told.reshape(shape).tolist())
    (camera, *_) = reading.read(str(tmp_path)).cameras
    assert camera.lens == of_opencv(DISTORTION[:count])


NAMES_OF_IT = "dist dist_coeff dist_coeffs dist_coefs distCoeffs distortion_coeffs"


@pytest.mark.parametrize("name", NAMES_OF_IT.split())
def test_distortion_by_other_names(tmp_path, name):
    photo_sets.ours(Files(tmp_path, POSES), **{name: list(DISTORTION[:5])})
    (camera, *_) = reading.read(str(tmp_path)).cameras
    assert camera.lens == of_opencv(DISTORTION[:5])


@pytest.mark.parametrize("other", [None, [], [0.0] * 5])
def test_another_name_of_it_does_not_stand_before_its_own(tmp_path, other):
    given = {"distortion": list(DISTORTION[:5]), "dist": other, "dist_coeffs": other}
    photo_sets.ours(Files(tmp_path, POSES), **given)
    (camera, *_) = reading.read(str(tmp_path)).cameras
    assert camera.lens == of_opencv(DISTORTION[:5])


def test_none_is_told_from_names_that_are_not_known(tmp_path):
    words = {"distorted": False, "distortion_type": "none", "dist_unit": "m", "distribution": 1}
    photo_sets.ours(Files(tmp_path, POSES), distance=2.0, distortion=None, **words)
    (camera, *_) = reading.read(str(tmp_path)).cameras
    assert camera.lens.straight


@pytest.mark.parametrize("shape", [(3,), (3, 1), (1, 3)], ids=["flat", "column", "row"])
@pytest.mark.parametrize("paired", [False, True])
def test_rvec_and_tvec(tmp_path, shape, paired):
    content = photo_sets.ours(Files(tmp_path, POSES))
    turns = [np.reshape(turn, shape).tolist() for turn in TURNS]
    shifts = [np.reshape(shift, shape).tolist() for shift in SHIFTS]
    if paired:
        del content["views"]
        content.update(images=NAMES, rvecs=turns, tvecs=shifts)
    else:
        for view, turn, shift in zip(content["views"], turns, shifts):
            del view["world_to_camera"]
            view.update(rvec=turn, tvec=shift)
    photo_sets.write(tmp_path / "cameras.json", content)
    for camera, pose in zip(reading.read(str(tmp_path)).cameras, POSES):
        np.testing.assert_allclose(camera.project(POINTS)[0], expected(pose), atol=1e-6)


def test_a_matrix_under_the_name_of_rvec(tmp_path):
    """What cv2.Rodrigues makes of it."""
    content = photo_sets.ours(Files(tmp_path, POSES))
    for view, matrix in zip(content["views"], INVERSE):
        del view["world_to_camera"]
        view.update(rvec=matrix[:3, :3].tolist(), tvec=matrix[:3, 3:].tolist())
    photo_sets.write(tmp_path / "cameras.json", content)
    for camera, pose in zip(reading.read(str(tmp_path)).cameras, POSES):
        np.testing.assert_allclose(camera.to_world, pose, atol=1e-9)


@pytest.mark.parametrize(
    "edit, told",
    [
        (dict(distortion=[0.1] * 6), "view 0: distortion: 6 numbers; OpenCV has 4, 5, 8, 12, 14"),
        (dict(distortion=[0.1] * 5, fisheye=True), "distortion: 5 numbers; OpenCV has 4: k1 … k4"),
        (dict(fisheye="yes", distortion=[0.1] * 4), "view 0: fisheye='yes': no number"),
        (dict(distortion=["a"] * 5), "view 0: distortion: no list of numbers"),
        (dict(distortion=[[0.1, 0.2], [0.1]]), "distortion: no list of numbers, or rows of unlike"),
        (dict(distortion={"k1": 0.1}), "view 0: distortion: no list of numbers"),
        (dict(distortion=[float("nan")] * 5), "view 0: distortion: holds NaN"),
        (dict(DistParams=[0.1] * 5), "view 0: DistParams is not read: call it distortion"),
        (dict(camera_matrix=[1, 2, 3]), "camera_matrix is no 3×3 matrix"),
        (dict(camera_matrix=[[1, 1, 3], [0, 1, 2], [0, 0, 1]]), "camera_matrix has skew"),
        (dict(camera_matrix=None), "view 0 has no camera_matrix"),
        (dict(views=None), "has no list of views"),
        (
            dict(views=None, images=["a"], rvecs=[[0, 0, 0]] * 2, tvecs=[[0, 0, 0]] * 2),
            "names of 1",
        ),
        (dict(views=None, extrinsic_parameters=[[0, 0, 0]]), "rows of rvec and tvec, 6 numbers"),
        (dict(views=[{"image": "view_0.png"}]), "view 0 has no world_to_camera, nor rvec and tvec"),
        (dict(views=[{"image": "view_0.png", "rvec": [0], "tvec": [0]}]), "of 3 numbers each"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, edit, told):
    content = photo_sets.ours(Files(tmp_path, POSES))
    content = {key: value for key, value in {**content, **edit}.items() if value is not None}
    (tmp_path / "cameras.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=told) as error:
        reading.read(str(tmp_path))
    assert "\n" not in str(error.value)


def test_storage_that_is_wrong(tmp_path):
    """The names of pictures, which OpenCV's sample does not write; two files; none that is one."""
    Files(tmp_path, POSES).names(".png")
    nameless = FILES["listed.yml"].partition("images:")[0]
    (tmp_path / "a.yml").write_text(nameless)
    told = "a.yml: has poses of 3 views and names of 0 pictures: add images:"
    with pytest.raises(InputError, match=told):
        reading.read(str(tmp_path))
    (tmp_path / "a.yml").write_text(FILES["listed.yml"])
    (tmp_path / "b.xml").write_text(FILES["views.xml"])
    with pytest.raises(
        InputError, match="a.yml and b.xml are all files with a camera_matrix: photos.camera"
    ):
        reading.read(str(tmp_path))
    (tmp_path / "calib").mkdir()
    for name in ("a.yml", "b.xml"):
        (tmp_path / "calib" / name).write_text((tmp_path / name).read_text())
    with pytest.raises(InputError, match="photos.cameras=calib/a.yml takes one"):
        reading.read(str(tmp_path), None, "calib")
    for name, text in (
        ("a.yml", "camera_matrix: [1, 2"),
        ("a.yml", "camera_matrix: !!python/object/apply:os.getcwd []"),
        ("b.xml", "<opencv_storage><camera_matrix>"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(
            InputError, match=f"{name}: cannot be read as OpenCV's storage"
        ) as error:
            reading.read(str(tmp_path), cameras=name)
        assert "\n" not in str(error.value)
    (tmp_path / "a.yml").write_text("a: 1")
    with pytest.raises(InputError, match="a.yml: holds no camera_matrix"):
        reading.read(str(tmp_path), cameras="a.yml")


def test_a_calibration_beside_other_cameras_is_not_theirs(tmp_path):
    """Of the camera alone, or with the chessboard's poses, which name no picture; alone it says
    what is missing."""
    (tmp_path / "left.yml").write_text(YAML.format(version=":1.0"))
    with pytest.raises(InputError, match="left.yml: has no list of views"):
        reading.read(str(tmp_path))
    (tmp_path / "right.xml").write_text(XML + "</opencv_storage>\n")
    nameless = FILES["listed.yml"].partition("images:")[0]
    (tmp_path / "board.yaml").write_text(nameless)
    photo_sets.neus(Files(tmp_path, POSES))
    assert reading.read(str(tmp_path)).kind == "NeuS"
    Files(tmp_path, POSES).names(".png")
    (tmp_path / "views.yml").write_text(FILES["views-4.yml"])
    assert reading.read(str(tmp_path)).kind == "views.yml"
