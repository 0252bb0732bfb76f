"""Pictures in and out: decoded to linear, written with names and provenance, errors in one line."""

from __future__ import annotations

import datetime
import resource
import struct
import sys
import zlib

import mitsuba as mi
import numpy as np
import OpenImageIO as oiio
import pytest
from photo_sets import in_parts
from PIL import Image

from isas_cli import __version__
from isas_cli.runtime import images
from isas_cli.runtime.errors import InputError, IsasError

pytestmark = pytest.mark.usefixtures("two_threads")


def write(path, pixels, channels=("R", "G", "B"), **attributes):
    """Writes `pixels` in their own type through OpenImageIO, for `images` to read."""
    height, width, count = pixels.shape
    kinds = {"uint8": oiio.UINT8, "uint16": oiio.UINT16, "float32": oiio.FLOAT}
    spec = oiio.ImageSpec(width, height, count, kinds[str(pixels.dtype)])
    spec.channelnames = tuple(channels)
    for name, value in attributes.items():
        kind = [oiio.TypeDesc(f"float[{len(value)}]")] if isinstance(value, tuple) else []
        spec.attribute(name.replace("__", ":"), *kind, value)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(pixels) and output.close()
    return path


def picture(height=5, width=7, channels=3):
    return np.random.default_rng(1).random((height, width, channels)).astype(np.float32)


def dng(path, colours, orientation):
    """Writes a camera raw file, a TIFF with all that DNG asks for. The sensor sees linear sRGB,
    `colours` (H, W, 3) uint16, through a mosaic of filters, red and green above green and blue."""
    height, width, _ = colours.shape
    mosaic = colours[..., 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = colours[::2, ::2, 0], colours[1::2, 1::2, 2]
    to_sensor = [3.2406, -1.5372, -0.4986, -0.9689, 1.8758, 0.0415, 0.0557, -0.2040, 1.0570]
    tags = {  # number: type (bytes, text, 16 bits, 32 bits, 5 and 10 fractions), values
        254: (4, [0]),  # the picture itself
        256: (4, [width]),
        257: (4, [height]),
        258: (3, [16]),  # bits
        259: (3, [1]),  # not compressed
        262: (3, [32803]),  # through filters
        271: (2, b"isas\0"),
        272: (2, b"test\0"),
        273: (4, [8]),  # where the pixels begin: after the header
        274: (3, [orientation]),
        277: (3, [1]),  # number a pixel
        278: (4, [height]),  # rows in the one strip
        279: (4, [mosaic.nbytes]),
        33421: (3, [2, 2]),  # size of the mosaic
        33422: (1, [0, 1, 1, 2]),  # its colours
        50706: (1, [1, 4, 0, 0]),  # version
        50708: (2, b"isas test\0"),  # camera
        50714: (4, [0]),  # black
        50717: (4, [65535]),  # white
        50721: (10, to_sensor),  # from XYZ
        50728: (5, [1, 1, 1]),  # what is neutral
        50778: (3, [21]),  # in the light D65
    }
    # Values of more than four bytes follow the table.
    place = 8 + mosaic.nbytes + 2 + 12 * len(tags) + 4
    table, beyond = struct.pack("<H", len(tags)), b""
    for tag, (kind, values) in tags.items():
        if kind in (5, 10):
            data = b"".join(struct.pack("<2i", round(1e4 * value), 10_000) for value in values)
        else:
            data = struct.pack(f"<{len(values)}{'BBHI'[kind - 1]}", *values)
        data += bytes(-len(data) % 4)
        if len(data) > 4:
            data, beyond = struct.pack("<I", place + len(beyond)), beyond + data
        table += struct.pack("<HHI", tag, kind, len(values)) + data
    header = struct.pack("<2sHI", b"II", 42, 8 + mosaic.nbytes)
    path.write_bytes(header + mosaic.astype("<u2").tobytes() + table + bytes(4) + beyond)
    return path


def exr_header(path):
    """The attributes of an EXR's header, {name: (type, bytes)}, read by the format's definition:
    magic number and version, then name, type and size of each attribute, up to an empty name."""
    data = path.read_bytes()
    assert data[:4] == b"\x76\x2f\x31\x01"
    place, attributes = 8, {}
    while data[place]:
        name, kind, rest = data[place : place + 600].split(b"\0", 2)
        place += len(name) + len(kind) + 2
        (size,) = struct.unpack_from("<i", data, place)
        attributes[name.decode()] = kind.decode(), data[place + 4 : place + 4 + size]
        place += 4 + size
    return attributes


def seconds_ago(date, form):
    """How long ago a UTC date, as text in the form given, was."""
    stamp = datetime.datetime.strptime(date, form).replace(tzinfo=datetime.timezone.utc)
    return (datetime.datetime.now(datetime.timezone.utc) - stamp).total_seconds()


def test_exr_keeps_values_channel_names_and_metadata(tmp_path):
    path, image = tmp_path / "a.exr", picture() * 100 - 1
    metadata = {"what": "result", "scene": "pottery", "view": 3, "seed": 2**40, "spp": 0.5}
    images.write_exr(path, image, ["R", "G", "B"], metadata)
    assert np.array_equal(images.read(path), image)
    spec = oiio.ImageInput.open(str(path)).spec()
    assert spec.format == oiio.FLOAT and list(spec.channelnames) == ["R", "G", "B"]
    attributes = {attribute.name: attribute.value for attribute in spec.extra_attribs}
    assert attributes["oiio:ColorSpace"] == "lin_rec709_scene"
    assert attributes["Software"].startswith("isas")
    assert attributes["ImageDescription"] == attributes["isas:what"] == "result"
    assert attributes["isas:scene"] == "pottery" and attributes["isas:view"] == 3
    assert attributes["isas:seed"] == str(2**40) and attributes["isas:spp"] == 0.5
    assert [file.name for file in tmp_path.iterdir()] == ["a.exr"]


def test_one_channel_is_written_as_named_and_read_as_grey(tmp_path):
    density = picture()[..., 0]
    images.write_exr(tmp_path / "y.exr", density, ["Y"], {"what": "density"})
    assert list(oiio.ImageInput.open(str(tmp_path / "y.exr")).spec().channelnames) == ["Y"]
    assert np.array_equal(images.read(tmp_path / "y.exr"), np.repeat(density[..., None], 3, 2))
    with pytest.raises(ValueError, match="channels"):
        images.write_exr(tmp_path / "y.exr", picture(), ["Y"], {})


def test_another_reader_finds_values_channels_and_strings_of_an_exr(tmp_path):
    """Mitsuba reads with an OpenEXR of its own."""
    path, image = tmp_path / "a.exr", picture() * 100 - 1
    images.write_exr(path, image, ["R", "G", "B"], {"what": "result", "scene": "pottery"})
    bitmap = mi.Bitmap(str(path))
    assert bitmap.pixel_format() == mi.Bitmap.PixelFormat.RGB and not bitmap.srgb_gamma()
    assert [field.name for field in bitmap.struct_()] == ["R", "G", "B"]
    assert np.array_equal(np.array(bitmap), image)
    assert bitmap.metadata()["isas:scene"] == "pottery"
    assert bitmap.metadata()["comments"] == "result"
    images.write_exr(path, image[..., 0], ["Y"], {})
    assert mi.Bitmap(str(path)).pixel_format() == mi.Bitmap.PixelFormat.Y
    assert np.array_equal(np.array(mi.Bitmap(str(path))).reshape(image.shape[:2]), image[..., 0])


def test_an_exr_says_in_which_colours_and_when_it_was_made(tmp_path):
    path = tmp_path / "a.exr"
    images.write_exr(path, picture(), ["R", "G", "B"], {"view": 3, "seconds": 1.5})
    header = exr_header(path)
    assert header["colorInteropID"] == ("string", b"lin_rec709_scene")
    kind, primaries = header["chromaticities"]
    bt709 = [0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290]
    assert kind == "chromaticities" and struct.unpack("<8f", primaries) == pytest.approx(bt709)
    assert header["utcOffset"] == ("float", struct.pack("<f", 0))
    assert header["Software"] == ("string", f"isas {__version__}".encode())
    assert header["isas:view"] == ("int", struct.pack("<i", 3))
    assert header["isas:seconds"] == ("float", struct.pack("<f", 1.5))
    assert -1 <= seconds_ago(header["capDate"][1].decode(), "%Y:%m:%d %H:%M:%S") < 600
    assert -1 <= seconds_ago(header["isas:date"][1].decode(), "%Y-%m-%dT%H:%M:%S+00:00") < 600


def test_what_is_no_colour_says_so(tmp_path):
    images.write_exr(tmp_path / "a.exr", picture()[..., 0], ["Y"], {"what": "p_j n"})
    header = exr_header(tmp_path / "a.exr")
    assert header["colorInteropID"] == ("string", b"data") and "chromaticities" not in header
    spec = oiio.ImageInput.open(str(tmp_path / "a.exr")).spec()
    assert spec.get_string_attribute("oiio:ColorSpace") == "data"


def test_eight_bits_are_decoded_from_srgb(tmp_path):
    values = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=2)
    linear = images.read(write(tmp_path / "a.png", values))
    assert linear.dtype == np.float32
    # The curve's published values: its ends, its linear foot, middle grey and half intensity.
    known = {0: 0.0, 10: 0.0030353, 11: 0.0033465, 128: 0.2158605, 188: 0.5028865, 255: 1.0}
    for code, value in known.items():
        assert linear.reshape(256, 3)[code] == pytest.approx(value, abs=5e-7), code
    assert np.array_equal(images.to_display(linear), values)


def test_srgb_is_decoded_alike_on_all_processors():
    """Of floats the last bit hangs on what NumPy finds in them."""
    levels = (np.arange(65536) / 65535).astype(np.float32).reshape(256, 256)
    linear = images.srgb_decode(levels)
    assert linear.dtype == np.float32
    assert np.array_equal(linear, images.srgb_decode(levels.astype(np.float64)).astype(np.float32))


def test_sixteen_bits_are_decoded_and_alpha_is_dropped_without_darkening(tmp_path):
    sixteen = np.full((2, 3, 3), 32896, dtype=np.uint16)  # 32896 / 65535 = 128 / 255
    assert images.read(write(tmp_path / "a.png", sixteen)) == pytest.approx(0.2158605, abs=5e-7)
    half_clear = np.array([[[188, 128, 255, 128]]], dtype=np.uint8)
    path = write(tmp_path / "b.png", half_clear, "RGBA", oiio__UnassociatedAlpha=1)
    assert images.read(path)[0, 0] == pytest.approx([0.5028865, 0.2158605, 1.0], abs=5e-7)


@pytest.mark.parametrize("name", ["a.tif", "a.pfm"])
def test_float_files_are_linear_as_they_are(tmp_path, name):
    image = picture() * 10
    found = images.load(write(tmp_path / name, image))
    assert np.array_equal(found.image, image) and found.doubt is None


def test_a_ppm_is_decoded_from_srgb(tmp_path):
    """Its reader calls the colours of all such files Rec709's."""
    found = images.load(write(tmp_path / "a.ppm", np.full((2, 3, 3), 128, np.uint8)))
    assert found.image == pytest.approx(0.2158605, abs=5e-7) and found.doubt is None


def test_raw_files_are_linear_as_the_camera_balanced_them(tmp_path):
    """Two colours, one four times the other, and not brightened: the brighter is not white."""
    pytest.importorskip("rawpy")
    colours = np.empty((64, 96, 3), np.uint16)
    colours[:, :48], colours[:, 48:] = (15000, 12000, 9000), (60000, 48000, 36000)
    path = dng(tmp_path / "a.dng", colours, orientation=6)  # turn clockwise for display
    image, wanted = images.read(path), np.rot90(colours, -1) / 65535
    assert images.size(path) == (64, 96) and image.shape == wanted.shape
    assert images.read_alpha(path) is None
    for rows in (slice(8, 40), slice(56, 88)):  # away from the edges, which are interpolated
        np.testing.assert_allclose(image[rows, 8:-8], wanted[rows, 8:-8], rtol=0.02)


def test_raw_files_without_rawpy(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rawpy", None)
    (tmp_path / "a.NEF").write_text("")
    for ask in (images.read, images.size):
        with pytest.raises(InputError, match=r"a.NEF: .* rawpy, .* install .*'.\[raw\]'"):
            ask(tmp_path / "a.NEF")


def test_radiance_files_are_linear_within_their_precision(tmp_path):
    image = picture() + 1  # a shared exponent keeps 8 bits of the largest channel
    assert images.read(write(tmp_path / "a.hdr", image)) == pytest.approx(image, abs=2 / 128)


def test_a_photograph_is_turned_as_its_orientation_says(tmp_path):
    upright = np.zeros((2, 3, 3), dtype=np.uint8)
    upright[0, 2] = 255  # the top right corner
    stored = np.rot90(upright)  # orientation 6: turn clockwise for display
    path = write(tmp_path / "a.tif", np.ascontiguousarray(stored), Orientation=6)
    assert np.array_equal(images.read(path), upright / 255)


def test_colours_are_found_by_name_among_other_channels(tmp_path):
    layers = picture(channels=5)
    path = write(tmp_path / "a.exr", layers, ("A", "R", "G", "B", "Z"))
    assert np.array_equal(images.read(path), layers[..., 1:4])
    path = write(tmp_path / "b.exr", layers, ("u", "v", "w", "s", "t"))
    with pytest.raises(InputError, match="no channels R, G, B or Y"):
        images.read(path)


AP0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)


@pytest.mark.parametrize("said", ["name", "primaries", "name primaries"])
def test_colours_that_are_said_twice_are_converted_once(tmp_path, said):
    """As ACES containers say them."""
    told = {"oiio__ColorSpace": "lin_ap0_scene"} if "name" in said else {}
    told |= {"chromaticities": AP0} if "primaries" in said else {}
    pixels = np.full((2, 2, 3), (0.2, 0.5, 0.1), np.float32)
    found = images.load(write(tmp_path / "a.exr", pixels, **told))
    assert found.doubt is None
    assert found.image[0, 0] == pytest.approx([-0.1015, 0.6214, 0.0373], abs=1e-3)


@pytest.mark.parametrize("name", ["lin_rec2020_scene", "lin_rec709_scene"])
def test_a_name_and_other_primaries_are_not_heeded(tmp_path, name):
    pixels = picture()
    said = {"oiio__ColorSpace": name, "chromaticities": AP0}
    found = images.load(write(tmp_path / "a.exr", pixels, **said))
    assert found.doubt == f"colour space {name} beside other primaries"
    assert np.array_equal(found.image, pixels)


def test_of_several_parts_the_first_is_read_and_said(tmp_path):
    albedo, beauty = picture(), picture() + 1
    path = in_parts(tmp_path / "a.exr", albedo=("RGB", albedo), beauty=("RGB", beauty))
    found = images.load(path)
    assert np.array_equal(found.image, albedo)
    told = f"{path} holds several parts (albedo, beauty), of which the first is read"
    assert images.unheeded([path], [found.doubt]) == [told]
    assert images.doubted(path) == found.doubt
    plain = write(tmp_path / "b.exr", beauty)
    assert images.unheeded([plain], [images.load(plain).doubt]) == []
    path = in_parts(tmp_path / "c.exr", depth=("Z", picture(channels=1)), beauty=("RGB", beauty))
    with pytest.raises(InputError, match=r"it has Z; .*c.exr holds several parts \(depth, beauty"):
        images.read(path)


@pytest.mark.parametrize("said", ["chromaticities", "", "name"])
def test_cie_colours_become_red_green_and_blue(tmp_path, said):
    """Of a film of `pixel_format` xyz, Y alone would pass for a grey picture."""
    of_rgb = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    image = picture()
    stored = np.einsum("ij,...j", np.array(of_rgb), image).astype(np.float32)
    spec = {}
    if said == "chromaticities":
        spec["chromaticities"] = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)
    elif said:
        spec["oiio__ColorSpace"] = "lin_ciexyzd65_scene"
    path = write(tmp_path / "a.exr", stored, ("X", "Y", "Z"), **spec)
    assert images.read(path) == pytest.approx(image, abs=2e-3)


def test_masks_keep_the_stored_values(tmp_path):
    grey = np.array([[[0], [128], [255]]], dtype=np.uint8)
    mask = images.read_mask(write(tmp_path / "a.png", grey, ("Y",)))
    assert mask.shape == (1, 3) and mask[0] == pytest.approx([0, 128 / 255, 1])
    assert np.array_equal(images.read_mask(write(tmp_path / "b.png", grey.repeat(3, 2))), mask)
    with pytest.raises(InputError, match="has to be grey"):
        images.read_mask(write(tmp_path / "c.exr", picture()))
    with pytest.raises(InputError, match=r"lie in \[0, 1\]"):
        images.read_mask(write(tmp_path / "d.exr", picture(channels=1) + 1, ("Y",)))


def test_masks_of_floats_may_be_rounded_or_alpha_alone(tmp_path):
    rounded = np.float32([[[-1e-7], [0.5], [1.0000002]]])
    for name in "YA":
        mask = images.read_mask(write(tmp_path / f"{name}.exr", rounded, (name,)))
        assert np.array_equal(mask, [[0, 0.5, 1]])


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_masks_of_0_and_one_other_value_are_black_and_white(tmp_path, kind):
    true = np.array([[[0], [1]]], dtype=kind)
    assert np.array_equal(images.read_mask(write(tmp_path / "a.png", true, ("Y",))), [[0, 1]])
    assert np.array_equal(images.read_mask(write(tmp_path / "b.png", true * 0, ("Y",))), [[0, 0]])
    label = true * 2
    assert np.array_equal(images.read_mask(write(tmp_path / "c.png", label, ("Y",))), [[0, 1]])
    palette = true * np.array([128, 0, 0], kind)  # as of video segmentation
    assert np.array_equal(images.read_mask(write(tmp_path / "e.png", palette)), [[0, 1]])
    # Of several labels nothing says which are white.
    several = np.concatenate([label, true], axis=1)
    dark = images.read_mask(write(tmp_path / "d.png", several, ("Y",)))
    assert 0 < dark.max() < 0.01


def test_a_gif_has_alpha_and_colours(tmp_path):
    """OpenImageIO names a channel of it that it does not have."""
    pixels = np.array([[[255, 0, 0], [0, 0, 255]]], np.uint8)
    Image.fromarray(pixels).quantize(4).save(tmp_path / "a.gif")
    assert images.read(tmp_path / "a.gif") == pytest.approx(pixels / 255)
    assert np.array_equal(images.read_alpha(tmp_path / "a.gif"), [[1, 1]])


def test_what_is_transparent_in_a_mask_is_black(tmp_path):
    """A cut-out's mask is white all over, and its alpha says what the object is."""
    alpha = np.array([[[0], [128], [255]]], dtype=np.uint8)
    white, grey = np.full((1, 3, 3), 255, np.uint8), np.full((1, 3, 1), 51, np.uint8)
    beside = {"oiio:UnassociatedAlpha": 1}
    stored = np.concatenate([white, alpha], axis=2)
    cut = write(tmp_path / "a.png", stored, tuple("RGBA"), **beside)
    assert images.read_mask(cut)[0] == pytest.approx([0, 128 / 255, 1])
    stored = np.concatenate([grey, alpha], axis=2)
    both = write(tmp_path / "b.png", stored, tuple("YA"), **beside)
    assert images.read_mask(both)[0] == pytest.approx([0, 0.2 * 128 / 255, 0.2], abs=1e-3)
    # An EXR's colours are multiplied by its alpha already.
    over = np.float32([[[0, 0, 0, 0], [0.5, 0.5, 0.5, 0.5], [1, 1, 1, 1]]])
    assert images.read_mask(write(tmp_path / "c.exr", over, tuple("RGBA")))[0] == pytest.approx(
        [0, 0.5, 1]
    )


def test_a_missing_or_unreadable_picture_is_one_line(tmp_path):
    (tmp_path / "text.png").write_text("no picture")
    (tmp_path / "empty.exr").write_text("")
    (tmp_path / "text.dng").write_text("no picture")
    images.write_exr(tmp_path / "cut.exr", picture(64, 64), ["R", "G", "B"], {})
    (tmp_path / "cut.exr").write_bytes((tmp_path / "cut.exr").read_bytes()[:9000])
    for name in ("nothing.exr", "text.png", "empty.exr", "cut.exr", "text.dng", "nothing.dng", "."):
        with pytest.raises(InputError) as error:
            images.read(tmp_path / name)
        assert str(tmp_path / name) in str(error.value) and "\n" not in str(error.value), name


@pytest.mark.parametrize("name", ["a.jpg", "progressive.jpg", "a.png", "a.tif", "a.webp", "a.bmp"])
@pytest.mark.parametrize("kept", [0.5, 0.9])
def test_a_picture_that_is_cut_short_is_refused(tmp_path, rng, name, kept):
    """Readers fill up what is missing, and note it alone."""
    path = tmp_path / name
    pixels = rng.integers(0, 255, (48, 64, 3), np.uint8)
    Image.fromarray(pixels).save(path, quality=90, progressive="progressive" in name)
    assert images.read(path).shape == (48, 64, 3)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole))])
    for read in (images.read, images.read_mask):
        with pytest.raises(InputError, match=name) as error:
            read(path)
        assert "\n" not in str(error.value)


def test_bytes_too_many_in_a_jpeg_mean_nothing(tmp_path):
    """As some telephones leave them: readers note that, too."""
    Image.new("RGB", (64, 48), (90, 160, 40)).save(tmp_path / "a.jpg")
    whole = (tmp_path / "a.jpg").read_bytes()
    (tmp_path / "a.jpg").write_bytes(whole[:-2] + bytes(20) + whole[-2:])
    assert images.read(tmp_path / "a.jpg").shape == (48, 64, 3)


def test_non_finite_pixels_are_refused_and_counted_unless_wanted(tmp_path):
    image = picture()
    image[1, 2, 0], image[3, 3] = np.nan, np.inf
    images.write_exr(tmp_path / "a.exr", image, ["R", "G", "B"], {})
    with pytest.raises(InputError, match="2 pixels are NaN or infinite"):
        images.read(tmp_path / "a.exr")
    kept = images.read(tmp_path / "a.exr", finite=False)
    assert np.array_equal(kept, image, equal_nan=True)


def test_display_clips_after_the_exposure():
    image = np.array([[[-1.0, 0.2158605, 0.5], [np.nan, np.inf, 4.0]]])
    assert images.to_display(image).tolist() == [[[0, 128, 188], [0, 255, 255]]]
    assert images.to_display(image, 0.25)[0, 1, 2] == 255
    assert images.to_display(image, 0.125)[0, 1, 2] == 188


def test_png_is_written_as_it_is(tmp_path):
    values = np.random.default_rng(2).integers(0, 256, (4, 6, 3), dtype=np.uint8)
    images.write_png(tmp_path / "a.png", values)
    assert np.array_equal(images.to_display(images.read(tmp_path / "a.png")), values)
    with pytest.raises(ValueError, match="uint8"):
        images.write_png(tmp_path / "a.png", values / 255)


@pytest.mark.parametrize("channels", [1, 3])
def test_a_preview_states_its_curve(tmp_path, channels):
    """Pillow reads it back: neither the pixels nor the words are OpenImageIO's alone."""
    path, image = tmp_path / "a.png", picture(channels=channels) * 4
    metadata = {"what": "result", "scene": "Töpferei", "view": 3}
    images.write_preview(path, image, 0.5, metadata)
    with Image.open(path) as stored:
        pixels, words = np.asarray(stored), stored.info
    assert np.array_equal(pixels.reshape(image.shape), images.to_display(image, 0.5))
    # What the words say, done by hand.
    assert words["isas:curve"].startswith("clip(exposure * linear, 0, 1), then sRGB")
    linear = np.clip(float(words["isas:exposure"]) * image.astype(np.float64), 0, 1)
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.array_equal(pixels.reshape(image.shape), np.rint(255 * curve))
    assert words["srgb"] in range(4) and words["gamma"] == pytest.approx(1 / 2.2, abs=1e-5)
    assert words["Software"] == f"isas {__version__}" and words["Description"] == "result"
    assert words["isas:view"] == "3" and words["isas:scene"] == "T\\xf6pferei"
    assert -1 <= seconds_ago(words["isas:date"], "%Y-%m-%dT%H:%M:%S+00:00") < 600
    spec = oiio.ImageInput.open(str(path)).spec()
    assert spec.get_string_attribute("isas:curve") == words["isas:curve"]
    assert spec.get_string_attribute("oiio:ColorSpace").startswith("srgb")


def test_exposure_brings_the_99th_percentile_to_white():
    ramp = np.linspace(0, 200, 201)  # its 99th percentile is 198
    image = np.stack([ramp, ramp, ramp], axis=1)[None]
    assert images.exposure_for([image]) == pytest.approx(1 / 198)
    with_holes = np.concatenate([ramp, [np.nan, np.inf, -np.inf]])
    assert images.exposure_for([with_holes]) == pytest.approx(1 / 198)
    assert images.exposure_for([ramp[:101], ramp[101:]]) == pytest.approx(1 / 198)
    for nothing in ([], [np.zeros((2, 2, 3))], [np.full((2, 2, 3), np.nan)], [-image]):
        assert images.exposure_for(nothing) == 1.0


def test_a_picture_that_cannot_be_written_leaves_the_earlier_one(tmp_path):
    path, image = tmp_path / "a.exr", picture()
    images.write_exr(path, image, ["R", "G", "B"], {})
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, hard))  # as on a full disk
    try:
        with pytest.raises(IsasError) as error:
            images.write_exr(path, picture(200, 200), ["R", "G", "B"], {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert str(path) in str(error.value) and "\n" not in str(error.value)
    assert np.array_equal(images.read(path), image)
    assert [file.name for file in tmp_path.iterdir()] == ["a.exr"]
    with pytest.raises(IsasError, match="cannot be written"):
        images.write_exr(path / "below" / "b.exr", image, ["R", "G", "B"], {})


def test_a_cropped_exr_lies_where_it_belongs(tmp_path):
    """Renderers leave out what is empty: the data window is a part of the display window."""
    path, part = tmp_path / "cropped.exr", picture(3, 4)
    spec = oiio.ImageSpec(4, 3, 3, oiio.FLOAT)
    spec.x, spec.y, spec.full_width, spec.full_height = 2, 1, 7, 5
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(part)
    output.close()
    found = images.read(path)
    assert images.size(path) == (7, 5) and found.shape == (5, 7, 3)
    assert np.array_equal(found[1:4, 2:6], part) and found.sum() == pytest.approx(part.sum())


def test_a_bmp_is_not_multiplied_by_its_alpha(tmp_path):
    path = tmp_path / "half.bmp"
    Image.fromarray(np.full((3, 4, 4), (200, 200, 200, 128), np.uint8)).save(path)
    assert images.has_alpha(path) and not images.multiplied(path)


def test_where_a_png_was_cut_out_is_no_place_in_it(tmp_path, rng):
    """Programs that crop leave the offset in it; data windows are EXR's alone."""
    pixels = rng.integers(0, 255, (8, 10, 3), dtype=np.uint8)
    images.write_png(tmp_path / "plain.png", pixels)
    data = (tmp_path / "plain.png").read_bytes()
    content = b"oFFs" + struct.pack(">iiB", 3, 2, 0)
    place = data.index(b"oFFs")  # of 13 bytes and a sum, which is 0, 0 there
    content += struct.pack(">I", zlib.crc32(content))
    (tmp_path / "cut.png").write_bytes(data[:place] + content + data[place + 17 :])
    spec = oiio.ImageInput.open(str(tmp_path / "cut.png")).spec()
    assert (spec.x, spec.y) == (3, 2)
    plain, cut = (images.read(tmp_path / f"{name}.png") for name in ("plain", "cut"))
    np.testing.assert_array_equal(cut, plain)
    assert images.size(tmp_path / "cut.png") == (10, 8)
