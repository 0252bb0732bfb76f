"""Lenses: where OpenCV's own functions see points through them. COLMAP's:
test_photo_transforms.py."""

import numpy as np
import pytest
from photo_sets import CENTRE, FOCAL
from test_photo_cameras import lens
from test_photo_import import blobs, centre_of

from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos import importing, models
from isas_cli.scene.photos.camera import Camera
from isas_cli.scene.photos.lens import Lens, of_opencv

F, FXY = (FOCAL, *CENTRE), (FOCAL, FOCAL + 4, *CENTRE)
# Of every model of COLMAP that is read, numbers none of which is 0.
MODELS = {
    "SIMPLE_PINHOLE": F,
    "PINHOLE": FXY,
    "SIMPLE_RADIAL": (*F, 0.11),
    "RADIAL": (*F, 0.11, -0.06),
    "OPENCV": (*FXY, 0.11, -0.06, 0.003, -0.002),
    "FULL_OPENCV": (*FXY, 0.11, -0.06, 0.003, -0.002, 0.02, 0.05, -0.01, 0.004),
    "OPENCV_FISHEYE": (*FXY, 0.05, -0.02, 0.01, -0.003),
    "SIMPLE_RADIAL_FISHEYE": (*F, 0.05),
    "RADIAL_FISHEYE": (*F, 0.05, -0.02),
    "SIMPLE_FISHEYE": F,
    "FISHEYE": FXY,
    "THIN_PRISM_FISHEYE": (*FXY, 0.05, -0.02, 0.003, -0.002, 0.01, -0.003, 0.002, -0.001),
    "RAD_TAN_THIN_PRISM_FISHEYE": (
        *(*FXY, 0.05, -0.02, 0.01, -0.003, 0.002, -0.001),
        *(0.003, -0.002, 0.002, -0.001, 0.003, 0.0015),
    ),
    "FOV": (*FXY, 0.9),
    "SIMPLE_DIVISION": (*F, -0.12),
    "DIVISION": (*FXY, 0.07),
    "EUCM": (*FXY, 0.55, 1.1),
}
POINTS = np.array([[0, 0, 1], [0.3, -0.2, 1.1], [-0.5, 0.4, 1.3], [0.6, 0.5, 0.9], [1.5, -0.7, 1]])

# cv2.projectPoints and cv2.fisheye.projectPoints, OpenCV 5.0.0, of the first four POINTS with
# rvec (0.1, -0.2, 0.3), tvec (0.02, -0.01, 0.2), fx 55, fy 60, cx 23, cy 10.75.
DISTORTION = (0.11, -0.06, 0.003, -0.002, 0.02, 0.05, -0.01, 0.004)
DISTORTION += (0.002, -0.001, 0.003, 0.0015, 0.02, -0.03)
OPENCV = {
    4: "15.458589469 3.721322909 29.789276756 -0.867959434 -9.88349064 13.624312377 "
    "35.13689801 36.609576049",
    5: "15.458584399 3.721318178 29.789296236 -0.867992767 -9.907710293 13.626387125 "
    "35.139553719 36.615214227",
    8: "15.470667649 3.732594534 29.771691379 -0.837868067 -9.396383634 13.582584922 "
    "35.010715176 36.341684751",
    12: "15.474164631 3.738504808 29.777304722 -0.828188294 -9.365601863 13.653327844 "
    "35.032557394 36.386422294",
    14: "15.518988347 3.777111138 29.77926182 -0.824198844 -8.848465218 13.585378335 "
    "35.222697038 36.793020733",
}
FISHEYE = "15.554989699 3.802152373 29.670183028 -0.663740049 -6.178947122 13.249580562 "
FISHEYE += "34.202714398 34.533818998"


def test_every_model_of_colmap_is_read_but_the_sphere():
    pycolmap = pytest.importorskip("pycolmap")
    told = set(pycolmap.CameraModelId.__members__) - {"INVALID"}
    assert told <= {*models.PARAMETERS, "EQUIRECTANGULAR"} and set(MODELS) == set(models.PARAMETERS)


@pytest.mark.parametrize("count", [*OPENCV, "fisheye"])
def test_points_are_where_opencv_sees_them(count):
    from scipy.spatial.transform import Rotation

    numbers = DISTORTION[: count if count != "fisheye" else 0] or (0.05, -0.02, 0.01, -0.003)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix()
    pose[:3, 3] = 0.02, -0.01, 0.2
    camera = Camera(
        **dict(name="a", image=None, width=40, height=30, fx=55.0, fy=60.0, cx=23.0, cy=10.75),
        to_world=np.linalg.inv(pose),
        lens=of_opencv(numbers, count == "fisheye"),
    )
    wanted = np.array((OPENCV | {"fisheye": FISHEYE})[count].split(), float).reshape(4, 2)
    np.testing.assert_allclose(camera.project(POINTS[:4])[0], wanted, atol=1e-8)


@pytest.mark.parametrize("model", MODELS)
def test_up_to_its_reach_a_lens_keeps_the_order_of_points(model):
    found = models.lens(model, dict(zip(models.PARAMETERS[model].split(), MODELS[model])))
    plain = Lens(found.radial, below=found.below, kind=found.kind, own=found.own)
    assert plain.reach == found.reach > 0.9
    r = np.linspace(0, min(plain.reach, 50) * (1 - 1e-6), 20_001)
    seen = plain.distort(np.stack([r, 0 * r], axis=-1))[:, 0]
    assert (np.diff(seen) > 0).all()
    # Just beyond, it does not.
    if np.isfinite(plain.reach) and found.kind != "division":
        ends = plain.reach * np.array([[1.001, 0], [1.05, 0]])
        first, second = plain.distort(ends)[:, 0]
        assert not 0 < second - first


def test_a_pole_ends_the_reach():
    """1 / (1 - r²) is endless at r = 1, and negative beyond."""
    assert Lens(below=(-1.0, 0.0, 0.0)).reach == pytest.approx(1)
    # r / (1 + r² / 2) is greatest at √2.
    assert Lens(below=(0.5, 0.0, 0.0)).reach == pytest.approx(np.sqrt(2))
    assert Lens(radial=(-0.3, 0, 0, 0), kind="fisheye").reach == pytest.approx(np.tan(0.9**-0.5))


@pytest.mark.parametrize(
    "found",
    [
        Lens((0.04, -0.01, 0.002, 0.0), kind="fisheye"),
        Lens((-0.2, 0.05, 0.0, 0.0), (0.003, -0.002), below=(0.1, 0.02, 0.0)),
        Lens(kind="fov", own=(0.9,)),
        Lens(kind="division", own=(-0.3,)),
        Lens(kind="unified", own=(0.6, 1.2)),
    ],
    ids=lambda found: found.kind,
)
def test_import_takes_every_kind_out(found):
    """Spots are found where a pinhole sees them, up to a tenth of a pixel; with the lens, they lie
    pixels off."""
    size = dict(width=160, height=120, fx=110.0, fy=118.0, cx=85.0, cy=57.0)
    camera = Camera(name="a.png", image=None, to_world=np.eye(4), lens=found, **size)
    points = np.array([[0.0, 0.0, 1], [-0.5, -0.3, 1], [0.45, 0.3, 1], [-0.4, 0.35, 1]])
    target = camera.pinhole()
    assert target.ideal and not camera.ideal
    picture = blobs(camera, points)
    made, mask = importing.resample(camera, target, picture, np.ones(picture.shape[:2], np.float32))
    wanted, _ = target.project(points)
    assert np.linalg.norm(camera.project(points)[0] - wanted, axis=1).max() > 2
    for place in wanted:
        assert np.linalg.norm(centre_of(made[..., 0], place) - place) < 0.1
        assert mask[int(place[1]), int(place[0])] == 1


def test_pictures_are_as_colmap_undistorts_them():
    """Pixel for pixel: a fisheye's picture, looked up where pycolmap says."""
    pycolmap = pytest.importorskip("pycolmap")
    size, numbers = (160, 120), (90.0, 90.0, 82.0, 57.0, 0.04, -0.02, 0.01, -0.003)
    lensed = pycolmap.Camera(
        model="OPENCV_FISHEYE", width=size[0], height=size[1], params=numbers, camera_id=1
    )
    plane = dict(zip(("width", "height"), size), fx=90.0, fy=90.0, cx=82.0, cy=57.0)
    values = dict(zip(models.PARAMETERS["OPENCV_FISHEYE"].split(), numbers))
    mine = models.lens("OPENCV_FISHEYE", values)
    camera = Camera(name="a", image=None, to_world=np.eye(4), lens=mine, **plane)
    target = camera.pinhole()
    rows, columns = np.indices(size[::-1]) + 0.5
    smooth = 0.5 + 0.4 * np.sin(columns / 7) * np.cos(rows / 9)
    picture = np.repeat(smooth[..., None], 3, axis=2).astype(np.float32)
    made, mask = importing.resample(camera, target, picture, np.ones(size[::-1], np.float32))
    # Where COLMAP looks up each pixel.
    rays = np.stack([(columns - 82) / 90, (rows - 57) / 90, np.ones_like(rows)], axis=-1)
    at = np.array([lensed.img_from_cam(ray) for ray in rays.reshape(-1, 3)]).reshape(*rows.shape, 2)
    wanted = 0.5 + 0.4 * np.sin(at[..., 0] / 7) * np.cos(at[..., 1] / 9)
    counts = mask > 0
    assert counts.mean() > 0.95
    # Half a pixel off, it would be 0.02 to 0.03.
    assert np.abs(made[..., 0] - wanted)[counts].max() < 0.004


@pytest.mark.parametrize(
    "found, told",
    [
        (Lens((np.nan, 0, 0, 0)), "its lens holds NaN"),
        (Lens(kind="fov", own=(4.0,)), "omega 4 of its lens: between 0 and π"),
        (Lens(kind="unified", own=(1.5, 1.0)), "alpha 1.5, beta 1 of its lens"),
    ],
)
def test_impossible_lenses(found, told):
    with pytest.raises(InputError, match=told):
        Camera(**{**vars(lens()), "lens": found})


def test_a_lens_in_words():
    assert str(Lens()) == "none"
    assert str(of_opencv((0.1, -0.2, 0.0, 0.0, 0.0))) == "k1 0.1, k2 -0.2"
    assert str(of_opencv(DISTORTION[:8])).endswith(
        "p1 0.003, p2 -0.002, k4 0.05, k5 -0.01, k6 0.004"
    )
    assert str(models.lens("OPENCV_FISHEYE", {"k1": 0.02})) == "fisheye, k1 0.02"
    assert str(models.lens("FOV", {"omega": 0.9})) == "fov, ω 0.9"
