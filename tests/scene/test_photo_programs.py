"""Cameras as Metashape, Polycam and RealityCapture export them: files by the form that their
documentation gives, of cameras that are known."""

import json
import shutil

import numpy as np
import photo_sets
import pytest
from photo_sets import CENTRE, FOCAL, POSES, SIZE, Files, llff, neus
from PIL import Image
from scipy.spatial.transform import Rotation
from test_photo_cameras import POINTS, browns, expected

from isas_cli.config.schema import PhotosConfig
from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos import finding, photographs, reading

FLIPPED = np.diag([1.0, -1.0, -1.0, 1.0])


def text(values) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(values))


def agree(folder, poses=POSES, **more):
    capture = reading.read(str(folder), **more)
    for camera, pose in zip(capture.cameras, poses, strict=True):
        np.testing.assert_allclose(camera.project(POINTS)[0], expected(pose), atol=1e-6)
        assert camera.image.is_file() and (camera.width, camera.height) == SIZE
    return capture


def refused(folder, told: str) -> None:
    with pytest.raises(InputError, match=told) as error:
        reading.read(str(folder))
    assert "\n" not in str(error.value)


# Metashape ---------------------------------------------------------------------------------------

ADJUSTED = (
    f"<f>{FOCAL}</f><cx>{CENTRE[0] - SIZE[0] / 2}</cx><cy>{CENTRE[1] - SIZE[1] / 2}</cy>"
    "<k1>0</k1><p1>0</p1>"
)


def metashape(folder, lens=ADJUSTED, kind="frame", world=None, reference="LOCAL_CS[&quot;m&quot;]"):
    """As 2.1 writes it. ``world``: the component's turn, place and scale, in which POSES are."""
    Files(folder, POSES).names(".png")
    turn, place, scale = world or (np.eye(3), np.zeros(3), 1.0)
    back = np.eye(4)
    back[:3, :3], back[:3, 3] = turn.T / scale, -turn.T @ place / scale
    cameras = []
    for number, pose in enumerate(POSES):
        inside = back @ pose
        inside[:3, :3] = turn.T @ pose[:3, :3]
        cameras.append(
            f'<camera id="{number}" sensor_id="0" component_id="0" label="view_{number}">'
            f"<transform>{text(inside)}</transform><orientation>1</orientation></camera>"
        )
    component = (
        f'<transform><rotation locked="false">{text(turn)}</rotation>'
        f"<translation>{text(place)}</translation><scale>{scale!r}</scale></transform>"
    )
    told = f"""<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="Chunk 1" enabled="true">
  <sensors next_id="1"><sensor id="0" label="unknown" type="{kind}">
    <resolution width="{SIZE[0]}" height="{SIZE[1]}"/>
    <calibration type="{kind}" class="initial"><f>1</f></calibration>
    <calibration type="{kind}" class="adjusted">
      <resolution width="{SIZE[0]}" height="{SIZE[1]}"/>{lens}</calibration>
  </sensor></sensors>
  <components next_id="1" active_id="0"><component id="0" label="Component 1">
    {component if world else ""}</component></components>
  <cameras next_id="4" next_group_id="1">
    <group id="0" label="g">{cameras[0]}</group>{"".join(cameras[1:])}
    <camera id="3" sensor_id="0" label="lost"/></cameras>
  <reference>{reference}</reference></chunk></document>
"""
    (folder / "cameras.xml").write_text(told)


WORLD = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix(), np.array([0.4, 0.2, -3.0]), 2.5


@pytest.mark.parametrize("world", [None, WORLD])
def test_metashape(tmp_path, world):
    metashape(tmp_path, world=world)
    capture = agree(tmp_path)
    assert capture.kind == "Metashape"
    assert capture.notes == [
        f"{tmp_path / 'cameras.xml'}: 1 cameras are not aligned or disabled, first lost"
    ]


def test_metashapes_rigs_are_told(tmp_path):
    metashape(tmp_path)
    file = tmp_path / "cameras.xml"
    file.write_text(file.read_text().replace('label="lost"', 'label="beside" master_id="0"'))
    (note,) = agree(tmp_path).notes
    assert "1 cameras, first beside, hang on others in a rig" in note and "COLMAP" in note


def test_metashapes_active_component_counts(tmp_path):
    metashape(tmp_path)
    file = tmp_path / "cameras.xml"
    text_ = file.read_text().replace(
        'id="0" sensor_id="0" component_id="0"', 'id="0" sensor_id="0" component_id="1"', 1
    )
    file.write_text(text_)
    capture = reading.read(str(tmp_path))
    assert [camera.name for camera in capture.cameras] == ["view_1", "view_2"]
    assert any(
        "1 cameras, first view_0, are of another component" in note for note in capture.notes
    )


def from_first() -> np.ndarray:
    """Where the first camera sees POINTS, before a lens bends it."""
    homogeneous = np.column_stack([POINTS, np.ones(len(POINTS))]).T
    x, y, z = (np.linalg.inv(POSES[0]) @ homogeneous)[:3]
    return np.stack([x / z, y / z])


def test_metashapes_lens(tmp_path):
    """By the manual's formulas, written out: P1 and P2 the other way round, B1 and B2."""
    k1, k2, k3, k4, p1, p2, b1, b2 = 0.1, -0.05, 0.02, 0.01, 0.003, 0.002, 1.5, 0.7
    names = dict(k1=k1, k2=k2, k3=k3, k4=k4, p1=p1, p2=p2, b1=b1, b2=b2, f=FOCAL, cx=3.5, cy=-4)
    for kind in ("frame", "fisheye"):
        metashape(tmp_path, "".join(f"<{n}>{x}</{n}>" for n, x in names.items()), kind)
        (camera, *_) = reading.read(str(tmp_path)).cameras
        x, y = from_first()
        if kind == "fisheye":
            r = np.hypot(x, y)
            x, y = x * np.arctan(r) / r, y * np.arctan(r) / r
        bent_x, bent_y = browns(x, y, (k1, k2, k3, k4), p2, p1)
        u = SIZE[0] / 2 + 3.5 + bent_x * FOCAL + bent_x * b1 + bent_y * b2
        v = SIZE[1] / 2 - 4 + bent_y * FOCAL
        np.testing.assert_allclose(camera.project(POINTS)[0], np.stack([u, v], 1), atol=1e-9)


def test_what_of_metashape_is_refused(tmp_path):
    metashape(tmp_path, world=WORLD, reference="GEOGCS[&quot;WGS 84&quot;]")
    refused(tmp_path, "cameras.xml: its cameras lie on the Earth.*Local Coordinates")
    metashape(tmp_path, kind="spherical")
    refused(tmp_path, "view_0: camera type spherical; valid: frame, fisheye; export .* COLMAP")
    metashape(tmp_path, ADJUSTED + "<p3>0.1</p3>")
    refused(tmp_path, "p3 or p4")
    metashape(tmp_path)
    (tmp_path / "view_1.png").unlink()
    refused(tmp_path, "cameras.xml: camera view_1: its picture .*view_1 does not exist")
    (tmp_path / "cameras.xml").write_text('<document><chunk label="a">')
    refused(tmp_path, "cameras.xml: cannot be read as XML")


# Polycam -----------------------------------------------------------------------------------------


def polycam(folder, kind="corrected_", poses=POSES) -> None:
    keyframes = folder / "keyframes"
    for name in ("cameras", "images"):
        (keyframes / f"{kind}{name}").mkdir(parents=True)
    Files(keyframes / f"{kind}images", POSES).names(".png")
    for number, pose in enumerate(poses):
        rows = (pose @ FLIPPED)[:3]
        told = {f"t_{i}{j}": rows[i, j] for i in range(3) for j in range(4)}
        told |= dict(fx=FOCAL, fy=FOCAL, cx=CENTRE[0], cy=CENTRE[1], width=40, height=30)
        told |= dict(blur_score=115.28, timestamp=638443502)
        photo_sets.write(keyframes / f"{kind}cameras" / f"view_{number}.json", told)


@pytest.mark.parametrize("kind", ["corrected_", ""])
def test_polycam(tmp_path, kind):
    polycam(tmp_path, kind)
    capture = agree(tmp_path)
    assert capture.cameras[0].name == f"keyframes/{kind}images/view_0.png"
    told = "poses as the phone had them" if kind == "" else "black along their borders"
    assert told in " ".join(capture.notes)
    assert agree(tmp_path, cameras="keyframes").kind == "Polycam"
    for named in (f"keyframes/{kind}cameras", f"keyframes/{kind}cameras/view_1.json"):
        assert agree(tmp_path, cameras=named).kind == "Polycam"


def test_polycams_mesh_is_in_a_world_of_its_own(tmp_path):
    """alignmentTransform leads there, column after column."""
    turn = np.eye(4)
    turn[:3, :3], turn[:3, 3] = WORLD[0], WORLD[1]
    raw = [np.linalg.inv(turn) @ pose for pose in POSES]
    polycam(tmp_path, poses=raw)
    photo_sets.write(tmp_path / "mesh_info.json", {"alignmentTransform": turn.T.ravel().tolist()})
    border, note = agree(tmp_path).notes
    assert "black along their borders" in border
    assert "alignmentTransform applied" in note and "photos.world=file" in note
    stay = reading.read(str(tmp_path), world="file")
    np.testing.assert_allclose(stay.cameras[0].to_world, raw[0], atol=1e-9)
    assert stay.notes == [border]
    below = " ".join(reading.read(str(tmp_path / "keyframes")).notes)
    assert "lies above the set, and is not read" in below
    photo_sets.write(tmp_path / "mesh_info.json", {"alignmentTransform": [1, 2]})
    refused(tmp_path, "mesh_info.json: alignmentTransform: no 16 numbers")


def test_what_of_polycam_is_refused(tmp_path):
    polycam(tmp_path)
    file = tmp_path / "keyframes" / "corrected_cameras" / "view_1.json"
    content = json.loads(file.read_text())
    del content["t_12"]
    photo_sets.write(file, content)
    refused(tmp_path, "view_1.json: has no t_12, which Polycam's cameras have")


def test_two_pictures_of_one_name_are_not_chosen_from(tmp_path):
    """What has been cut out lies beside, or a mask; what the camera wrote as well does not count,
    nor does it of a file whose loaders have an order."""
    polycam(tmp_path)
    picture = tmp_path / "keyframes/corrected_images/view_1.png"
    picture.with_suffix(".CR2").write_bytes(b"raw")
    agree(tmp_path)
    shutil.copy(picture, picture.with_suffix(".jpg"))
    refused(tmp_path, "view_1.png and view_1.jpg in .* are both called view_1: move")
    nerf = Files(tmp_path / "nerf", POSES)
    content = photo_sets.transforms(nerf)
    content["frames"][1]["file_path"] = "view_1"
    photo_sets.write(nerf.folder / "transforms.json", content)
    for ending in (".png", ".jpg"):
        shutil.copy(picture, nerf.folder / f"view_1{ending}")
    assert reading.read(str(nerf.folder)).cameras[1].image.name == "view_1.png"


# RealityCapture ----------------------------------------------------------------------------------


def xmp(folder, elements=True, **more) -> None:
    """``elements``: whether long values stand in elements or attributes; versions do either."""
    Files(folder, POSES).names(".png")
    told = dict(
        Version=3,
        PosePrior="locked",
        Coordinates="absolute",
        DistortionModel="brown3",
        DistortionCoeficients="0 0 0 0 0 0",
        FocalLength35mm=repr(FOCAL * 36 / 40),
        Skew=0,
        AspectRatio=1,
        PrincipalPointU=repr((CENTRE[0] - 20) / 40),
        PrincipalPointV=repr((CENTRE[1] - 15) / 40),
    )
    for number, pose in enumerate(POSES):
        each = told | {"Rotation": text(np.linalg.inv(pose)[:3, :3]), "Position": text(pose[:3, 3])}
        each = {name: value for name, value in (each | more).items() if value is not None}
        inner = ("Rotation", "Position", "DistortionCoeficients") if elements else ()
        attributes = " ".join(f'xcr:{n}="{x}"' for n, x in each.items() if n not in inner)
        body = "".join(f"<xcr:{n}>{each[n]}</xcr:{n}>" for n in inner if n in each)
        (folder / f"view_{number}.xmp").write_text(
            '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
            'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
            f'xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#" {attributes}>{body}'
            "</rdf:Description></rdf:RDF></x:xmpmeta>\n"
        )


@pytest.mark.parametrize("elements", [False, True])
@pytest.mark.parametrize("place", [".", "images"])
def test_realitycapture(tmp_path, elements, place):
    (tmp_path / place).mkdir(exist_ok=True)
    xmp(tmp_path / place, elements)
    assert agree(tmp_path).kind == "RealityCapture"


def test_realitycaptures_lens(tmp_path):
    xmp(tmp_path, DistortionModel="brown4", DistortionCoeficients="0.1 -0.05 0.02 0.01 0 0")
    (camera, *_) = reading.read(str(tmp_path)).cameras
    assert camera.lens.radial == (0.1, -0.05, 0.02, 0.01)


def test_realitycapture_counts_in_the_longer_side(tmp_path):
    """Of a picture on edge, its height."""
    xmp(tmp_path)
    Image.new("RGB", SIZE[::-1]).save(tmp_path / "view_0.png")
    camera = reading.read(str(tmp_path)).cameras[0]
    np.testing.assert_allclose((camera.fx, camera.fy), FOCAL)
    np.testing.assert_allclose((camera.cx, camera.cy), np.array(CENTRE) - (5, -5))


def test_realitycaptures_tangential_lens(tmp_path):
    """By Brown's formula, written out; its t1 goes with y, as OpenCV's p1 does with what it calls
    t2."""
    k1, k2, k3, k4, t1, t2 = 0.1, -0.05, 0.02, 0.01, 0.004, -0.003
    for model, last in (("brown4t2", k4), ("brown3t2", 0.0)):
        numbers = f"{k1} {k2} {k3} {last} {t1} {t2}"
        xmp(tmp_path, DistortionModel=model, DistortionCoeficients=numbers)
        (camera, *_) = reading.read(str(tmp_path)).cameras
        x, y = browns(*from_first(), (k1, k2, k3, last), t2, t1)
        wanted = np.stack([x * FOCAL + CENTRE[0], y * FOCAL + CENTRE[1]], 1)
        np.testing.assert_allclose(camera.project(POINTS)[0], wanted, atol=1e-9)
    # The model without it has none, whatever else the file holds.
    xmp(tmp_path, DistortionModel="brown3", DistortionCoeficients="0.1 0 0 0 0 0")
    assert reading.read(str(tmp_path)).cameras[0].lens.tangential == (0, 0)


@pytest.mark.parametrize("lost", [1, 3])
def test_pictures_that_realitycaptures_files_lack(tmp_path, lost):
    xmp(tmp_path)
    for number in range(lost):
        (tmp_path / f"view_{number}.png").unlink()
    refused(tmp_path, "view_0.xmp: its picture .*view_0 does not exist.*photos.missing=skip")
    settings = PhotosConfig(path=str(tmp_path), sphere=[0.0, 0.0, 0.0, 0.5], missing="skip")
    if lost == 3:
        with pytest.raises(InputError, match="missing=skip: none of 3 pictures exists, first view"):
            photographs.load(settings)
        return
    taken = photographs.load(settings)
    assert [each.camera.name for each in taken.shown] == ["view_1.png", "view_2.png"]
    assert any("1 of the views are left out" in each for each in taken.warnings)
    settings = PhotosConfig(path=str(tmp_path), sphere=[0.0, 0.0, 0.0, 0.5], without=["view_0.png"])
    assert len(photographs.load(settings).shown) == 2  # no file says the ending
    (tmp_path / "elsewhere").mkdir()
    Files(tmp_path / "elsewhere", POSES).names(".png")
    settings = PhotosConfig(path=str(tmp_path), sphere=[0.0, 0.0, 0.0, 0.5], images="elsewhere")
    assert len(photographs.load(settings).shown) == 3


@pytest.mark.parametrize(
    "more, told",
    [
        (
            dict(DistortionModel="division", DistortionCoeficients="-0.1 0 0 0 0 0"),
            "view_0.xmp: DistortionModel division; valid: .*brown4t2: choose one in.*COLMAP",
        ),
        (dict(Skew=0.1), "Skew is not 0"),
        (dict(FocalLength35mm=None), "has no FocalLength35mm"),
        (dict(Rotation="1 0 0"), "Rotation has 3 numbers, not 9"),
        (dict(Rotation=None), "holds Rotation and Position"),
    ],
)
def test_what_of_realitycapture_is_refused(tmp_path, more, told):
    xmp(tmp_path, **more)
    refused(tmp_path, told)


def test_realitycaptures_table_is_refused(tmp_path):
    Files(tmp_path, POSES).names(".png")
    head = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\n"
    (tmp_path / "registration.csv").write_text(head)
    told = "registration.csv: RealityCapture's table of angles is not read.*export XMP.*COLMAP"
    refused(tmp_path, told)


# NumPy's files -----------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [1.0, -2.5, 1e-3])
@pytest.mark.parametrize("name", ["cameras_sphere.npz", "cameras.npz"])
def test_neus(tmp_path, factor, name):
    """A camera's matrix is the same camera's times any number."""
    neus(Files(tmp_path, POSES), factor=factor, name=name)
    (tmp_path / "mask").mkdir()
    Image.new("L", SIZE, 255).save(tmp_path / "mask" / "view_1.png")
    capture = agree(tmp_path)
    assert capture.kind == "NeuS" and not any(camera.mask for camera in capture.cameras)
    assert [camera.name for camera in capture.cameras] == [f"image/view_{n}.png" for n in range(3)]
    assert capture.notes == [
        f"{tmp_path / name}: its 3 cameras are of the pictures in the order of their names"
    ]


def test_neus_of_a_world_whose_origin_is_far_away(tmp_path):
    """In millimetres, say."""
    far = [pose + [[0, 0, 0, x] for x in (2e4, -3e4, 1e4, 0)] for pose in POSES]
    neus(Files(tmp_path, far))
    found = reading.read(str(tmp_path)).cameras
    for camera, pose in zip(found, far):
        np.testing.assert_allclose(camera.centre, pose[:3, 3], rtol=1e-6)


def test_masks_of_neus_are_in_the_order_of_their_names(tmp_path):
    """Which are others than the pictures' in its own sets."""
    neus(Files(tmp_path, POSES))
    (tmp_path / "mask").mkdir()
    for number in range(3):
        Image.new("L", SIZE, 255).save(tmp_path / "mask" / f"{number:03d}.png")
    capture = agree(tmp_path)
    assert [camera.mask.name for camera in capture.cameras] == ["000.png", "001.png", "002.png"]
    assert "mask: its masks are called otherwise than the pictures" in capture.notes[1]
    for number in range(3):  # in another order than theirs
        (tmp_path / "mask" / f"{number:03d}.png").rename(tmp_path / f"mask/{2 - number}.png")
        (tmp_path / f"mask/{2 - number}.png").rename(tmp_path / f"mask/view_{number}_mask.png")
    capture = agree(tmp_path)
    assert [c.mask.name for c in capture.cameras] == [f"view_{n}_mask.png" for n in range(3)]
    assert len(capture.notes) == 1
    (tmp_path / "mask/view_2_mask.png").unlink()
    with pytest.raises(InputError, match="hull is made: .*view_2.png has neither"):
        photographs.load(PhotosConfig(path=str(tmp_path)))


def test_neus_of_colmap_counts_from_the_corner(tmp_path):
    neus(Files(tmp_path, POSES), centre=(SIZE[0] / 2, SIZE[1] / 2))
    capture = reading.read(str(tmp_path))
    assert "3 principal points are half the picture's size" in capture.notes[1]
    for camera, pose in zip(capture.cameras, POSES, strict=True):
        wanted = expected(pose, (SIZE[0] / 2, SIZE[1] / 2))
        np.testing.assert_allclose(camera.project(POINTS)[0], wanted, atol=1e-6)


def test_llff(tmp_path):
    llff(Files(tmp_path, POSES))
    capture = reading.read(str(tmp_path))
    assert capture.kind == "LLFF" and "tells of no lens" in capture.notes[0]
    for camera, pose in zip(capture.cameras, POSES, strict=True):
        wanted = expected(pose, (SIZE[0] / 2, SIZE[1] / 2))
        np.testing.assert_allclose(camera.project(POINTS)[0], wanted, atol=1e-6)


def test_arrays_take_the_folder_of_pictures_that_is_given(tmp_path):
    llff(Files(tmp_path, POSES))
    (tmp_path / "images").rename(tmp_path / "photos")
    refused(tmp_path, "poses_bounds.npy: names no pictures, .* photos.images=FOLDER says where")
    with finding.looking(PhotosConfig(images="photos"), tmp_path):
        capture = reading.read(str(tmp_path))
    assert [camera.image.parent.name for camera in capture.cameras] == ["photos"] * 3


def test_what_of_arrays_is_refused(tmp_path):
    neus(Files(tmp_path, POSES), world_mat_1=np.zeros((4, 4)))
    refused(tmp_path, "cameras_sphere.npz: world_mat_1: cannot be inverted")
    neus(Files(tmp_path, POSES), world_mat_1=np.full((4, 4), np.nan))
    refused(tmp_path, "world_mat_1: holds NaN or infinite numbers")
    neus(Files(tmp_path, POSES), world_mat_1=np.eye(3))
    refused(tmp_path, "world_mat_1: no matrix of 4 rows of 4 numbers")
    neus(
        Files(tmp_path, POSES), **{f"world_mat_{n}": np.linalg.inv(p) for n, p in enumerate(POSES)}
    )
    refused(tmp_path, "world_mat_0: its focal length is 1 pixels, of a picture 40 wide")
    skewed = np.array([[FOCAL, 4.0, 20, 0], [0, FOCAL, 15, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    neus(Files(tmp_path, POSES), world_mat_2=skewed @ np.linalg.inv(POSES[2]))
    refused(tmp_path, "world_mat_2: has skew of 4 pixels")
    neus(Files(tmp_path, POSES))
    (tmp_path / "image" / "view_1.png").unlink()
    refused(tmp_path, "holds 3 cameras, but .*image has 2 pictures: one for each camera")
    np.savez(tmp_path / "cameras_sphere.npz", a=np.eye(4))
    refused(tmp_path, "has no world_mat_0, world_mat_1")
    (tmp_path / "cameras_sphere.npz").write_bytes(b"PK\x03\x04none")
    refused(tmp_path, "cameras_sphere.npz: cannot be read as NumPy's arrays: ")
    (tmp_path / "cameras_sphere.npz").unlink()
    np.save(tmp_path / "poses_bounds.npy", np.zeros((3, 16)))
    refused(tmp_path, "poses_bounds.npy: is no table of 17 numbers a row")


def test_xmp_of_several_components_is_refused(tmp_path):
    xmp(tmp_path, ComponentId="{A}")
    assert len(reading.read(str(tmp_path)).cameras) == 3
    file = tmp_path / "view_1.xmp"
    file.write_text(file.read_text().replace("{A}", "{B}"))
    refused(tmp_path, "its XMP files are of 2 components, whose poses share no world")


def test_the_first_format_is_not_asked_what_others_are(tmp_path):
    photo_sets.transforms(Files(tmp_path, POSES))
    for name in ("left.yaml", "right.yaml"):
        (tmp_path / name).write_text("camera_matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n")
    assert len(reading.read(str(tmp_path)).cameras) == 3


def test_a_name_of_two_views_is_refused(tmp_path):
    content = photo_sets.transforms(Files(tmp_path, POSES))
    for number, frame in enumerate(content["frames"][:2]):
        (tmp_path / f"cam{number}").mkdir()
        (tmp_path / frame["file_path"]).rename(tmp_path / f"cam{number}/000.exr")
        frame["file_path"] = f"cam{number}/000.exr"
    photo_sets.write(tmp_path / "transforms.json", content)
    capture = reading.read(str(tmp_path))
    with pytest.raises(InputError, match="000.exr is the name of 2 views, cam0/000.exr and cam1"):
        reading.split(capture, ["000.exr"])
    assert [c.name for c in reading.split(capture, ["cam1/000.exr"])[1]] == ["cam1/000.exr"]


def test_a_theta_lens_of_zero_is_one(tmp_path):
    photo_sets.transforms(Files(tmp_path, POSES), ftheta_p0=0.0)
    refused(tmp_path, "ftheta_p0; valid: ")


@pytest.mark.parametrize(
    "write",
    [metashape, polycam, xmp, photo_sets.transforms, photo_sets.ours, neus],
    ids=lambda write: write.__name__,
)
def test_what_macos_puts_beside_files_is_nothing(tmp_path, write):
    """On disks of other systems, a second file for each, ._NAME."""
    write(tmp_path if write in (metashape, polycam, xmp) else Files(tmp_path, POSES))
    for file in [each for each in tmp_path.rglob("*") if each.is_file()]:
        file.with_name(f"._{file.name}").write_bytes(b"\0\5\x16\7Mac OS X\xff" + bytes(99))
    agree(tmp_path)
