"""What files say of their colours, in every way that they have."""

import io
import struct
import sys
import zlib

import icc
import numpy as np
import OpenImageIO as oiio
import pytest
from icc import P3, SRGB, light, profile
from PIL import Image, ImageCms
from PIL.PngImagePlugin import PngInfo

from isas_cli.runtime import images
from isas_cli.runtime.errors import InputError

NUMBERS = np.random.default_rng(3).integers(0, 256, (6, 7, 3), np.uint8)
SHARE = NUMBERS / 255
OF_SRGB = images.srgb_decode(SHARE)
CHROMATICITIES = struct.pack(">8I", 31270, 32900, *(round(1e5 * x) for xy in P3 for x in xy))


def chunks(**content: bytes) -> PngInfo:
    found = PngInfo()
    for name, each in content.items():
        found.add(name.encode(), each)
    return found


def gamma(value: float) -> bytes:
    return struct.pack(">I", round(value * 1e5))


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.webp"])
def test_profiles_are_heeded(tmp_path, name):
    how = {"lossless": True} if name.endswith("webp") else {}
    Image.fromarray(NUMBERS).save(tmp_path / name, icc_profile=profile(P3), **how)
    found = images.load(tmp_path / name)
    np.testing.assert_allclose(found.image, light(SHARE, P3), atol=1e-4)
    assert found.doubt is None and np.abs(found.image - OF_SRGB).max() > 0.1
    # Of the file's own numbers, whatever light they are.
    np.testing.assert_allclose(found.brightest, SHARE.max(axis=2), atol=1e-6)
    np.testing.assert_allclose(images.read(tmp_path / name, linear=False), OF_SRGB, atol=1e-6)
    np.testing.assert_allclose(images.read(tmp_path / name, linear=True), SHARE, atol=1e-6)


def test_a_jpeg_and_one_of_a_power_law(tmp_path):
    flat = np.full((16, 16, 3), (200, 60, 90), np.uint8)
    adobe = (0.64, 0.33), (0.21, 0.71), (0.15, 0.06)
    for primaries, power in ((P3, None), (adobe, 2.2)):
        made = profile(primaries, power)
        Image.fromarray(flat).save(tmp_path / "a.jpg", icc_profile=made, quality=100)
        curve = images.srgb_decode if power is None else lambda x: x**2.2
        wanted = light(flat / 255, primaries, curve)
        np.testing.assert_allclose(images.read(tmp_path / "a.jpg"), wanted, atol=0.01)


GAINS = (
    b"http://ns.adobe.com/xap/1.0/\0<x:xmpmeta xmlns:x='adobe:ns:meta/'><rdf:RDF "
    b"xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#'><rdf:Description "
    b"xmlns:hdrgm='http://ns.adobe.com/hdr-gain-map/1.0/' hdrgm:Version='1.0' "
    b"hdrgm:GainMapMax='2' hdrgm:HDRCapacityMax='2'/></rdf:RDF></x:xmpmeta>"
)


def test_a_gain_map_brightens_nothing(tmp_path):
    """Of a telephone's JPEG (Ultra HDR), whose 8 bits are the picture, as without it."""
    ramp = np.repeat(np.arange(10, 250, 5, dtype=np.uint8)[None], 32, axis=0)
    turned = Image.Exif()
    turned[0x112] = 6

    def parts(pixels: np.ndarray, **more) -> list[bytes]:
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, "JPEG", quality=95, **more)
        told = struct.pack(">HH", 0xFFE1, len(GAINS) + 2) + GAINS
        return [file.getvalue()[:2], told, file.getvalue()[2:]]

    shown = np.stack([ramp, ramp // 2, 255 - ramp], axis=2)
    own = parts(shown, exif=turned, icc_profile=profile(P3))
    plain, gained = tmp_path / "plain.jpg", tmp_path / "gained.jpg"
    plain.write_bytes(own[0] + own[2])
    gained.write_bytes(b"".join(own + parts(ramp[::4, ::4])))
    for ask in (images.size, images.orientation, images.counted, images.grey, images.has_alpha):
        assert ask(gained) == ask(plain), ask
    found, wanted = images.load(gained), images.load(plain)
    assert found.doubt is None and found.image.shape == (48, 32, 3)
    np.testing.assert_array_equal(found.image, wanted.image)
    np.testing.assert_array_equal(found.brightest, wanted.brightest)


@pytest.mark.parametrize("made", ["ours", "LittleCMS", "grey"])
def test_srgb_changes_nothing(tmp_path, made):
    picture = Image.fromarray(NUMBERS)
    own = profile(SRGB)
    if made == "LittleCMS":
        own = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    elif made == "grey":
        picture, own = picture.convert("L"), profile(SRGB, space=b"GRAY")
    for name, more in (("a.png", {"icc_profile": own}), ("b.png", {})):
        picture.save(tmp_path / name, **more)
    with_it, without = (images.load(tmp_path / name) for name in ("a.png", "b.png"))
    np.testing.assert_array_equal(with_it.image, without.image)
    assert with_it.doubt is None


@pytest.mark.parametrize(
    "said, wanted",
    [
        ({"gAMA": gamma(1)}, SHARE),
        ({"gAMA": gamma(1 / 2.2)}, OF_SRGB),  # which older files say of sRGB
        ({"sRGB": b"\0", "gAMA": gamma(1 / 2.2)}, OF_SRGB),
        ({"gAMA": gamma(1), "cHRM": CHROMATICITIES}, light(SHARE, P3, lambda x: x)),
        ({"cHRM": CHROMATICITIES}, light(SHARE, P3)),
        ({"cICP": bytes([12, 13, 0, 1])}, light(SHARE, P3)),
    ],
)
def test_what_a_png_says(tmp_path, said, wanted):
    Image.fromarray(NUMBERS).save(tmp_path / "a.png", pnginfo=chunks(**said))
    found = images.load(tmp_path / "a.png")
    np.testing.assert_allclose(found.image, wanted, atol=1e-4)
    assert found.doubt is None


def test_adobe_rgb_as_cameras_say_it(tmp_path):
    """By a word among the tags, and no profile; without the word nothing is known."""
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA001] = 0xFFFF
    flat = Image.new("RGB", (16, 16), (60, 180, 90))
    flat.save(tmp_path / "a.jpg", exif=exif, quality=100)
    unnamed = images.load(tmp_path / "a.jpg")
    assert "not sRGB" in unnamed.doubt
    exif.get_ifd(0x8769)[0xA005] = {1: "R03"}
    flat.save(tmp_path / "b.jpg", exif=exif, quality=100)
    named = images.load(tmp_path / "b.jpg")
    adobe = (0.64, 0.33), (0.21, 0.71), (0.15, 0.06)
    wanted = light(np.array([60, 180, 90]) / 255, adobe, lambda x: x ** (563 / 256))
    assert named.doubt is None
    np.testing.assert_allclose(named.image[8, 8], wanted, atol=0.01)


def test_other_primaries_of_linear_files(tmp_path):
    value = np.full((2, 2, 3), (2.0, 0.3, 0.1), np.float32)
    places = [x for xy in (*P3, (0.3127, 0.3290)) for x in xy]
    odd = [0.5, 0.4, *places[2:]]
    for name, chromaticities in (("p3", places), ("odd", odd)):
        spec = oiio.ImageSpec(2, 2, 3, oiio.FLOAT)
        spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), tuple(chromaticities))
        file = oiio.ImageOutput.create("a.exr")
        assert file.open(str(tmp_path / f"{name}.exr"), spec) and file.write_image(value)
        file.close()
    found = images.load(tmp_path / "p3.exr")
    np.testing.assert_allclose(found.image, light(value, P3, lambda x: x), atol=1e-4)
    odd = images.load(tmp_path / "odd.exr")
    assert "primaries" in odd.doubt and (odd.image == value).all()


def test_what_cannot_be_heeded_is_said(tmp_path):
    """Numbers are sRGB's then, as without a profile."""
    picture = Image.fromarray(NUMBERS)
    for name, made in (
        ("broken.tif", profile(P3, name="mine")[:400]),
        ("grey.png", profile(SRGB, gamma=1.0, name="mine", space=b"GRAY")),
    ):
        own = picture.convert("L") if name == "grey.png" else picture
        own.save(tmp_path / name, icc_profile=made)
        found = images.load(tmp_path / name)
        assert "colour profile" in found.doubt
        wanted = np.atleast_3d(images.srgb_decode(np.asarray(own) / 255))
        np.testing.assert_allclose(found.image, np.broadcast_to(wanted, (6, 7, 3)), atol=1e-6)


@pytest.mark.parametrize(
    "made",
    [
        b"this is no profile" * 20,
        b"x",
        profile(P3)[:400],
        profile(P3, space=b"CMYK"),
        ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes(),
    ],
    ids=["garbage", "short", "cut", "CMYK", "LAB"],
)
def test_a_pngs_profile_that_its_reader_throws_away_is_said(tmp_path, made):
    picture = Image.fromarray(NUMBERS)
    picture.save(tmp_path / "a.png", icc_profile=made)
    found = images.load(tmp_path / "a.png")
    assert "colour profile that is damaged or not of such a picture" in found.doubt
    np.testing.assert_allclose(found.image, OF_SRGB, atol=1e-6)
    # Beside the word that its colours are sRGB's nothing is in doubt.
    whole, says = (tmp_path / "a.png").read_bytes(), b"sRGB\0"
    says = struct.pack(">I", 1) + says + struct.pack(">I", zlib.crc32(says))
    (tmp_path / "b.png").write_bytes(whole[:33] + says + whole[33:])  # after its header
    assert images.load(tmp_path / "b.png").doubt is None
    assert images.load(tmp_path / "a.png", linear=False).doubt is None


def test_heic(tmp_path):
    heif = pytest.importorskip("pillow_heif")
    flat = Image.new("RGB", (64, 48), (200, 60, 90))
    for name, made in (("a.heic", profile(P3)), ("b.HEIC", None)):
        heif.from_pillow(flat).save(tmp_path / name, quality=-1, icc_profile=made)
    wanted = np.array([200, 60, 90]) / 255
    for name, right in (("a.heic", light(wanted, P3)), ("b.HEIC", images.srgb_decode(wanted))):
        found = images.load(tmp_path / name)
        assert found.image.shape == (48, 64, 3) and found.doubt is None
        np.testing.assert_allclose(found.image[20, 20], right, atol=0.02)
        assert images.size(tmp_path / name) == (64, 48)
        assert images.orientation(tmp_path / name) == 1
        assert images.read_alpha(tmp_path / name) is None
    (tmp_path / "c.heic").write_bytes(b"no")
    with pytest.raises(InputError, match="c.heic: cannot be read as a HEIC"):
        images.load(tmp_path / "c.heic")


def test_heic_without_its_reader(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    (tmp_path / "a.heic").write_bytes(b"no")
    for ask in (images.load, images.size):
        with pytest.raises(
            InputError, match=r"a.heic: .* pillow-heif, .*: .*pip install .*'.\[heic\]'"
        ):
            ask(tmp_path / "a.heic")


def test_the_profile_that_is_written_here_is_right():
    """By LittleCMS: what is in sRGB's reach comes out within a level."""
    soft = (NUMBERS // 4 + 96).astype(np.uint8)
    made = ImageCms.ImageCmsProfile(__import__("io").BytesIO(profile(P3)))
    shown = ImageCms.profileToProfile(
        Image.fromarray(soft), made, ImageCms.createProfile("sRGB"), outputMode="RGB"
    )
    wanted = icc.light(soft / 255, P3)
    np.testing.assert_allclose(images.srgb_decode(np.asarray(shown) / 255), wanted, atol=0.01)
