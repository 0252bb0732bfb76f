"""Photographs at import: lens, square pixels, size, and which pixels count."""

from pathlib import Path

import numpy as np
import photo_sets
import pytest
from photo_sets import POSES, SIZE, Files
from test_photo_cameras import lens

from isas_cli.config.schema import PhotosConfig
from isas_cli.runtime import images
from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos import importing, photographs


def blobs(camera, points: np.ndarray) -> np.ndarray:
    """A picture with a bright spot where the camera, lens and all, sees each point."""
    rows, columns = np.indices((camera.height, camera.width)) + 0.5
    picture = np.zeros((camera.height, camera.width))
    for x, y in camera.project(points)[0]:
        picture += np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 1.5**2))
    return np.repeat(picture[..., None], 3, axis=2).astype(np.float32)


def centre_of(picture: np.ndarray, near: np.ndarray, reach: float = 5) -> np.ndarray:
    rows, columns = np.indices(picture.shape) + 0.5
    weight = picture * (np.hypot(columns - near[0], rows - near[1]) < reach)
    return np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()


@pytest.mark.parametrize("width", [160, 120])
def test_without_a_lens_points_are_where_a_pinhole_sees_them(width):
    """A strong barrel, unequal focal lengths and an offset: spots are found within a tenth of a
    pixel; without undistortion they lie pixels off."""
    camera = lens(
        **dict(width=160, height=120, fx=150.0, fy=165.0, cx=85.0, cy=52.0),
        radial=(-0.3, 0.08, 0.0, 0.0),
        tangential=(0.004, -0.003),
    )
    points = np.array([[0.0, 0.0, 1], [-0.38, -0.2, 1], [0.32, 0.25, 1], [-0.3, 0.28, 1]])
    target = camera.pinhole(width)
    assert target.ideal and target.fx == target.fy
    picture = blobs(camera, points)
    whole = np.ones(picture.shape[:2], np.float32)
    made, _ = importing.resample(camera, target, picture, whole)
    wanted, _ = target.project(points)
    bent = camera.project(points)[0] * width / 160
    assert np.linalg.norm(bent - wanted, axis=1).max() > 4
    for place in wanted:
        assert np.linalg.norm(centre_of(made[..., 0], place) - place) < 0.1


def test_what_a_lens_bends_out_of_the_picture_does_not_count():
    camera = lens(radial=(0.3, 0, 0, 0), tangential=(0.0, 0.0))  # a pincushion
    grey = np.ones((SIZE[1], SIZE[0], 3), np.float32)
    made, mask = importing.resample(camera, camera.pinhole(), grey, np.ones(SIZE[::-1], np.float32))
    assert mask[0, 0] == mask[-1, -1] == 0 and mask[15, 20] == 1
    np.testing.assert_allclose(made[mask > 0], 1, atol=1e-6)


def test_a_polynomial_that_folds_back_shows_nothing_twice():
    camera = lens(fx=8.0, fy=8.0, radial=(-0.3, 0, 0, 0), tangential=(0.0, 0.0))
    assert camera.lens.reach == pytest.approx(np.sqrt(1 / 0.9))
    grey = np.ones((SIZE[1], SIZE[0], 3), np.float32)
    _, mask = importing.resample(camera, camera.pinhole(), grey, np.ones(SIZE[::-1], np.float32))
    rows, columns = np.indices(mask.shape) + 0.5
    beyond = np.hypot(columns - camera.cx, rows - camera.cy) / 8 > camera.lens.reach
    assert beyond.any() and not mask[beyond].any()


def test_a_picture_as_it_is_stays_as_it_is():
    camera = lens(radial=(0.0,) * 4, tangential=(0.0, 0.0))
    noise = np.random.default_rng(1).random((SIZE[1], SIZE[0], 3)).astype(np.float32)
    whole = np.ones(SIZE[::-1], np.float32)
    made, mask = importing.resample(camera, camera.pinhole(), noise, whole)
    np.testing.assert_allclose(made, noise, atol=1e-6)
    assert mask.all()


def test_smaller_pixels_are_means_of_larger_ones():
    camera = lens(radial=(0.0,) * 4, tangential=(0.0, 0.0))
    noise = np.random.default_rng(2).random((SIZE[1], SIZE[0], 3)).astype(np.float32)
    made, _ = importing.resample(camera, camera.pinhole(10), noise, np.ones(SIZE[::-1], np.float32))
    blocks = noise[:28].reshape(7, 4, 10, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(made[:7], blocks, atol=1e-6)


def loaded(folder, **settings):
    shown = PhotosConfig(path=str(folder), sphere=[0.0, 0.0, 0.0, 0.5], **settings)
    return photographs.load(shown).shown


def test_masks_alpha_and_saturation(tmp_path):
    content = photo_sets.transforms(Files(tmp_path, POSES))
    import OpenImageIO as oiio

    pixels = np.full((SIZE[1], SIZE[0], 4), 128, np.uint8)
    pixels[..., 3] = 255
    pixels[:, :5, 3] = 200  # half seen through
    pixels[:3, :, 1] = 254  # of 255: nearly full
    spec = oiio.ImageSpec(SIZE[0], SIZE[1], 4, oiio.UINT8)
    file = oiio.ImageOutput.create("png")
    file.open(str(tmp_path / "view_0.png"), spec)
    file.write_image(pixels)
    file.close()
    mask = np.full((SIZE[1], SIZE[0], 1), 255, np.uint8)
    mask[-4:] = 0
    images.write_png(tmp_path / "mask.png", mask)
    content["frames"][0].update(file_path="view_0.png", mask_path="mask.png")
    photo_sets.write(tmp_path / "transforms.json", content)

    first = loaded(tmp_path)[0]
    wanted = np.ones(SIZE[::-1])
    wanted[-4:], wanted[:, :5], wanted[:3] = 0, 0, 0
    np.testing.assert_array_equal(first.mask, wanted)
    assert first.lost == {"masked by its file": 160, "transparent": 150, "saturated": 120}
    wanted_grey = images.srgb_decode(np.float64(128 / 255))
    np.testing.assert_allclose(first.image[15, 20], wanted_grey, rtol=1e-5)
    assert loaded(tmp_path, saturated=None)[0].mask[:3, 5:].all()
    # What is too bright for a colour has edges all the same.
    edged = loaded(tmp_path, edges=True, background=False)[0].edged
    wanted_edged = wanted.copy()
    wanted_edged[:3, 5:] = 1
    np.testing.assert_array_equal(edged, wanted_edged)
    linear = loaded(tmp_path, encoding="linear")[0]
    np.testing.assert_allclose(linear.image[15, 20], 128 / 255, rtol=1e-6)
    np.testing.assert_array_equal(linear.mask, wanted)


def test_saturated_is_what_the_file_says_whatever_the_exposure(tmp_path):
    picture = np.full((SIZE[1], SIZE[0], 3), 0.6, np.float32)
    picture[:3] = 1
    content = photo_sets.ours(Files(tmp_path, POSES, [picture] * len(POSES)))
    content["views"][0]["exposure"], content["views"][1]["exposure"] = 4, [0.5] * 3
    photo_sets.write(tmp_path / "cameras.json", content)
    for photograph, exposure in zip(loaded(tmp_path), (4, 0.5, 1)):
        assert photograph.lost == {"saturated": 120}
        np.testing.assert_allclose(photograph.image[15, 20], 0.6, rtol=0.01)
        assert photograph.camera.exposure == (exposure,) * 3


def test_raw_files_are_full_in_light():
    """Not at 0.99, as an sRGB file is, whose 0.995 is 0.989 of light."""
    grey = np.full((1, 1, 3), 0.99, np.float32)
    raw, nearly = lens(image=Path("a.NEF")), images.Picture(grey, grey[..., 0], None, grey)
    for encoding in ("auto", "linear"):
        settings = PhotosConfig(encoding=encoding)
        assert importing._mask(raw, nearly, None, settings, None, None)[0].all()
    with pytest.raises(InputError, match="encoding=srgb: a.NEF is a camera raw file"):
        importing.load(raw, PhotosConfig(encoding="srgb"))


@pytest.mark.parametrize("ruin", ["size", "zeros", "saturated", "mask size", "nan"])
def test_a_photograph_that_cannot_be_used(tmp_path, ruin):
    content = photo_sets.transforms(Files(tmp_path, POSES))
    frame, told = content["frames"][1], "no pixel counts"
    grey = np.full((SIZE[1], SIZE[0], 3), 100, np.uint8)
    if ruin == "size":
        images.write_png(tmp_path / "bad.png", grey[:-2])
        told = r"bad.png is 40×28 pixels, its camera 40×30"
    elif ruin == "saturated":
        images.write_png(tmp_path / "bad.png", grey + 155)
        told = r"bad.png: no pixel counts \(1200 saturated\)"
    elif ruin == "nan":
        broken = np.full((SIZE[1], SIZE[0], 3), np.nan, np.float32)
        images.write_exr(tmp_path / "bad.exr", broken, ["R", "G", "B"], {})
        told = "bad.exr: 1200 pixels are NaN"
    else:
        images.write_png(tmp_path / "bad.png", grey)
        mask = np.zeros((SIZE[1] - (ruin == "mask size"), SIZE[0], 1), np.uint8)
        images.write_png(tmp_path / "mask.png", mask)
        frame["mask_path"] = "mask.png"
        told = "mask.*is 40×29" if ruin == "mask size" else r"\(1200 masked by its file\)"
    frame["file_path"] = "bad"
    photo_sets.write(tmp_path / "transforms.json", content)
    with pytest.raises(InputError, match=told) as error:
        loaded(tmp_path)
    assert "\n" not in str(error.value)


def test_what_was_resampled_is_kept_by_what_it_holds(tmp_path, monkeypatch):
    photo_sets.transforms(Files(tmp_path, POSES), k1=0.1)
    first = loaded(tmp_path)[0].image
    monkeypatch.setattr(importing, "resample", lambda *_: pytest.fail("resampled again"))
    np.testing.assert_array_equal(loaded(tmp_path)[0].image, first)
    brighter = [np.full((SIZE[1], SIZE[0], 3), 0.6, np.float32)] * len(POSES)
    photo_sets.transforms(Files(tmp_path, POSES, brighter), k1=0.1)
    with pytest.raises(pytest.fail.Exception):
        loaded(tmp_path)


def test_a_width_of_which_no_pixel_counts_is_named(tmp_path):
    """Pixels that masks take a bit of do not count; of one alone that is all."""
    content = photo_sets.transforms(Files(tmp_path, POSES))
    mask = np.full((SIZE[1], SIZE[0], 1), 255, np.uint8)
    mask[:2] = 0
    images.write_png(tmp_path / "mask.png", mask)
    for frame in content["frames"]:
        frame["mask_path"] = "mask.png"
    photo_sets.write(tmp_path / "transforms.json", content)
    with pytest.raises(InputError, match="photos.width=1: .*view_0.exr has no pixel .* 40 pixels"):
        loaded(tmp_path, width=1)
    mask[:] = 0
    images.write_png(tmp_path / "mask.png", mask)
    with pytest.raises(InputError, match="no pixel counts .1200 masked by its file"):
        loaded(tmp_path, width=1)


def test_what_is_smaller_than_was_asked_for_is_not_enlarged(tmp_path):
    photo_sets.transforms(Files(tmp_path, POSES))
    for wide, found in zip(loaded(tmp_path, width=3 * SIZE[0]), loaded(tmp_path)):
        assert (wide.camera.width, wide.camera.height) == SIZE
        np.testing.assert_array_equal(wide.image, found.image)
