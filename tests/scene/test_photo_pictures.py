"""Pictures as people have them: turned, resized, missing, elsewhere, of other colours."""

from unicodedata import normalize

import numpy as np
import OpenImageIO as oiio
import photo_sets
import pytest
from icc import P3, light, profile
from photo_sets import POSES, SIZE, Files
from PIL import Image

from isas_cli.config.schema import PhotosConfig
from isas_cli.runtime import images
from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos import finding, material, photographs, reading, turns

# Stored pixels of each orientation, of an upright picture.
STORED = {3: lambda a: a[::-1, ::-1], 6: lambda a: np.rot90(a, 1), 8: lambda a: np.rot90(a, -1)}
RAMP = np.tile(np.linspace(0.2, 0.7, SIZE[0], dtype=np.float32), (SIZE[1], 1))
RAMP = np.stack([RAMP, RAMP * 0.5, np.linspace(0.1, 0.9, SIZE[1])[:, None] + 0 * RAMP], axis=2)


def loaded(folder, **settings) -> photographs.Photographs:
    return photographs.load(PhotosConfig(path=str(folder), sphere=[0.0, 0.0, 0.0, 0.5], **settings))


def save(path, picture: np.ndarray, orientation: int = 1, **more) -> None:
    exif = Image.Exif()
    exif[0x112] = orientation
    pixels = Image.fromarray(images.to_display(picture))
    pixels.save(path, exif=exif, quality=100, subsampling=0, **more)


def listed(folder, form: str, files: list[str], size=SIZE) -> None:
    """A set of the pictures ``files``, of cameras of that size."""
    poses = POSES[: len(files)]
    if form == "colmap":
        photo_sets.colmap(Files(folder, poses))
        sparse = folder / "sparse/0"
        text = (sparse / "images.txt").read_text()
        for number, file in enumerate(files):
            (folder / "images" / f"view_{number}.png").unlink()
            text = text.replace(f"view_{number}.png", f"../{file}")
        (sparse / "images.txt").write_text(text)
        lens = (sparse / "cameras.txt").read_text()
        lens = lens.replace(f" {SIZE[0]} {SIZE[1]} ", f" {size[0]} {size[1]} ")
        (sparse / "cameras.txt").write_text(lens)
        return
    content = getattr(photo_sets, form)(Files(folder, poses))
    entries, name = ("frames", "file_path") if form == "transforms" else ("views", "image")
    for entry, file in zip(content[entries], files):
        entry[name] = file
    width, height = ("w", "h") if form == "transforms" else ("width", "height")
    content[width], content[height] = size
    photo_sets.write(
        folder / f"{'transforms' if form == 'transforms' else 'cameras'}.json", content
    )


def likeness(found: np.ndarray, wanted: np.ndarray) -> bool:
    return found.shape == wanted.shape and np.abs(found - wanted).max() < 0.05


@pytest.mark.parametrize("orientation", [3, 6, 8])
@pytest.mark.parametrize("form", ["colmap", "transforms"])
def test_cameras_of_stored_pixels(tmp_path, form, orientation):
    """As they lie in the file, whatever their tag says; said or not, the same."""
    for number in range(2):
        save(tmp_path / f"{number}.jpg", RAMP, orientation if number else 1)
    listed(tmp_path, form, ["0.jpg", "1.jpg"])
    for asked in ("auto", "stored"):
        taken = loaded(tmp_path, orientation=asked)
        assert taken.warnings == []
        assert all(likeness(each.image, RAMP) for each in taken.shown)
    if orientation == 3:
        over = loaded(tmp_path, orientation="turned").shown
        assert likeness(over[0].image, RAMP) and likeness(over[1].image, RAMP[::-1, ::-1])
    else:
        with pytest.raises(InputError, match="1.jpg is 30×40 pixels, its camera 40×30"):
            loaded(tmp_path, orientation="turned")


@pytest.mark.parametrize("orientation", [0, 9])
def test_a_tag_that_stands_for_no_turn_is_upright(tmp_path, orientation):
    """Cameras and scanners write 0, which OpenCV takes as upright."""
    for number in range(2):
        save(tmp_path / f"{number}.jpg", RAMP, orientation)
    listed(tmp_path, "ours", ["0.jpg", "1.jpg"])
    for asked in ("auto", "turned"):
        taken = loaded(tmp_path, orientation=asked)
        assert taken.warnings == [] and all(likeness(each.image, RAMP) for each in taken.shown)


@pytest.mark.parametrize("form", ["colmap", "transforms", "ours"])
def test_sizes_tell_for_all_of_a_set(tmp_path, form):
    """One on edge tells what one upside down cannot."""
    save(tmp_path / "0.jpg", STORED[6](RAMP), 6)
    save(tmp_path / "1.jpg", STORED[3](RAMP), 3)
    listed(tmp_path, form, ["0.jpg", "1.jpg"])
    taken = loaded(tmp_path)
    assert taken.warnings == [] and all(likeness(each.image, RAMP) for each in taken.shown)


def test_our_own_cameras_are_of_turned_pictures_unless_sizes_tell(tmp_path):
    save(tmp_path / "0.jpg", STORED[3](RAMP), 3)
    save(tmp_path / "1.jpg", RAMP)
    listed(tmp_path, "ours", ["0.jpg", "1.jpg"])
    taken = loaded(tmp_path)
    assert likeness(taken.shown[0].image, RAMP)
    (told,) = taken.warnings
    assert "0.jpg (3)" in told and "photos.orientation=stored" in told and "\n" not in told
    stored = loaded(tmp_path, orientation="stored")
    assert stored.warnings == [] and likeness(stored.shown[0].image, STORED[3](RAMP))
    save(tmp_path / "1.jpg", RAMP, 6)  # as stored it fits its camera
    taken = loaded(tmp_path)
    assert taken.warnings == [] and likeness(taken.shown[0].image, STORED[3](RAMP))


@pytest.mark.parametrize("tagged", [False, True])
def test_masks_go_with_their_pictures(tmp_path, tagged):
    """As it is seen, or as it is stored, of a picture on edge that is read as turned."""
    save(tmp_path / "0.jpg", STORED[6](RAMP), 6)
    mask = np.ones((*SIZE[::-1], 3), np.float32)
    mask[:10] = 0
    (tmp_path / "masks").mkdir()
    for kept in (mask, STORED[6](mask)) if not tagged else (STORED[6](mask),):
        save(tmp_path / "masks/0.png", kept, 6 if tagged else 1)
        listed(tmp_path, "ours", ["0.jpg"])
        (only,) = loaded(tmp_path).shown
        assert likeness(only.image, RAMP) and not only.mask[:10].any() and only.mask[10:].all()
    # Under stored pixels a mask's own tag is no more heeded than its picture's.
    (tmp_path / "cameras.json").unlink()
    save(tmp_path / "0.jpg", RAMP, 3)
    save(tmp_path / "masks/0.png", mask, 3)
    listed(tmp_path, "transforms", ["0.jpg"])
    assert not loaded(tmp_path).shown[0].mask[:10].any()


@pytest.mark.parametrize("orientation", [6, 8])
def test_an_upright_mask_is_turned_back_to_a_picture_as_it_is_stored(tmp_path, orientation):
    """As programs write it that heed the picture's tag."""
    save(tmp_path / "0.jpg", RAMP, orientation)
    mask = np.ones((*SIZE[::-1], 3), np.float32)
    mask[:10, :5] = 0
    (tmp_path / "masks").mkdir()
    save(tmp_path / "masks/0.png", STORED[14 - orientation](mask))
    listed(tmp_path, "transforms", ["0.jpg"])
    (only,) = loaded(tmp_path).shown
    assert likeness(only.image, RAMP)
    assert not only.mask[:10, :5].any() and only.mask[10:].all() and only.mask[:, 5:].all()


@pytest.mark.parametrize("upright", [True, False])
@pytest.mark.parametrize("form", ["transforms", "ours"])
def test_masks_on_edge_tell_which_way_up_the_others_lie(tmp_path, form, upright):
    """Of a picture upside down no size tells it: as stored, or as turned, as its cameras are."""
    mask = np.ones((*SIZE[::-1], 3), np.float32)
    mask[:10, :5] = 0
    (tmp_path / "masks").mkdir()
    turned = form == "ours"
    for number, tag in enumerate((6, 3)):
        stored, over = (STORED[each] for each in (tag, {6: 8, 3: 3}[tag]))
        save(tmp_path / f"{number}.jpg", stored(RAMP) if turned else RAMP, tag)
        lies = mask if upright == turned else over(mask) if upright else stored(mask)
        save(tmp_path / f"masks/{number}.png", lies)
    listed(tmp_path, form, ["0.jpg", "1.jpg"])
    taken = loaded(tmp_path)
    assert [line for line in taken.warnings if "which way up" in line] == []
    for each in taken.shown:
        assert likeness(each.image, RAMP)
        np.testing.assert_array_equal(each.mask > 0, mask[..., 0] > 0)
    listed(tmp_path, form, ["1.jpg"])
    taken = loaded(tmp_path)
    (told,) = (line for line in taken.warnings if "which way up" in line)
    assert "1 masks" in told and "masks/1.png, their pictures have (3)" in told
    assert f"as {'turned' if turned else 'stored'}; if" in told and "\n" not in told


def test_a_profile_is_heeded_and_what_cannot_be_is_said_once(tmp_path):
    flat = np.full((*SIZE[::-1], 3), (200, 60, 90), np.uint8)
    for number in range(3):
        Image.fromarray(flat).save(tmp_path / f"{number}.png", icc_profile=profile(P3))
    listed(tmp_path, "transforms", ["0.png", "1.png", "2.png"])
    taken = loaded(tmp_path)
    np.testing.assert_allclose(taken.shown[1].image[5, 5], light(flat[0, 0] / 255, P3), atol=1e-3)
    assert taken.warnings == []
    plain = loaded(tmp_path, encoding="srgb").shown[1].image
    np.testing.assert_allclose(plain[5, 5], images.srgb_decode(flat[0, 0] / 255), rtol=1e-5)
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA001] = 0xFFFF
    for number in range(3):
        Image.fromarray(flat).save(tmp_path / f"{number}.jpg", exif=exif)
    listed(tmp_path, "transforms", ["0.jpg", "1.jpg", "2.jpg"])
    (told,) = loaded(tmp_path).warnings
    assert "of 3 pictures" in told and "0.jpg" in told and "photos.encoding=srgb" in told
    assert loaded(tmp_path, encoding="srgb").warnings == []


@pytest.mark.parametrize("form", ["colmap", "transforms", "ours"])
def test_pictures_resized_after_calibration(tmp_path, form):
    save(tmp_path / "0.png", RAMP)
    listed(tmp_path, form, ["0.png"], (2 * SIZE[0], 2 * SIZE[1]))
    with pytest.raises(InputError, match="0.png is 40×30 .* 80×60: 0.5 times .*photos.scale=auto"):
        loaded(tmp_path)
    for scale in ("auto", 0.5):
        camera = loaded(tmp_path, scale=scale).shown[0].camera
        assert (camera.width, camera.height) == SIZE
        assert camera.fx == photo_sets.FOCAL / 2
        assert (camera.cx, camera.cy) == (photo_sets.CENTRE[0] / 2, photo_sets.CENTRE[1] / 2)
    with pytest.raises(InputError, match="photos.scale=0.25, but it is 0.5 times"):
        loaded(tmp_path, scale=0.25)


def test_a_mask_that_stayed_large(tmp_path):
    save(tmp_path / "0.png", RAMP)
    mask = np.ones((60, 80, 3), np.float32)
    mask[:20] = 0
    save(tmp_path / "0_mask.png", mask)
    listed(tmp_path, "transforms", ["0.png"])
    with pytest.raises(InputError, match="0_mask.png is 80×60 .*photos.scale=auto"):
        loaded(tmp_path)
    found = loaded(tmp_path, scale="auto").shown[0].mask
    assert not found[:10].any() and found[10:].all()


@pytest.mark.parametrize(
    "size, wanted, plain",
    [
        ((40, 30), (40, 30), 1),
        ((20, 15), (40, 30), 0.5),
        ((324, 210), (1297, 840), 324 / 1297),  # rounded
        ((210, 324), (840, 1297), 324 / 1297),
        ((80, 60), (40, 30), 2),
        ((40, 28), (40, 30), None),  # cut
        ((40, 29), (40, 30), None),
        ((30, 40), (40, 30), None),  # turned
    ],
)
def test_a_plain_factor(size, wanted, plain):
    assert turns.factor(size, wanted) == (None if plain is None else pytest.approx(plain))


@pytest.mark.parametrize("form", ["colmap", "transforms", "ours"])
def test_a_missing_picture(tmp_path, form):
    for number in (0, 2):
        save(tmp_path / f"{number}.png", RAMP)
    listed(tmp_path, form, ["0.png", "1.png", "2.png"])
    with pytest.raises(InputError, match=r"1.png does not exist.*photos.images=.*missing=skip"):
        loaded(tmp_path)
    taken = loaded(tmp_path, missing="skip")
    assert [each.camera.name[-5:] for each in taken.shown] == ["0.png", "2.png"]
    (told,) = taken.warnings
    assert "1 of the views are left out" in told and "1.png" in told


@pytest.mark.parametrize("form", ["colmap", "transforms", "ours"])
@pytest.mark.parametrize("missing", ["refuse", "skip"])
def test_a_view_that_is_left_out_needs_no_picture(tmp_path, form, missing):
    for number in (0, 2):
        save(tmp_path / f"{number}.png", RAMP)
    listed(tmp_path, form, ["0.png", "1.png", "2.png"])
    taken = loaded(tmp_path, missing=missing, without=["1"])
    assert [each.camera.name[-5:] for each in taken.shown] == ["0.png", "2.png"]
    assert taken.warnings == []


def test_a_view_that_is_left_out_needs_no_mask(tmp_path):
    for number in range(3):
        save(tmp_path / f"{number}.png", RAMP)
    listed(tmp_path, "transforms", ["0.png", "1.png", "2.png"])
    photo_sets.change(tmp_path, lambda held: held["frames"][1].update(mask_path="gone.png"))
    with pytest.raises(InputError, match="gone.png does not exist"):
        loaded(tmp_path)
    assert len(loaded(tmp_path, without=["1.png"]).shown) == 2


def test_no_other_view_is_left_out_for_its_name(tmp_path):
    """That is the whole name of one, and the last part of another's."""
    for number in (0, 2):
        save(tmp_path / f"{number}.png", RAMP)
    listed(tmp_path, "transforms", ["0.png", "below/0.png", "2.png"])
    with pytest.raises(InputError, match="picture or mask of below/0.png does not exist, and"):
        loaded(tmp_path, without=["0.png"])
    assert len(loaded(tmp_path, without=["below/0.png"]).shown) == 2


def test_a_view_of_another_set_is_left_out_by_its_name_with_that_set(tmp_path):
    """Where both have pictures of one name."""
    folder = tmp_path / "here"
    for each in (folder, tmp_path / "a"):
        each.mkdir()
    for name in ("0.png", "1.png"):
        save(tmp_path / "a" / name, RAMP)
    listed(folder, "transforms", ["0.png", "0.png", "1.png"])

    def edit(held: dict) -> None:
        held["val_filenames"] = ["0.png"]
        for frame, scene in zip(held["frames"], "aba"):
            frame["scene_name"] = scene

    photo_sets.change(folder, edit)
    taken = loaded(folder, without=["b/0.png"])
    assert [each.camera.name for each in taken.shown] == ["a/0.png", "a/1.png"]
    with pytest.raises(InputError, match="0.png does not exist"):
        loaded(folder, without=["a/0.png"])
    with finding.looking(PhotosConfig(path=str(folder), without=["b/0.png"]), folder):
        assert reading.read(str(folder), "given").held == ["a/0.png"]


@pytest.mark.parametrize("above", ["./images/", "images\\", "C:\\Users\\a\\images\\"])
def test_pictures_in_another_folder(tmp_path, above):
    """As they are called in the cameras' file, or as that file's own folder is replaced."""
    content = photo_sets.transforms(Files(tmp_path, POSES))
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for number, frame in enumerate(content["frames"]):
        save(elsewhere / f"{number}.jpg", RAMP)
        frame["file_path"] = f"{above}{number}.png"
    photo_sets.write(tmp_path / "transforms.json", content)
    for asked in ("elsewhere", str(elsewhere)):
        taken = loaded(tmp_path, images=asked)
        assert [each.camera.image.name for each in taken.shown] == ["0.jpg", "1.jpg", "2.jpg"]
        assert likeness(taken.shown[0].image, RAMP)
    with pytest.raises(InputError, match="photos.images=gone: no such folder"):
        loaded(tmp_path, images="gone")
    for number, frame in enumerate(content["frames"]):
        frame["file_path"] = f"{number}/0.png"
    photo_sets.write(tmp_path / "transforms.json", content)
    with pytest.raises(InputError, match=r"0.jpg is the picture of two views, 0/0.png and 1/0.png"):
        loaded(tmp_path, images="elsewhere")


@pytest.mark.parametrize(
    "settings, told",
    [
        ({"missing": "leave"}, "photos.missing=leave: valid: refuse, skip"),
        ({"orientation": "up"}, "photos.orientation=up: valid: auto, stored, turned"),
        ({"materials": "many"}, "photos.materials=many: valid: each, one"),
        ({"scale": "half"}, "photos.scale=half: how large"),
        ({"scale": -1}, "photos.scale=-1: how large"),
        ({"scale": True}, "photos.scale=True: how large"),
    ],
)
def test_what_no_setting_is(settings, told):
    with pytest.raises(InputError, match=told):
        PhotosConfig(**settings)


def test_no_pixel_of_a_float_file_is_full(tmp_path):
    """Whatever its ending: a TIFF may hold radiance."""
    content = photo_sets.transforms(Files(tmp_path, POSES))
    for number, frame in enumerate(content["frames"]):
        spec = oiio.ImageSpec(*SIZE, 3, oiio.FLOAT)
        output = oiio.ImageOutput.create(str(tmp_path / f"{number}.tif"))
        assert output.open(str(tmp_path / f"{number}.tif"), spec)
        assert output.write_image(np.full((SIZE[1], SIZE[0], 3), 3.0, np.float32))
        output.close()
        frame["file_path"] = f"{number}.tif"
    photo_sets.write(tmp_path / "transforms.json", content)
    for each in loaded(tmp_path).shown:
        assert each.mask.all() and each.image.max() == 3


ODD = (0.5, 0.3, 0.3, 0.5, 0.2, 0.1, 0.3, 0.3)
REC2020 = (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329)


def light_of_its_own(path, primaries=ODD, pixels=RAMP) -> None:
    """A floating-point file of other primaries, or of some that nobody has."""
    spec = oiio.ImageSpec(*SIZE, 3, oiio.FLOAT)
    spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), primaries)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(pixels.astype(np.float32))
    output.close()


def test_light_of_unknown_primaries_stays_light(tmp_path):
    """No advice takes it for sRGB's numbers."""
    names = [f"{number}.exr" for number in range(3)]
    listed(tmp_path, "transforms", names)
    for name in names:
        light_of_its_own(tmp_path / name)
    (told,) = loaded(tmp_path).warnings
    assert "0.exr, cannot be heeded, and their numbers are taken as linear Rec. 709" in told
    assert told.endswith("or say photos.encoding=linear")
    taken = loaded(tmp_path, encoding="linear")
    assert taken.warnings == [] and likeness(taken.shown[0].image, RAMP)
    with pytest.raises(InputError, match="encoding=srgb: .*0.exr is of floating point, which is"):
        loaded(tmp_path, encoding="srgb")
    (told,) = material.colour(PhotosConfig(texture=str(tmp_path / "0.exr")))[1]
    assert told.endswith("convert it to linear Rec. 709")


@pytest.mark.parametrize("disk, listed", [("NFD", "NFC"), ("NFC", "NFD")])
def test_accents_are_spelt_in_two_ways(tmp_path, disk, listed):
    """macOS has them beside their letters; of pictures, folders, masks and names that are given."""
    content = photo_sets.transforms(Files(tmp_path, POSES))
    folder = tmp_path / normalize(disk, "Küche")
    (folder / "masks").mkdir(parents=True)
    mask = np.ones((*SIZE[::-1], 3), np.float32)
    mask[:10] = 0
    for number, frame in enumerate(content["frames"]):
        save(folder / normalize(disk, f"é{number}.png"), RAMP)
        save(folder / "masks" / normalize(listed, f"é{number}.png"), mask)
        frame["file_path"] = normalize(listed, f"Küche/é{number}.png")
    photo_sets.write(tmp_path / "transforms.json", content)
    taken = loaded(tmp_path, test=[normalize(disk, "é1.png")])
    assert taken.warnings == [] and len(taken.shown) == 2
    assert all(likeness(each.image, RAMP) for each in taken.all)
    assert all(each.mask[10:].all() and not each.mask[:10].any() for each in taken.all)


def test_light_that_a_float_file_cuts_off_does_not_count(tmp_path, rng):
    """As of 8 bits; unless all is to count."""
    bright = RAMP * rng.uniform(0.6, 2.4, RAMP.shape).astype(np.float32)
    pictures = [np.minimum(bright, 0.9), bright, np.minimum(bright, 0.9)]
    photo_sets.transforms(Files(tmp_path, POSES, pictures))
    first, whole, _ = loaded(tmp_path).shown
    assert ((first.mask == 0) == (bright >= 0.9).any(axis=2)).all()
    assert first.lost["saturated"] == (bright >= 0.9).any(axis=2).sum() > 12
    assert whole.mask.all() and "saturated" not in whole.lost
    assert all(each.mask.all() for each in loaded(tmp_path, saturated=None).shown)


def test_light_is_cut_off_in_a_file_s_own_primaries(tmp_path, rng):
    bright = RAMP * rng.uniform(0.6, 2.4, RAMP.shape).astype(np.float32)
    names = [f"{number}.exr" for number in range(3)]
    listed(tmp_path, "transforms", names)
    for name in names:
        light_of_its_own(tmp_path / name, REC2020, np.minimum(bright, 0.9))
    for each in loaded(tmp_path).shown:
        assert ((each.mask == 0) == (bright >= 0.9).any(axis=2)).all()


def test_photographs_of_several_parts_are_said_once(tmp_path):
    names = [f"{number}.exr" for number in range(3)]
    listed(tmp_path, "transforms", names)
    ramp = RAMP.astype(np.float32)
    for name in names:
        photo_sets.in_parts(tmp_path / name, albedo=("RGB", ramp), beauty=("RGB", 2 * ramp))
    (told,) = loaded(tmp_path).warnings
    assert "0.exr and 2 more hold several parts (albedo, beauty)" in told
