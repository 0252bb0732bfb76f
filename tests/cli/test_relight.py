"""`isas relight`: a result against pictures that Mitsuba alone has made."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import OpenImageIO as oiio
import photo_sets
import pytest
from photo_sets import FOCAL, SIZE, Files, look_at
from PIL import Image
from xml_for_tests import camera

import isas_cli
from isas_cli.cli import relight
from isas_cli.cli.app import main
from isas_cli.config.photographs import PhotosConfig
from isas_cli.engine import resumption
from isas_cli.measure import relighting
from isas_cli.runtime import backend, images
from isas_cli.runtime.errors import InputError
from isas_cli.scene import export, relit
from isas_cli.scene.photos import building, importing, turns
from isas_cli.scene.photos.camera import Camera
from isas_cli.scene.photos.lens import Lens

PLACES = (0.8, 0.9, 2.2), (-2.0, 0.6, 1.2)
# Of a sphere whose colour is the only unknown, and begins near the truth.
SCENE = f"""<scene version="3.0.0">
<integrator type="prb"><integer name="max_depth" value="3"/></integrator>
{camera("0,0,3", 24, fov=40)}
<emitter type="constant"><rgb name="radiance" value="1, 1, 1"/></emitter>
<shape type="rectangle" id="lamp">
<emitter type="area"><rgb name="radiance" value="9, 0, 0"/></emitter>
<transform name="to_world"><scale value="0.3"/><translate y="2"/></transform></shape>
<shape type="sphere" id="ball"><float name="radius" value="0.5"/>
<bsdf type="principled"><rgb name="base_color" value="0.6, 0.3, 0.15"/>
<float name="roughness" value="0.4"/></bsdf></shape></scene>"""


def sky(folder, name: str) -> str:
    """Light from above in two colours."""
    rows = np.mgrid[:16, :32][0] / 16
    pixels = np.stack([1.5 - rows, 0.6 + 0 * rows, 0.2 + rows], axis=2).astype(np.float32)
    path = folder / name
    images.write_exr(path, pixels, [*"RGB"], {})
    return str(path)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run's folder, its XML, and a set of pictures under another light with masks."""
    folder = tmp_path_factory.mktemp("relight")
    (folder / "scene.xml").write_text(SCENE)
    unknown = {"ball.bsdf.base_color.value": {"start": [0.61, 0.29, 0.16], "range": [0, 1]}}
    isas_cli.run(
        *("scene=file", f"scene.path={folder / 'scene.xml'}", "budget.iterations=2"),
        *("optimizer.lr=0.001", "target.spp=16", "effects=full", "report=false"),
        *("frames.views=0", "frames.snapshots=0", "evaluation.count=1"),
        *(f"scene.unknowns={json.dumps(unknown)}", f"hydra.run.dir={folder / 'run'}"),
    )
    light = sky(folder, "sky.exr")
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6, "hide_emitters": True},
        "sky": {"type": "envmap", "filename": light},
        "ball": {
            "type": "sphere",
            "radius": 0.5,
            "bsdf": {
                "type": "principled",
                "base_color": {"type": "rgb", "value": [0.6, 0.3, 0.15]},
                "roughness": 0.4,
            },
        },
    }
    for number, place in enumerate(PLACES):
        scene[f"sensor_{number}"] = {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(SIZE[0] / 2 / FOCAL))),
            "to_world": mi.ScalarTransform4f().look_at(place, (0, 0, 0), (0, 1, 0)),
            "film": {
                **dict(type="hdrfilm", width=SIZE[0], height=SIZE[1], pixel_format="rgba"),
                **dict(rfilter={"type": "box"}),
            },
        }
    with backend.loading():
        loaded = mi.load_dict(scene)
    found = [np.array(mi.render(loaded, sensor=n, spp=512)) for n in range(len(PLACES))]
    (folder / "set/masks").mkdir(parents=True)
    poses = [look_at(place, (0.0, 0.0, 0.0)) for place in PLACES]
    files = Files(folder / "set", poses, [each[..., :3].astype(np.float32) for each in found])
    photo_sets.transforms(files, cx=SIZE[0] / 2, cy=SIZE[1] / 2)
    for number, each in enumerate(found):
        mask = np.repeat(images.to_display(each[..., 3:] > 0.99), 3, axis=2)
        images.write_png(folder / f"set/masks/view_{number}.png", mask)
    return folder


def scores(folder, *more: str) -> dict:
    assert main(["relight", str(folder / "run"), str(folder / "set"), *more]) == 0
    return json.loads((folder / "run/relit/scores.json").read_text())


def test_the_other_light_is_taken(run, capsys):
    """In place of the scene's own, the lamp's with it: by that and by a light upside down pictures
    are foretold worse."""
    found = scores(run, "--light", str(run / "sky.exr"), "--spp", "512")
    out = capsys.readouterr().out
    assert list(found["views"]) == ["view_0.exr", "view_1.exr"]
    assert found["mean"]["psnr_h"] > 38 and found["mean"]["ssim"] > 0.98
    assert f"{found['mean']['psnr_l']:.4g}" in out and "PSNR-H" in out
    shown = images.read(run / "run/relit/view_1.exr")
    (_, camera), over = relight._cameras(run / "set", PhotosConfig())
    assert over == set()
    mask = run / "set/masks/view_1.png"
    again = relighting.of_picture(shown, camera, camera, mask, "", False, True)
    assert again == pytest.approx(found["views"]["view_1.exr"])
    for more in ([], ["--light", str(run / "sky.exr"), "--up=-y"]):
        assert scores(run, *more)["mean"]["psnr_h"] < found["mean"]["psnr_h"] - 6


def test_each_view_may_have_a_light_of_its_own(run):
    (run / "lights").mkdir()
    for number in range(2):
        sky(run / "lights", f"view_{number}.exr")
    more = "--light", str(run / "lights"), "--width", "20", "--output", str(run / "small")
    assert main(["relight", str(run / "run"), str(run / "set/transforms.json"), *more]) == 0
    assert images.read(run / "small/view_0.exr").shape == (15, 20, 3)
    assert json.loads((run / "small/scores.json").read_text())["mean"]["psnr_h"] > 30


def test_what_a_light_lacks_is_said_once(run, tmp_path, capsys):
    Image.new("RGB", (16, 16), (255, 255, 200)).save(tmp_path / "probe.png")
    more = "--light", str(tmp_path / "probe.png"), "--spp", "1", "--output", str(tmp_path / "out")
    assert main(["relight", str(run / "run"), str(run / "set"), *more]) == 0
    assert capsys.readouterr().err.count(f"--light {tmp_path / 'probe.png'}: 16×16 pixels") == 1


def test_an_environment_turns_about_the_world_s_up(run):
    """By half a turn of a light from one side, what was bright is dark; by a whole one nothing
    changes. Without a word it is turned as the run's own was."""
    pixels = np.zeros((16, 32, 3), np.float32)
    pixels[:, 12:20] = 3  # around the middle
    images.write_exr(run / "side.exr", pixels, [*"RGB"], {})
    found = {}
    for turn in ("0", "180", "360"):
        main(
            [*("relight", str(run / "run"), str(run / "set"), "--light", str(run / "side.exr"))]
            + [*("--turn", turn, "--spp", "64", "--output", str(run / f"turn{turn}"))]
        )
        found[turn] = images.read(run / f"turn{turn}/view_0.exr").mean()
    assert found["0"] > 3 * found["180"] and found["360"] == pytest.approx(found["0"], rel=1e-3)


def test_what_lies_ahead_of_a_camera_is_in_the_middle_of_its_environment():
    """As Stanford-ORB's ground truth has it: forward in the middle, the camera's left a quarter
    of the width from the left, up above."""
    camera = Camera("a", Path("a"), *SIZE, FOCAL, FOCAL, 20, 15, look_at((1, 2, 3), (0, 0, 0)))
    turned = np.array(building.facing(camera).matrix).reshape(4, 4)[:3, :3]
    right, down, forward = camera.to_world[:3, :3].T
    # Mitsuba's environments have z in the middle, x at a quarter, y above.
    np.testing.assert_allclose(turned.T, [-right, -down, forward], atol=1e-6)


def test_two_views_do_not_share_an_environment_by_chance(tmp_path):
    for name in ("a/env_map/0001.exr", "0002.exr"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = relight._lights(tmp_path, ["a/test/0001.exr", "b/test/0002.exr"])
    assert found == [tmp_path / "a/env_map/0001.exr", tmp_path / "0002.exr"]
    with pytest.raises(InputError, match="would be that of b/test/0002.exr and of c/test/0002.exr"):
        relight._lights(tmp_path, ["b/test/0002.exr", "c/test/0002.exr"])


@pytest.mark.parametrize("name", ["/data/set/0001.exr", "../set/0001.exr"])
def test_a_rendering_stays_in_its_folder(tmp_path, name):
    relit.write(tmp_path, name, np.zeros((2, 2, 3), np.float32))
    (path,) = tmp_path.rglob("*.exr")
    assert path.name == "0001.exr"


def test_a_dot_in_a_name_without_an_ending_stays(tmp_path):
    for name in ("r_0.25", "r_0.5"):
        relit.write(tmp_path, name, np.zeros((2, 2, 3), np.float32))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["r_0.25.exr", "r_0.5.exr"]


def test_a_set_that_is_nowhere_is_one_line(run, capsys):
    assert main(["relight", str(run / "run"), "nowhere"]) == 2
    assert "isas: nowhere: no such folder of photographs" in capsys.readouterr().err


@pytest.mark.parametrize(
    "more, told",
    [
        (["--light", "none.exr"], "--light none.exr: no such file or folder"),
        (["--light", "."], "--light .: no environment for view_0.exr, such as view_0.exr"),
        (["--output", "/dev/null/x"], "/dev/null/x: cannot be written"),
        (["--up", "w"], "--up w: valid: x, y, z, -x, -y, -z, camera"),
        (["--up", "z"], "--up and --turn say how the environment of --light stands: give --light"),
        (["--turn", "90"], "--up and --turn say how the environment of --light stands"),
        (
            ["--light", ".", "--up", "camera", "--turn", "90"],
            "--turn 90: with --up camera a light stands to the camera",
        ),
        (["--width", "0"], "--width 0: at least 1"),
        (["--spp", "0"], "--spp 0: at least 1"),
        (["--width", "39"], "39 × 29 rendered, which does not go into its 40 × 30"),
    ],
)
def test_wrong_input_is_one_line(run, capsys, monkeypatch, tmp_path, more, told):
    monkeypatch.chdir(tmp_path)
    assert main(["relight", str(run / "run"), str(run / "set"), "--output", "out", *more]) == 2
    assert told in capsys.readouterr().err


def test_cameras_stand_in_the_world_of_the_run(tmp_path, capsys):
    """Where a set tells of two, and pictures are turned where the run's are."""
    turn = np.eye(4)
    turn[:3, 3] = 1.0, 2.0, 3.0
    poses = [look_at(place, (0.0, 0.0, 0.0)) for place in PLACES]
    photo_sets.transforms(Files(tmp_path, poses), applied_transform=turn[:3].tolist())
    for world, way in (("file", np.eye(4)), ("mesh", np.linalg.inv(turn))):
        (camera, _), _ = relight._cameras(tmp_path, PhotosConfig(world=world))
        np.testing.assert_allclose(camera.to_world, way @ poses[0], atol=1e-6)
        said = capsys.readouterr().err
        assert "applied_transform" in said and ("stay" in said) == (world == "file")


def test_pixels_that_are_not_square_are_made_so(tmp_path):
    """As COLMAP's undistorter leaves them."""
    x, y = (np.arange(10) + 0.5) / 10, (np.arange(16) + 0.5) / 16
    tall = np.stack(np.broadcast_arrays(x[None] ** 2, y[:, None], 0.5), axis=2).astype(np.float32)
    shown = tall.reshape(8, 2, 10, 3).mean(axis=1)
    images.write_exr(tmp_path / "a.exr", tall, [*"RGB"], {})
    camera = Camera("a", tmp_path / "a.exr", 10, 16, 20.0, 40.0, 5.0, 8.0, np.eye(4))
    square = relit.cut(camera, None)
    assert (square.width, square.height, square.fx, square.fy) == (10, 8, 20, 20)
    images.write_png(tmp_path / "mask.png", np.full((16, 10, 3), 255, np.uint8))
    mask = tmp_path / "mask.png"
    found = relighting.of_picture(shown, square, camera, mask, "", False, True)
    assert found["psnr_h"] > 40
    exposed = replace(camera, exposure=(2.0, 2.0, 2.0))
    found = relighting.of_picture(shown / 2, square, exposed, mask, "", False, False)
    assert found["psnr_h"] > 40


@pytest.mark.parametrize("width", [None, 40])
def test_a_lens_is_taken_out_of_pictures(tmp_path, width):
    """And what a pinhole sees beside them does not count."""
    k, size, focal, middle = 0.15, (80, 60), 70.0, np.array([41.0, 29.0])

    def smooth(x, y) -> np.ndarray:
        waves = np.sin(x / 9), np.cos(y / 8), np.sin((x + y) / 11)
        return np.stack([0.4 + 0.3 * each for each in waves], axis=2).astype(np.float32)

    y, x = np.indices(size[::-1]) + 0.5
    images.write_exr(tmp_path / "a.exr", smooth(x, y), [*"RGB"], {})
    images.write_png(tmp_path / "mask.png", np.full((60, 80, 3), 255, np.uint8))
    lens = Lens(radial=(k, 0.0, 0.0, 0.0))
    numbers = *size, focal, focal, *middle, np.eye(4)
    camera = Camera("a", tmp_path / "a.exr", *numbers, lens=lens)
    rendering = relit.cut(camera, width)
    by = 80 // (width or 80)
    assert rendering.ideal and (rendering.width, rendering.height) == (80 // by, 60 // by)
    rows, columns = np.indices((60 // by, 80 // by)) + 0.5
    plane = (np.stack([columns, rows], axis=2) * by - middle) / focal
    seen = plane * (1 + k * (plane**2).sum(axis=2, keepdims=True)) * focal + middle
    shown = smooth(*np.moveaxis(seen, 2, 0))
    beside = ((seen < 0) | (seen > size)).any(axis=2)
    shown[beside] = 9
    assert beside.any()
    told = rendering, camera, tmp_path / "mask.png", "view a", False, False
    assert relighting.of_picture(shown, *told)["psnr_h"] > 45


@pytest.mark.parametrize("orientation", [3, 6])
def test_masks_lie_as_their_pictures(tmp_path, orientation):
    """As a run takes them: upright ones of pictures that are read as stored, where their sizes tell
    of one of the set."""
    folder, exif = tmp_path / "set", Image.Exif()
    (folder / "masks").mkdir(parents=True)
    content = photo_sets.transforms(Files(folder, photo_sets.POSES[:2]))
    white = np.zeros((30, 40), np.uint8)
    white[4:20, 3:25] = 255
    for number, tag in enumerate((8, orientation)):
        exif[0x112] = tag
        content["frames"][number]["file_path"] = f"{number}.jpg"
        Image.new("RGB", (40, 30), (90, 90, 90)).save(folder / f"{number}.jpg", exif=exif)
        upright = {3: white[::-1, ::-1], 6: np.rot90(white, -1), 8: np.rot90(white, 1)}[tag]
        Image.fromarray(np.ascontiguousarray(upright)).save(folder / f"masks/{number}.png")
    photo_sets.write(folder / "transforms.json", content)
    cameras, over = as_asked(folder)
    across, told = turns.across(cameras, over)
    assert (over, told) == (set(), []) and across == {"0.jpg", "1.jpg"}
    shown = np.zeros((30, 40, 3), np.float32)
    shown[4:20, 3:25] = images.srgb_decode(np.float32(90 / 255))
    for each in cameras:
        ways = False, each.name in across
        found = relight._score(shown, each, each, PhotosConfig(), "", ways, False)
        assert found["psnr_l"] > 40 and found["psnr_h"] is None


@pytest.fixture
def tall(tmp_path, rng):
    """A picture of 80 × 60, and a mask."""
    picture = np.kron(rng.uniform(0.1, 0.7, (15, 20, 3)), np.ones((4, 4, 1))).astype(np.float32)
    images.write_exr(tmp_path / "a.exr", picture, [*"RGB"], {})
    images.write_png(tmp_path / "mask.png", np.full((60, 80, 3), 255, np.uint8))
    return picture


def of_tall(folder, shown, fy, width=None, size=(40, 30)) -> float:
    camera = Camera("a", folder / "a.exr", *size, 55.0, fy, size[0] / 2, size[1] / 2, np.eye(4))
    rendering = relit.cut(camera, width)
    told = rendering, camera, folder / "mask.png", "view a", False, False
    return relighting.of_picture(shown, *told)["psnr_h"]


@pytest.mark.parametrize("width, by", [(None, 2), (20, 4)])
def test_pixels_that_are_hardly_oblong_score_as_square_ones(tmp_path, tall, rng, width, by):
    """Of a picture that is larger than its camera's file says."""
    means = tall.reshape(60 // by, by, 80 // by, by, 3).mean(axis=(1, 3))
    shown = means + rng.normal(0, 0.03, means.shape)
    found = [of_tall(tmp_path, shown, fy, width) for fy in (55.0, 54.9999)]
    print(found)
    assert 20 < found[0] < 40 and found[1] == pytest.approx(found[0], abs=0.1)


def test_oblong_pixels_are_made_square_of_any_width(tmp_path, tall):
    camera = Camera("a", tmp_path / "a.exr", 80, 60, 110.0, 100.0, 40.0, 30.0, np.eye(4))
    rendering, whole = relit.cut(camera, 20), np.ones((60, 80), np.float32)
    shown, _ = importing.resample(camera, rendering, tall, whole)
    assert shown.shape == (16, 20, 3)
    told = rendering, camera, tmp_path / "mask.png", "view a", False, False
    assert relighting.of_picture(shown, *told)["psnr_h"] > 60


def test_a_picture_of_another_shape_is_not_its_cameras(tmp_path, tall):
    with pytest.raises(InputError, match="view a: 80 × 60 pixels, but its camera is of 40 × 60"):
        of_tall(tmp_path, tall, 55.0, size=(40, 60))


def as_asked(folder, **own):
    """Cameras of a set as a run with these settings has them."""
    return relight._cameras(folder, PhotosConfig(**own))


def test_a_model_is_of_the_set_around_it(tmp_path):
    photo_sets.colmap(Files(tmp_path, photo_sets.POSES))
    (tmp_path / "masks").mkdir()
    for number in range(3):
        images.write_png(tmp_path / f"masks/view_{number}.png", np.ones((30, 40, 1), np.uint8))
    for place in ("", "sparse", "sparse/0", "sparse/0/cameras.txt"):
        cameras, _ = as_asked(tmp_path / place)
        assert [c.image for c in cameras] == [tmp_path / f"images/view_{n}.png" for n in range(3)]
        assert [c.mask for c in cameras] == [tmp_path / f"masks/view_{n}.png" for n in range(3)]
    (tmp_path / "images/view_1.png").unlink()
    with pytest.raises(InputError, match="view_1.png does not exist.*photos.… are the run's"):
        as_asked(tmp_path / "sparse/0")


def test_the_run_s_own_set_is_found_as_the_run_found_it(tmp_path):
    """Its cameras, pictures, masks, sizes and what is missing; of another set they say nothing."""
    photo_sets.colmap(Files(tmp_path, photo_sets.POSES))
    (tmp_path / "images/view_2.png").unlink()
    content = photo_sets.transforms(Files(tmp_path, photo_sets.POSES[:1]))
    content["frames"][0]["transform_matrix"] = np.eye(4).tolist()
    photo_sets.write(tmp_path / "transforms.json", content)
    for folder in ("small", "cut"):
        (tmp_path / folder).mkdir()
    for number in range(2):
        images.write_png(tmp_path / f"small/view_{number}.png", np.full((15, 20, 3), 90, np.uint8))
        images.write_png(tmp_path / f"cut/view_{number}.png", np.full((15, 20, 1), 255, np.uint8))
    own = dict(cameras="sparse", images="small", masks="cut", scale=0.5, missing="skip")
    for place in ("", "sparse", "sparse/0", "sparse/0/cameras.txt"):
        cameras, _ = as_asked(tmp_path / place, path=str(tmp_path), **own)
        assert [c.image for c in cameras] == [tmp_path / f"small/view_{n}.png" for n in range(2)]
        assert [c.mask for c in cameras] == [tmp_path / f"cut/view_{n}.png" for n in range(2)]
        np.testing.assert_allclose(cameras[0].to_world, photo_sets.POSES[0], atol=1e-9)
        assert (cameras[0].width, cameras[0].fx) == (20, FOCAL / 2)
    (camera,), _ = as_asked(tmp_path, path=str(tmp_path), **own, without=["view_1.png"])
    assert camera.image.name == "view_0.png"
    own |= dict(missing="refuse", without=["view_2.png"])
    assert len(as_asked(tmp_path, path=str(tmp_path), **own)[0]) == 2
    (camera,), _ = as_asked(tmp_path, path="another", **own)
    assert camera.image == tmp_path / "view_0.exr" and camera.mask is None


def test_a_file_that_the_run_found_by_itself_is_its_own(tmp_path):
    content = photo_sets.transforms(Files(tmp_path, photo_sets.POSES))
    photo_sets.write(tmp_path / "other.json", content)
    (tmp_path / "cut").mkdir()
    for number in range(3):
        images.write_png(tmp_path / f"cut/view_{number}.png", np.full((30, 40, 1), 255, np.uint8))
    own = dict(path=str(tmp_path), masks="cut", without=["view_1.exr"])
    for place in ("", "transforms.json"):
        cameras, _ = as_asked(tmp_path / place, **own)
        assert [c.mask for c in cameras] == [tmp_path / f"cut/view_{n}.png" for n in (0, 2)]
    cameras, _ = as_asked(tmp_path / "other.json", **own)
    assert [c.mask for c in cameras] == [None] * 3


def test_cameras_without_a_size_are_of_pictures_as_the_run_turns_them(tmp_path):
    content = photo_sets.blender(Files(tmp_path, photo_sets.POSES))
    exif = Image.Exif()
    exif[0x112] = 6
    for number in range(3):
        (tmp_path / f"view_{number}.png").unlink()
        Image.new("RGB", (40, 30), (90, 90, 90)).save(tmp_path / f"view_{number}.jpg", exif=exif)
    for orientation, wide in (("stored", 40), ("turned", 30)):
        cameras, over = as_asked(tmp_path, orientation=orientation)
        assert {camera.width for camera in cameras} == {wide} and bool(over) == (wide == 30)
        focal = wide / 2 / np.tan(content["camera_angle_x"] / 2)
        assert cameras[0].fx == pytest.approx(focal)


def test_pictures_are_read_as_the_run_reads_them(tmp_path, capsys):
    """Files of whole numbers by its encoding, from which light in floating point has none; what
    these say of their colours and cannot be heeded is said."""
    folder, own = tmp_path / "set", tmp_path / "own"
    (folder / "masks").mkdir(parents=True)
    own.mkdir()
    photo_sets.blender(Files(own, photo_sets.POSES[:2]))
    content = photo_sets.blender(Files(folder, photo_sets.POSES[:2]))
    spec = oiio.ImageSpec(40, 30, 3, oiio.FLOAT)
    odd = 0.5, 0.3, 0.3, 0.5, 0.2, 0.1, 0.3, 0.3
    spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), odd)
    output = oiio.ImageOutput.create("light.exr")
    assert output.open(str(folder / "light.exr"), spec)
    assert output.write_image(np.full((30, 40, 3), 0.3, np.float32)) and output.close()
    content["frames"][1]["file_path"] = "light.exr"
    photo_sets.write(folder / "transforms_train.json", content)
    for name in ("view_0.png", "light.png"):
        images.write_png(folder / f"masks/{name}", np.full((30, 40, 1), 255, np.uint8))
    isas_cli.run(
        *("scene=photos", f"photos.path={own}", "photos.sphere=[0,0,0,0.5]", "photos.sky=2"),
        *("photos.texture=4", "photos.encoding=linear", "sampler=uniform", "effects=full"),
        *("budget.iterations=1", "report=false", "frames.views=0", "frames.snapshots=0"),
        *("evaluation.count=1", f"hydra.run.dir={tmp_path / 'run'}"),
    )
    found = {}
    for encoding in ("linear", "srgb"):
        file = tmp_path / "run/config.yaml"
        file.write_text(file.read_text().replace("encoding: linear", f"encoding: {encoding}"))
        assert main(["relight", str(tmp_path / "run"), str(folder), "--spp", "4"]) == 0
        found[encoding] = json.loads((tmp_path / "run/relit/scores.json").read_text())["views"]
        told = f"the primaries that it names of {folder / 'light.exr'} cannot be heeded"
        assert told in capsys.readouterr().err
    assert found["linear"]["light.exr"] == found["srgb"]["light.exr"]
    cameras, _ = as_asked(folder)
    shown = images.read(tmp_path / "run/relit/view_0.exr")
    for encoding, linear in (("linear", True), ("srgb", False)):
        told = cameras[0], cameras[0], folder / "masks/view_0.png", "", False, False, linear
        wanted = relighting.of_picture(shown, *told)
        assert found[encoding]["view_0"].pop("psnr_h") is wanted.pop("psnr_h") is None
        assert found[encoding]["view_0"] == pytest.approx(wanted, rel=1e-3)
    assert found["linear"]["view_0"] != found["srgb"]["view_0"]


def test_exposures_that_the_run_found_are_fitted(run, tmp_path, monkeypatch, capsys):
    """And cameras that it found are not taken, which is said."""
    isas_cli.run(
        *("scene=photos", f"photos.path={run / 'set'}", "photos.sphere=[0,0,0,0.5]"),
        *("photos.exposure=scale", "photos.refine=true", "sampler=uniform", "effects=full"),
        *("estimator=two_path", "estimator.batch=512", "budget.iterations=1", "report=false"),
        *("frames.views=0", "frames.snapshots=0", f"hydra.run.dir={tmp_path / 'run'}"),
    )
    fitted, honest = [], relighting.of_picture
    record = lambda *given: fitted.append(given[6]) or honest(*given)
    monkeypatch.setattr(relighting, "of_picture", record)
    for folder in (run, tmp_path):
        assert main(["relight", str(folder / "run"), str(run / "set"), "--spp", "4"]) == 0
    assert fitted == [False] * len(PLACES) + [True] * len(PLACES)
    assert "photos.refine: cameras are as their file has them" in capsys.readouterr().err


@pytest.mark.parametrize("empty", [0, 1])
@pytest.mark.parametrize("gone", [False, True])
def test_a_view_of_an_empty_mask_or_none_is_left_out_and_named(run, tmp_path, capsys, empty, gone):
    """The last one as well."""
    shutil.copytree(run / "set", tmp_path / "set")
    mask = tmp_path / f"set/masks/view_{empty}.png"
    Image.new("L", Image.open(mask).size).save(mask)
    if gone:
        mask.unlink()
    words = ["--light", str(run / "sky.exr"), "--output", str(tmp_path / "out")]
    assert main(["relight", str(run / "run"), str(tmp_path / "set"), *words]) == 0
    found = json.loads((tmp_path / "out/scores.json").read_text())
    assert list(found["views"]) == [f"view_{1 - empty}.exr"]
    assert found["left_out"] == [f"view_{empty}.exr"]
    assert f"view_{empty}.exr: left out" in capsys.readouterr().err
    assert (tmp_path / f"out/view_{empty}.exr").is_file()


def test_a_set_without_any_mask_is_refused_before_it_is_rendered(
    run, tmp_path, monkeypatch, capsys
):
    shutil.copytree(run / "set", tmp_path / "set")
    shutil.rmtree(tmp_path / "set/masks")
    monkeypatch.setattr(relit, "views", lambda *_: pytest.fail("rendered"))
    assert main(["relight", str(run / "run"), str(tmp_path / "set")]) == 2
    assert "set: no view has a mask or alpha, which say what is scored" in capsys.readouterr().err


def test_a_mask_may_be_smaller_than_its_picture(tmp_path, tall, rng):
    """As a run takes it."""
    shown, found = tall + rng.normal(0, 0.03, tall.shape), []
    for by in (1, 2, 4):
        mask = np.zeros((60 // by, 80 // by, 3), np.uint8)
        mask[:, : 40 // by] = 255
        images.write_png(tmp_path / "mask.png", mask)
        found.append(of_tall(tmp_path, shown, 55.0, size=(80, 60)))
    assert np.isfinite(found).all() and found == pytest.approx(found[:1] * 3)


def test_paths_are_as_long_as_the_runs(run):
    """Under its own light, the lamp's back included."""
    typed, arrays = resumption.result(run / "run")
    result = export.result(typed.scene, arrays)
    assert result[1:] == (3, False)
    typed.scene.max_depth = 2
    assert export.result(typed.scene, arrays)[1] == 2


@pytest.mark.parametrize("grouped", [False, True])
def test_a_medium_is_refused(grouped):
    """Also one that instances of a group show."""
    inside = {"type": "homogeneous", "albedo": 0.5, "sigma_t": 1.0}
    fog = {"type": "cube", "bsdf": {"type": "null"}, "interior": inside}
    if grouped:
        shown = {"type": "instance", "of": {"type": "ref", "id": "group"}}
        things = {"group": {"type": "shapegroup", "fog": fog}, "shown": shown}
    else:
        things = {"fog": fog}
    scene = mi.load_dict({"type": "scene"} | things)
    with pytest.raises(InputError, match="has a medium: isas relight renders surfaces alone"):
        next(relit.views((scene, 3, False), [], [], "y", 0.0, 1))


def test_white_is_where_the_run_says(tmp_path, rng):
    """By ``photos.saturated``: a factor is fitted below that."""
    linear = rng.uniform(0.05, 0.4, (30, 40, 3))
    linear[10:14] = 0.7  # as bright as this sensor tells
    images.write_png(tmp_path / "a.png", images.to_display(linear))
    linear[10:14] = 8
    images.write_png(tmp_path / "mask.png", np.full((30, 40, 3), 255, np.uint8))
    mask = tmp_path / "mask.png"
    camera = Camera("a", tmp_path / "a.png", *SIZE, FOCAL, FOCAL, 20, 15, np.eye(4), mask=mask)
    found = []
    for saturated in (0.8, 0.995):
        own = PhotosConfig(saturated=saturated)
        fitted = relight._score(linear / 2, camera, camera, own, "", (False, False), True)
        found.append(fitted["psnr_l"])
    print(found)
    assert found[0] > found[1] + 6


def test_a_path_that_is_no_number_costs_its_pixel_a_part(monkeypatch):
    """And one whose every path is none is none."""
    scene = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "film": {"type": "hdrfilm", "width": 4, "height": 3},
        },
    }
    counts = []

    def render(scene, spp, seed):
        image = np.full((3, 4, 3), float(len(counts)))
        image[0, 0] = np.nan
        image[1, 1, 2] = np.nan if len(counts) == 2 else 0
        counts.append(spp)
        return image

    monkeypatch.setattr(mi, "render", render)
    image, lost = relit._rendered(mi.load_dict(scene), 10, 0)
    assert counts == [3, 3, 3, 1] and lost == 2
    assert np.isnan(image[0, 0]).all() and np.isfinite(image).sum() == 11 * 3
    assert image[2, 3] == pytest.approx((0 * 3 + 1 * 3 + 2 * 3 + 3) / 10)
    assert image[1, 1, 0] == pytest.approx((0 * 3 + 1 * 3 + 3) / 7)


def test_a_view_whose_rendering_is_none_is_left_out(run, tmp_path, monkeypatch, capsys):
    honest = relit._rendered

    def broken(scene, spp, seed):
        image, _ = honest(scene, spp, seed)
        return (image, 0) if seed else (np.full_like(image, np.nan), image[..., 0].size)

    monkeypatch.setattr(relit, "_rendered", broken)
    words = ["--light", str(run / "sky.exr"), "--spp", "4", "--output", str(tmp_path)]
    assert main(["relight", str(run / "run"), str(run / "set"), *words]) == 0
    found = json.loads((tmp_path / "scores.json").read_text())
    assert found["left_out"] == ["view_0.exr"] and np.isfinite(found["mean"]["psnr_h"])
    said = " ".join(capsys.readouterr().err.split())
    assert f"view_0.exr: of {SIZE[0] * SIZE[1]} pixels paths that are no numbers" in said
    assert "view_0.exr: left out: its rendering has pixels that are no numbers" in said


def test_pictures_in_another_unit_are_said(run, tmp_path, capsys):
    shutil.copytree(run / "set", tmp_path / "set")
    for number in range(len(PLACES)):
        file = tmp_path / f"set/view_{number}.exr"
        images.write_exr(file, 1000 * images.read(file), [*"RGB"], {})
    words = ["--light", str(run / "sky.exr"), "--spp", "4", "--output", str(tmp_path / "out")]
    for folder, told in ((run, False), (tmp_path, True)):
        assert main(["relight", str(run / "run"), str(folder / "set"), *words]) == 0
        said = " ".join(capsys.readouterr().err.split())
        assert ("often brighter than 1 or all below 0.05" in said) is told
