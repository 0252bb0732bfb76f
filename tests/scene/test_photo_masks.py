"""Masks under the names that people give them."""

import shutil

import numpy as np
import photo_sets
import pytest
from isas_cli.scenes import library
from photo_sets import POSES, SIZE, Files
from PIL import Image
from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter

from isas_cli.config.schema import PhotosConfig
from isas_cli.runtime import images
from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos import importing, photographs, rims


@pytest.fixture
def taken(tmp_path):
    """A set with images/000.png …, and what is loaded of it."""
    content = photo_sets.transforms(Files(tmp_path, POSES))
    (tmp_path / "images").mkdir()
    for number, frame in enumerate(content["frames"]):
        (tmp_path / f"view_{number}.exr").rename(tmp_path / f"images/{number:03d}.exr")
        frame["file_path"] = f"images/{number:03d}.exr"
    photo_sets.write(tmp_path / "transforms.json", content)

    def load(**settings) -> photographs.Photographs:
        asked = PhotosConfig(path=str(tmp_path), sphere=[0.0, 0.0, 0.0, 0.5], **settings)
        return photographs.load(asked)

    return load


def mask(path) -> None:
    """Black above; told by its first rows."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.full((SIZE[1], SIZE[0], 1), 255, np.uint8)
    pixels[:8] = 0
    made = path.with_name("made.png")
    images.write_png(made, pixels)
    if path.suffix in (".jpg", ".jpeg"):
        from PIL import Image

        Image.open(made).save(path, quality=100)
        made.unlink()
    else:
        made.rename(path)


@pytest.mark.parametrize(
    "name",
    [
        "masks/{0}.png",
        "masks/{0}.jpg",
        "masks/{0}.PNG",
        "masks/{0}.exr.png",
        "masks/{0}_mask.png",
        "masks/images/{0}.png",
        "mask/{0}.png",
        "images_masks/{0}.png",
        "images_mask/{0}.png",
        "images/masks/{0}.png",
        "images/{0}_mask.png",
        "images/{0}.mask.png",
        "images/{0}-mask.jpg",
        "images/mask_{0}.png",
        "images/{0}.exr.mask",
        "images/{0}.exr.mask.png",
        "images/{0}.alpha.png",
        "images/{0}.exr.alpha.png",
    ],
)
def test_usual_names(tmp_path, taken, name):
    for number in range(3):
        mask(tmp_path / name.format(f"{number:03d}"))
    found = taken()
    assert found.warnings == []
    for each in found.shown:
        assert each.lost["masked by its file"] == 8 * SIZE[0], name
        assert not each.mask[:8].any() and each.mask[8:].all()
    assert taken(masks="none").shown[0].mask.all()


def test_of_colmap(tmp_path):
    photo_sets.colmap(Files(tmp_path, POSES))
    for number in range(3):
        mask(tmp_path / f"masks/view_{number}.jpg")
    found = photographs.load(PhotosConfig(path=str(tmp_path), sphere=[0.0, 0.0, 0.0, 0.5]))
    assert all(not each.mask[:8].any() for each in found.shown)


def test_masks_of_distorted_pictures_are_not_those_of_undistorted_ones(tmp_path):
    """COLMAP's image_undistorter makes pictures of the same names, and no masks."""
    dense = tmp_path / "dense"
    (dense / "stereo").mkdir(parents=True)
    photo_sets.colmap(Files(dense, POSES))
    asked = PhotosConfig(path=str(tmp_path), cameras="dense", sphere=[0.0, 0.0, 0.0, 0.5])
    for number in range(3):
        mask(tmp_path / f"masks/view_{number}.jpg")
    found = photographs.load(asked)
    assert all(each.mask.all() for each in found.shown)
    (told,) = [line for line in found.warnings if "looks like masks" in line]
    assert "before they were undistorted" in told and f"belong in {dense / 'masks'}" in told
    (tmp_path / "masks").rename(dense / "masks")
    found = photographs.load(asked)
    assert found.warnings == [] and all(not each.mask[:8].any() for each in found.shown)


def test_a_folder_that_fits_nothing_is_told(tmp_path, taken):
    for name in ("a.png", "b.png", "c.png"):
        mask(tmp_path / "object_masks" / name)
    found = taken()
    assert all(each.mask.all() for each in found.shown)
    (told,) = found.warnings
    assert "object_masks looks like masks" in told and "000.png" in told and "\n" not in told
    assert taken(masks="none").warnings == []
    with pytest.raises(InputError, match="photos.masks=.*object_masks: no file there is named"):
        taken(masks="object_masks")


def test_a_folder_below_that_of_masks_is_told_as_well(tmp_path, taken):
    for name in ("person", "background"):
        mask(tmp_path / f"masks/{name}/0.png")
    told = [line for line in taken().warnings if "looks like masks" in line]
    assert len(told) == 2 and "person" in told[1]


def test_some_without(tmp_path, taken):
    for number in range(2):
        mask(tmp_path / f"masks/{number:03d}.png")
    found = taken()
    (told,) = found.warnings
    assert "1 of 3 views have no mask, first images/002.exr" in told


def test_a_folder_that_is_given(tmp_path, taken):
    for number in range(3):
        mask(tmp_path / f"cut/out/{number:03d}.png")
    assert taken().shown[0].mask.all()
    found = taken(masks="cut/out")
    assert found.warnings == [] and not found.shown[2].mask[:8].any()
    with pytest.raises(InputError, match="photos.masks=gone: no such folder.*photos.masks=none"):
        taken(masks="gone")


def test_one_that_would_be_of_two_pictures_is_of_none(tmp_path):
    content = photo_sets.transforms(Files(tmp_path, POSES))
    for number, (frame, folder) in enumerate(zip(content["frames"], ("a", "b", "c"))):
        (tmp_path / "images" / folder).mkdir(parents=True)
        name = f"images/{folder}/0.exr"
        (tmp_path / f"view_{number}.exr").rename(tmp_path / name)
        frame["file_path"] = name
    photo_sets.write(tmp_path / "transforms.json", content)
    asked = PhotosConfig(path=str(tmp_path), sphere=[0.0, 0.0, 0.0, 0.5])
    mask(tmp_path / "masks/0.png")
    found = photographs.load(asked)
    assert all(each.mask.all() for each in found.shown)
    assert "masks/0.png would be that of 3 pictures" in found.warnings[0]
    for folder in "abc":
        mask(tmp_path / f"masks/{folder}/0.png")
    (tmp_path / "masks/0.png").unlink()
    assert not photographs.load(asked).shown[1].mask[:8].any()


def test_what_the_file_names_stands_first(tmp_path, taken):
    mask(tmp_path / "masks/000.png")
    images.write_png(tmp_path / "own.png", np.full((SIZE[1], SIZE[0], 1), 255, np.uint8))
    import json

    content = json.loads((tmp_path / "transforms.json").read_text())
    for frame in content["frames"]:
        frame["mask_path"] = "own.png"
    photo_sets.write(tmp_path / "transforms.json", content)
    assert all(each.mask.all() for each in taken().shown)
    content["frames"][1]["mask_path"] = "gone.png"
    photo_sets.write(tmp_path / "transforms.json", content)
    with pytest.raises(InputError, match="gone.png does not exist.*photos.masks="):
        taken()
    assert taken(masks="none").shown[0].mask.all()


def test_labels_are_no_weights(tmp_path, taken):
    """A program's label stands for white, so that its view counts as much as the others; of several
    labels nothing says which is the object."""
    for number, label in enumerate((255, 3, 128)):
        path = tmp_path / f"masks/{number:03d}.png"
        mask(path)
        pixels = np.full((SIZE[1], SIZE[0], 1), label, np.uint8)
        pixels[:8] = 0
        images.write_png(path, pixels)
    found = taken()
    assert found.warnings == []
    for each in found.shown:
        assert not each.mask[:8].any() and (each.mask[8:] == 1).all()
    pixels[20:] = 2
    pixels[8:20] = 1
    images.write_png(path, pixels)
    (told,) = taken().warnings
    assert "the masks of 1 of 3 pictures" in told and "masks/002.png" in told and "labels" in told


def test_what_the_object_fills_is_resampled_once(tmp_path, taken, monkeypatch):
    for number in range(3):
        mask(tmp_path / f"masks/{number:03d}.png")
    first = taken(background="black", width=SIZE[0] // 2).shown[0].part
    monkeypatch.setattr(importing, "_noise_kept", lambda *_: 1.0)
    monkeypatch.setattr(importing, "resample", lambda *_: pytest.fail("resampled again"))
    again = taken(background="black", width=SIZE[0] // 2).shown[0].part
    np.testing.assert_array_equal(again, first)


def test_white_of_a_dynamic_mask_does_not_count(tmp_path, taken):
    """As instant-ngp has it; where the object ends it does not say."""
    for number in range(3):
        pixels = np.zeros((SIZE[1], SIZE[0], 1), np.uint8)
        pixels[:8] = 90
        images.write_png(tmp_path / f"images/dynamic_mask_{number:03d}.png", pixels)
    for each in taken().shown:
        assert not each.mask[:8].any() and (each.mask[8:] == 1).all()
        assert each.white is None
    with pytest.raises(InputError, match="has neither alpha nor a mask"):
        taken(background="black")


def test_more_masks_than_are_needed_are_not_doubted(tmp_path, taken):
    """nerfstudio keeps smaller ones beside them, Stanford-ORB those of views that are held out."""
    for number in range(3):
        for folder in ("masks", "masks_2", "test_mask"):
            mask(tmp_path / folder / f"{number:03d}.png")
    assert taken().warnings == []


@pytest.mark.parametrize("background", [False, "black"])
def test_no_number_where_a_mask_hides_it_is_none(tmp_path, taken, background):
    """It counts nowhere, nor beside it where pixels are made smaller; elsewhere it is refused."""
    pixels = np.full((SIZE[1], SIZE[0], 3), 0.4, np.float32)
    pixels[:4], pixels[2, 7] = np.nan, np.inf
    for number in range(3):
        mask(tmp_path / f"masks/{number:03d}.png")
        images.write_exr(tmp_path / f"images/{number:03d}.exr", pixels, [*"RGB"], {})
    for width, hidden in ((None, 8), (SIZE[0] // 2, 4)):
        for each in taken(background=background, width=width).shown:
            assert np.isfinite(each.image).all() and each.mask[hidden + 1 :].all()
            assert not (each.mask[:hidden].any() if not background else each.image[:hidden].any())
    with pytest.raises(InputError, match="000.exr: 160 pixels are NaN or infinite; mend or mask"):
        taken(masks="none")


def test_noise_of_a_jpeg_is_no_label(tmp_path, taken, rng):
    """What a video leaves of black is more than what is white."""
    from PIL import Image

    (tmp_path / "masks").mkdir()
    for number in range(3):
        pixels = rng.integers(0, 6, SIZE[::-1], np.uint8)
        pixels[3:20, 15:33] = 252
        Image.fromarray(pixels).save(tmp_path / f"masks/{number:03d}.jpg", quality=98)
    assert taken().warnings == []
    for number in range(3):
        pixels = np.zeros(SIZE[::-1], np.uint8)
        pixels[:, 10:20], pixels[:, 20:30] = 10, 16
        Image.fromarray(pixels).save(tmp_path / f"masks/{number:03d}.jpg", quality=98)
    assert "labels" in taken().warnings[0]


@pytest.mark.parametrize("wide, said", [(1, False), (4, True)])
def test_a_band_of_middle_grey_is_told(tmp_path, taken, wide, said):
    """Trimaps have one where nobody knows what is the object; a soft edge is thinner."""
    for number in range(3):
        pixels = np.zeros((*SIZE[::-1], 1), np.uint8)
        pixels[8 - wide : 22 + wide, 12 - wide : 28 + wide] = 128
        pixels[8:22, 12:28] = 255
        (tmp_path / "masks").mkdir(exist_ok=True)
        images.write_png(tmp_path / f"masks/{number:03d}.png", pixels)
    told = [line for line in taken().warnings if "trimaps" in line]
    assert len(told) == said and ("masks/000.png" in told[0] if said else True)


@pytest.mark.parametrize("grown", [-4, 0, 3])
def test_masks_that_end_beside_the_object_are_told(tmp_path, quick, grown):
    """Of real photographs."""
    shutil.copytree(library.ASSETS / "head", tmp_path / "head")
    for path in (tmp_path / "head/mask").iterdir():
        white = np.array(Image.open(path).convert("L")) > 127
        change = binary_dilation if grown > 0 else binary_erosion
        white = change(white, np.ones((3, 3)), iterations=abs(grown)) if grown else white
        Image.fromarray(np.uint8(white) * 255).save(path)
    taken = photographs.load(PhotosConfig(path=str(tmp_path / "head")))
    told = [each for each in taken.warnings if "the edges that pictures show" in each]
    assert len(told) == bool(grown), told
    if grown:
        assert ("beyond" in told[0]) == (grown > 0) and ("shrink" in told[0]) == (grown > 0)


def test_where_a_mask_ends_beside_an_edge_is_measured(rng):
    """Of a spotted disk before clutter."""
    down, across = np.mgrid[:200, :240]
    away = np.hypot(down - 100, across - 120)
    noise = gaussian_filter(rng.normal(size=(200, 240)), 3)
    picture = np.where(away < 50, 0.6, 0.3) + 0.5 * noise
    picture = np.repeat(picture[..., None], 3, axis=2).astype(np.float32)
    for more in (-6, -3, 0, 2, 5):
        assert rims.off(picture, away < 50 + more) == pytest.approx(more, abs=1)
    assert rims.off(picture, away < 130) is None  # which no picture holds


@pytest.mark.parametrize("views, told", [(0, False), (2, True), (8, False)])
def test_holes_that_few_masks_have_are_told(tmp_path, quick, views, told):
    """Those of most are the object's own."""
    shutil.copytree(library.ASSETS / "head", tmp_path / "head")
    for path in sorted((tmp_path / "head/mask").iterdir())[:views]:
        white = np.array(Image.open(path).convert("L")) > 127
        row, column = np.argwhere(white).mean(axis=0).astype(int)
        white[row - 8 : row + 8, column - 8 : column + 8] = False
        Image.fromarray(np.uint8(white) * 255).save(path)
    taken = photographs.load(PhotosConfig(path=str(tmp_path / "head"), voxels=40))
    said = [each for each in taken.warnings if "have holes within the object" in each]
    assert bool(said) == told and all(f"of {views} of 13" in each for each in said)
