"""Scores of relighting as Stanford-ORB counts them."""

import json

import numpy as np
import pytest
import trimesh

from isas_cli.measure import relighting
from isas_cli.runtime import images
from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos.camera import Camera
from isas_cli.scene.shape_error import Sampled

SIDE = 24


@pytest.fixture
def target(rng) -> np.ndarray:
    return rng.uniform(0.05, 0.8, (SIDE, SIDE, 3))


@pytest.fixture
def mask() -> np.ndarray:
    found = np.zeros((SIDE, SIDE))
    found[4:20, 6:22] = 1
    return found


def test_a_factor_a_channel_and_what_lies_outside_do_not_count(target, mask, rng):
    image = target * [0.3, 2.0, 1.1]
    image[(mask == 0)] = 7
    image[4:6], image[:, 20:22] = 9, 9  # the rim
    found = relighting.pictures(image, target, mask)
    assert found["psnr_h"] > 250 and found["psnr_l"] > 250
    assert found["ssim"] == pytest.approx(1)
    found = relighting.albedo(image, target, mask)
    assert found["psnr"] > 250 and found["ssim"] == pytest.approx(1)


def test_under_the_same_light_brightness_counts(target, mask):
    """As the benchmark scores new views: no factor is fitted."""
    found = relighting.pictures(0.5 * target, target, mask, relit=False)
    inside = np.zeros((SIDE, SIDE, 1))
    inside[6:18, 8:20] = 1
    black = target * inside
    black *= images.srgb_encode(black.clip(0, 1)).mean() / black.clip(0, 1).mean()
    mse = np.mean((black.clip(0, 4) - (black / 2).clip(0, 4)) ** 2)
    assert found["psnr_h"] == pytest.approx(-10 * np.log10(mse))
    assert relighting.pictures(target, target, mask, relit=False)["psnr_l"] == np.inf


def test_by_hand(target, mask, rng):
    """Pixel by pixel, as the benchmark's script has it."""
    image, inside = target * rng.uniform(0.7, 1.3, target.shape), np.zeros((SIDE, SIDE))
    image[9, 9], target[9, 9] = 25.0, 30.0  # a highlight
    inside[6:18, 8:20] = 1
    scaled = image * inside[..., None]
    black = target * inside[..., None]
    for c in range(3):
        scaled[..., c] *= (black[..., c] * scaled[..., c]).sum() / (scaled[..., c] ** 2).sum()
    gain = images.srgb_encode(black.clip(0, 1)).mean() / black.clip(0, 1).mean()
    mse = ((scaled * gain).clip(0, 4) - (black * gain).clip(0, 4)) ** 2
    found = relighting.pictures(image, target, mask)
    assert found["psnr_h"] == pytest.approx(-10 * np.log10(mse.mean()))
    a, b = (images.srgb_encode(each.clip(0, 1)) for each in (scaled, black))
    assert found["psnr_l"] == pytest.approx(-10 * np.log10(((a - b) ** 2).mean()))
    mse = (scaled.clip(0, 1) - black.clip(0, 1)) ** 2
    assert relighting.albedo(image, target, mask)["psnr"] == pytest.approx(
        -10 * np.log10(mse.mean())
    )
    weight = np.exp(-np.array([1, 0, 1]) / (2 * 1.5**2))
    weight = np.outer(weight, weight) / weight.sum() ** 2
    every = []
    for c in range(3):
        x, y = (np.pad(each[..., c], 1, mode="reflect") for each in (a, b))
        for row in range(SIDE):
            for column in range(SIDE):
                p, q = x[row : row + 3, column : column + 3], y[row : row + 3, column : column + 3]
                mp, mq = (weight * p).sum(), (weight * q).sum()
                vp, vq = (weight * p * p).sum() - mp**2, (weight * q * q).sum() - mq**2
                vpq = (weight * p * q).sum() - mp * mq
                above = (2 * mp * mq + 1e-4) * (2 * vpq + 9e-4)
                every.append(above / ((mp**2 + mq**2 + 1e-4) * (vp + vq + 9e-4)))
    assert found["ssim"] == pytest.approx(np.mean(every), abs=1e-9)


def test_nothing_scores_below_grey(target, mask):
    black = relighting.pictures(np.zeros_like(target), target, mask)
    inside = np.zeros((SIDE, SIDE, 1))
    inside[6:18, 8:20] = 1
    error = np.mean((0.5 * inside - images.srgb_encode(target) * inside) ** 2)
    assert black["psnr_l"] == pytest.approx(-10 * np.log10(error))


def test_normals(mask):
    up = np.zeros((SIDE, SIDE, 3))
    up[..., 2] = 1
    tilted = np.zeros_like(up)
    tilted[..., 0], tilted[..., 2] = 3 * np.sin(np.radians(10)), 3 * np.cos(np.radians(10))
    tilted[0] = np.nan  # outside
    found = relighting.normals(tilted, up, mask)
    assert found["degrees"] == pytest.approx(10, abs=0.01)
    assert found["normals"] == pytest.approx(1 - np.cos(np.radians(10)), abs=1e-5)


def test_chamfer_is_of_squares():
    balls = [trimesh.creation.icosphere(4, radius) for radius in (1.0, 1.2)]
    a, b = (Sampled.of(np.array(each.vertices), np.array(each.faces)) for each in balls)
    assert relighting.chamfer(a, b) == pytest.approx(0.04, rel=0.05)
    assert relighting.chamfer(a, b) == pytest.approx(relighting.chamfer(b, a))


@pytest.fixture
def files(tmp_path, target, mask):
    """A set of three views, of which one's mask is its alpha."""
    (tmp_path / "test").mkdir()
    (tmp_path / "mine").mkdir()
    frames = []
    for number in range(3):
        name = f"test/{number:03d}"
        frame = {"file_path": name, "transform_matrix": np.eye(4).tolist()}
        if number:
            images.write_exr(tmp_path / f"{name}.exr", target, [*"RGB"], {})
            encoded = np.repeat(images.to_display(mask)[..., None], 3, axis=2)
            images.write_png(tmp_path / f"mask_{number}.png", encoded)
            frame["mask_path"] = f"mask_{number}.png"
        else:
            pixels = np.dstack([images.to_display(target), images.to_display(mask)])
            images.write_png(tmp_path / f"{name}.png", pixels)
        frames.append(frame)
        worse = target + 0.05 * number * np.sin(np.arange(SIDE))[:, None, None]
        images.write_exr(tmp_path / f"mine/{number:03d}.exr", worse, [*"RGB"], {})
    text = json.dumps({"camera_angle_x": 0.7, "frames": frames})
    (tmp_path / "transforms_novel.json").write_text(text)
    return tmp_path


def test_a_set_is_read_as_it_lies(files, target, mask):
    found = relighting.of_set(str(files / "transforms_novel.json"), str(files / "mine"))
    views = found["views"]
    assert list(views) == ["test/000", "test/001", "test/002"]
    assert views["test/000"]["psnr_l"] > 45 > views["test/001"]["psnr_l"]
    worse = images.read(files / "mine/002.exr")
    assert views["test/002"] == pytest.approx(
        relighting.pictures(worse, images.read(files / "test/001.exr"), mask)
    )
    assert found["mean"]["ssim"] == pytest.approx(np.mean([v["ssim"] for v in views.values()]))


def test_a_set_of_other_scenes_has_pictures_of_the_same_names(tmp_path, target, mask):
    """As Stanford-ORB lays them out, with pictures twice as large as renderings."""
    frames = []
    for number, scene in enumerate(("cup_scene001", "cup_scene003")):
        for name in ("test", "test_mask"):
            (tmp_path / scene / name).mkdir(parents=True)
        large = np.kron(target + 0.1 * number, np.ones((2, 2, 1)))
        images.write_exr(tmp_path / scene / "test/0004.exr", large, [*"RGB"], {})
        outline = np.repeat(images.to_display(np.kron(mask, np.ones((2, 2))))[..., None], 3, 2)
        images.write_png(tmp_path / scene / "test_mask/0004.png", outline)
        frames.append({"file_path": "test/0004", "scene_name": scene})
        (tmp_path / "mine" / scene / "test").mkdir(parents=True)
        images.write_exr(tmp_path / "mine" / scene / "test/0004.exr", 2 * target, [*"RGB"], {})
    novel = tmp_path / "cup_scene001/transforms_novel.json"
    novel.write_text(json.dumps({"frames": frames}))
    views = relighting.of_set(novel, tmp_path / "mine")["views"]
    assert list(views) == ["cup_scene001/test/0004", "cup_scene003/test/0004"]
    first, second = views.values()
    assert first["psnr_h"] > 100 and second == pytest.approx(
        relighting.pictures(target, target + 0.1, mask), rel=1e-4
    )


def test_what_is_missing_is_one_line(files, target, mask):
    novel, mine = files / "transforms_novel.json", files / "mine"
    images.write_exr(mine / "002.exr", target[1:], [*"RGB"], {})
    with pytest.raises(InputError, match="frame 2: 24 × 23 rendered, which does not go into"):
        relighting.of_set(novel, mine)
    (mine / "002.exr").unlink()
    with pytest.raises(InputError, match="no rendering of test/002, such as 002.exr"):
        relighting.of_set(novel, mine)
    with pytest.raises(InputError, match="nothing is left of its mask"):
        relighting.pictures(target, target, 0 * mask)


def test_no_number_counts_inside_a_mask_alone(files, target):
    novel, mine, broken = files / "transforms_novel.json", files / "mine", target.copy()
    broken[0, 0] = np.nan
    before = relighting.of_set(novel, mine)
    images.write_exr(files / "test/001.exr", broken, [*"RGB"], {})
    assert relighting.of_set(novel, mine) == before
    broken[10, 10, 1] = np.inf
    images.write_exr(files / "test/001.exr", broken, [*"RGB"], {})
    with pytest.raises(InputError, match="frame 1: 1 pixels are NaN or infinite"):
        relighting.of_set(novel, mine)


def test_a_picture_that_was_cut_off_at_white_asks_for_no_highlights(files, target, mask):
    """A rendering that has them is perfect, but for its brightness; of the picture's no PSNR-H is
    told, nor a factor where all of it is white."""
    target[8:12, 10:14] = 20
    pixels = np.dstack([images.to_display(target), images.to_display(mask)])
    images.write_png(files / "test/000.png", pixels)
    images.write_exr(files / "mine/000.exr", 2 * target, [*"RGB"], {})
    found = relighting.of_set(files / "transforms_novel.json", files / "mine")
    views = found["views"]
    assert views["test/000"]["psnr_h"] is None
    assert views["test/000"]["psnr_l"] > 45 and views["test/000"]["ssim"] > 0.99
    others = [views[f"test/{number:03d}"]["psnr_h"] for number in (1, 2)]
    assert found["mean"]["psnr_h"] == pytest.approx(np.mean(others))
    with pytest.raises(relighting.Nothing, match="is white, which tells no factor"):
        relighting.pictures(target, target, mask, white=np.ones(mask.shape, bool))


def test_a_target_in_another_unit_is_told(target, mask):
    for unit, told in ((1e-3, False), (1, True), (1e3, False)):
        found = relighting.pictures(target, unit * target, mask)
        assert found["in_range"] is told


def test_a_rendering_with_no_number_inside_its_mask_is_none(tmp_path, target, mask):
    images.write_exr(tmp_path / "a.exr", target, [*"RGB"], {})
    images.write_png(tmp_path / "mask.png", images.to_display(np.dstack([mask] * 3)))
    camera = Camera("a", tmp_path / "a.exr", SIDE, SIDE, 20.0, 20.0, 12.0, 12.0, np.eye(4))
    image = target.astype(np.float32)
    told = camera, camera, tmp_path / "mask.png", "view a", False, True
    image[0, 10, 1] = np.nan
    assert relighting.of_picture(image, *told)["psnr_h"] > 100
    image[10, 10, 1] = np.nan
    with pytest.raises(relighting.Nothing, match="view a: its rendering has pixels that are no"):
        relighting.of_picture(image, *told)
