"""Pictures in and out, through OpenImageIO; camera raw files through LibRaw (`rawpy`),
HEIC through libheif (`pillow-heif`).

Everything inside `isas` is linear RGB radiance (or a linear texture) in float32; this module is the
border at which files are decoded to that and encoded from it. It knows nothing of rendering.
"""

from __future__ import annotations

import datetime
import functools
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from PIL import PngImagePlugin

from .. import __version__
from . import heif, memory, profiles, raw
from .errors import InputError
from .files import write_atomically
from .profiles import Said

_PNG = b"\x89PNG\r\n\x1a\n"
# How a JPEG begins, by which of its first bytes OpenImageIO knows one with a gain map, and what it
# does not know, as long.
_JPEG, _FIRST, _GAIN, _PLAIN = b"\xff\xd8", 2**20, b"hdrgm:Version", b"hdrgm:Ignored"
_INT32 = range(-(2**31), 2**31)
_INTEGER_FORMATS = {oiio.UINT8: 255.0, oiio.UINT16: 65535.0}
_FLOAT_FORMATS = (oiio.HALF, oiio.FLOAT, oiio.DOUBLE)
# What readers note of files a part of which is missing or wrong, and fill up.
_BROKEN = ("premature end", "bad huffman code")
# How far rounding takes a mask's values out of [0, 1].
_ROUNDED = 1e-3
# Endings of files whose colours may be multiplied by alpha.
_ASSOCIATED = (".exr", ".tif", ".tiff")
# CIE x and y of red, green, blue and white (ITU-R BT.709), which sRGB has too.
_REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)


def srgb_decode(encoded: np.ndarray) -> np.ndarray:
    """sRGB values in [0, 1] to linear ones (IEC 61966-2-1); any shape, in their own precision."""
    flat = np.reshape(encoded, -1)
    linear = np.empty(flat.shape, np.result_type(flat, np.float32))
    for part in memory.parts(flat.size):
        # Doubles: NumPy's powers of floats are other ones on processors with AVX-512.
        x = flat[part].astype(np.float64)
        linear[part] = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    return linear.reshape(np.shape(encoded))


def srgb_encode(linear: np.ndarray) -> np.ndarray:
    """Linear values in [0, 1] to sRGB ones (IEC 61966-2-1); any shape."""
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)


@dataclass
class Picture:
    """``image (H, W, 3) float32``: linear; ``brightest (H, W) float32``: of each pixel the largest
    number that the file has, integers scaled to [0, 1]; ``doubt``: what the file says of its
    colours that could not be heeded, in words, or None; ``stored``: the image, or of light of other
    primaries the file's own numbers."""

    image: np.ndarray
    brightest: np.ndarray
    doubt: str | None
    stored: np.ndarray


def load(
    path: str | Path, finite: bool = True, linear: bool | None = None, turned: bool = True
) -> Picture:
    """Reads a picture.

    Floating-point files (EXR, HDR, PFM, float TIFF) are linear as they are; 8- and 16-bit integer
    ones are decoded by their colour profile, or what else of the kind they have, else from sRGB;
    `linear` says what the file's numbers are in place of all that. Camera raw files are linear, in
    sRGB's colours, with the camera's own white balance. A grey picture fills three channels, alpha
    is dropped, and a photograph is turned the way its Orientation tag asks, unless not `turned`.

    Raises InputError (one line) for a file that is missing, is not a picture, has no colours, or
    (with `finite`) holds NaN or infinite pixels.
    """
    stored, usually, said = _read_colours(Path(path), turned)
    decode, doubt = srgb_decode, None
    if usually if linear is None else linear:
        decode = None
    if linear is None:
        decode, doubt = profiles.to_linear(said, decode)
    pixels = stored if decode is None else decode(stored)
    if finite:
        check_finite(path, ~np.isfinite(pixels).all(axis=2))
    if pixels.shape[2] == 1:
        pixels = np.repeat(pixels, 3, axis=2)
    image = np.ascontiguousarray(pixels, dtype=np.float32)
    converted = usually and decode is not None and stored.shape[2] == 3
    return Picture(image, stored.max(axis=2), doubt, stored if converted else image)


def read(path: str | Path, finite: bool = True, linear: bool | None = None) -> np.ndarray:
    """The image of `load`, turned."""
    return load(path, finite, linear).image


def doubted(path: str | Path, linear: bool | None = None) -> str | None:
    """`Picture.doubt`, by the file's header where that has it. Raises InputError."""
    if linear is not None or raw.names(path):
        return None
    if heif.names(path):
        return load(path).doubt
    decode = srgb_decode if counted(path) else None
    return profiles.to_linear(profiles.said(Path(path), _header(path)), decode)[1]


def unheeded(paths: Sequence[str | Path], doubts: Iterable[str | None]) -> list[str]:
    """What should be said of files by what of their colours could not be heeded, once for all that
    say the same, and of those of several parts."""
    found: dict[tuple[str, str], list[str]] = {}
    for path, doubt in zip(paths, doubts):
        if doubt is not None:
            kind = "sRGB" if counted(path) else "linear Rec. 709"
            found.setdefault((doubt, kind), []).append(str(path))
    return [
        f"{doubt} of {', '.join(files)} cannot be heeded: convert "
        f"{'it' if len(files) == 1 else 'them'} to {kind}"
        for (doubt, kind), files in found.items()
    ] + partly(paths)


def partly(paths: Iterable[str | Path]) -> list[str]:
    """Of EXRs that have several parts, that one is read; once for all that have the same."""
    found: dict[str, list[str]] = {}
    for path in paths:
        if names := _parts(Path(path)):
            found.setdefault(", ".join(names), []).append(str(path))
    return [
        f"{files[0]} {'holds' if len(files) == 1 else f'and {len(files) - 1} more hold'} several "
        f"parts ({names}), of which the first is read"
        for names, files in found.items()
    ]


def emptied(image: np.ndarray) -> np.ndarray:
    """Which pixels of an image (H, W, C) are NaN or infinite, (H, W) bool; they become 0 there, so
    that a mask can hide them: 0 times NaN is NaN."""
    bad = ~np.isfinite(image).all(axis=2)
    image[bad] = 0
    return bad


def check_finite(path: str | Path, bad: np.ndarray) -> None:
    """Raises InputError where any of the pixels `bad` of a picture counts, (H, W) bool."""
    if number := int(np.count_nonzero(bad)):
        raise InputError(f"{path}: {number} pixels are NaN or infinite; mend or mask them first")


def read_mask(path: str | Path, turned: bool = True) -> np.ndarray:
    """Reads a mask: (H, W) float32 in [0, 1], the stored values, never decoded from sRGB; of a file
    of whole numbers that holds black and one other colour alone, as programs write what is true and
    labels, the other is white. As much as a pixel is transparent, it is black: programs that cut
    objects out leave masks whose colour is white all over. Of a file of alpha alone that is the
    mask.

    Raises InputError for what `load` refuses, for values outside [0, 1] but for rounding, and for a
    picture whose channels differ (a photograph given as a mask, most likely).
    """
    alone = not heif.names(path) and has_alpha(path) and _header(path).nchannels == 1
    if alone:
        pixels = read_alpha(path, turned)[..., None]
    else:
        pixels, *_ = _read_colours(Path(path), turned)
    shown = (pixels > 0).any(axis=-1)
    if counted(path) and 0 < shown.sum() < shown.size:
        lit = pixels[shown]
        if (lit == lit[0]).all():  # what is true, or a label, grey or of a palette
            pixels = shown[..., None].astype(np.float32)
    if not (pixels == pixels[..., :1]).all():
        raise InputError(
            f"{path}: a mask has to be grey, but this picture's channels differ: save it with "
            "white where pixels count and black elsewhere, also where colours are labels"
        )
    mask = np.ascontiguousarray(pixels[..., 0], dtype=np.float32)
    if not ((mask >= -_ROUNDED) & (mask <= 1 + _ROUNDED)).all():
        raise InputError(f"{path}: a mask's values have to lie in [0, 1]")
    mask = np.clip(mask, 0, 1)
    most = mask.max()
    if any(most == np.float32(1) / np.float32(full) for full in _INTEGER_FORMATS.values()):
        mask /= most
    alpha = None if alone else read_alpha(path, turned)
    if alpha is None or multiplied(path):
        return mask
    return mask * np.clip(alpha, 0, 1)


def size(path: str | Path, turned: bool = True) -> tuple[int, int]:
    """Width and height of a picture, pixels, as `load` turns it. Reads its header alone. Raises
    InputError for a file that is none."""
    if raw.names(path):
        return raw.size(Path(path), turned)
    if heif.names(path):
        return heif.size(Path(path))
    spec = _header(path)
    over = turned and _orientation(spec) >= 5
    return _frame(spec)[::-1] if over else _frame(spec)


def grey(path: str | Path) -> bool:
    """Whether a picture has one channel of brightness alone. Raises InputError."""
    if raw.names(path) or heif.names(path):
        return False
    return len(_colour_channels(Path(path), _header(path))) == 1


def orientation(path: str | Path) -> int:
    """Exif's Orientation of a picture, 1 to 8; 1, upright, where it has none. Raises InputError."""
    if raw.names(path):
        return raw.orientation(Path(path))
    return 1 if heif.names(path) else _orientation(_header(path))


def counted(path: str | Path) -> bool:
    """Whether a picture is of whole numbers."""
    if raw.names(path) or heif.names(path):
        return True
    return _header(path).format.basetype in _INTEGER_FORMATS


def made_by(path: str | Path) -> str:
    """The program that a picture says it was written by, or "". Raises InputError."""
    if raw.names(path) or heif.names(path):
        return ""
    return _header(path).get_string_attribute("Software")


def _header(path: str | Path) -> oiio.ImageSpec:
    path = Path(path)
    version = (stat.st_mtime_ns, stat.st_size) if (stat := _stat(path)) else ()
    return _known_header(path, *version)


@functools.lru_cache(4096)
def _known_header(path: Path, *version: int) -> oiio.ImageSpec:
    """Of one version of a file, which many ask for, and which is dear where it has a gain map."""
    source = _opened(path)
    spec = _spec(source)
    source.close()
    return spec


def _stat(path: Path) -> os.stat_result | None:
    with suppress(OSError):
        return path.stat()
    return None


def read_alpha(path: str | Path, turned: bool = True) -> np.ndarray | None:
    """The alpha channel of a picture, (H, W) float32, integers scaled to [0, 1]; None where it has
    none. Raises InputError for what `load` refuses."""
    if raw.names(path):
        return None
    path = Path(path)
    if heif.names(path):
        pixels, _ = heif.read(path)
        return pixels[..., 3] if pixels.shape[2] == 4 else None
    source = _opened(path)
    try:
        spec = _spec(source)
        place = _alpha(spec)
        if place is None:
            return None
        pixels = _pixels(path, source, oiio.FLOAT)
    finally:
        source.close()
    alpha = np.ascontiguousarray(_framed(pixels, spec)[..., place], np.float32)
    return upright(alpha, _orientation(spec)) if turned else alpha


def has_alpha(path: str | Path) -> bool:
    """Whether a picture has an alpha channel. Raises InputError."""
    if raw.names(path):
        return False
    if heif.names(path):
        return read_alpha(path) is not None
    return _alpha(_header(path)) is not None


def multiplied(path: str | Path) -> bool:
    """Whether the colours of a picture with alpha are those over black already: an EXR's are, and
    a TIFF's that says so. Raises InputError."""
    if raw.names(path) or heif.names(path):
        return False
    if Path(path).suffix.lower() not in _ASSOCIATED:
        return False  # of BMP OpenImageIO does not say
    spec = _header(path)
    return _alpha(spec) is not None and not spec.get_int_attribute("oiio:UnassociatedAlpha", 0)


def write_exr(
    path: str | Path,
    image: np.ndarray,
    channels: list[str],
    metadata: dict[str, str | float | int],
    data: bool = False,
) -> None:
    """Writes a 32-bit float EXR, whole or not at all.

    image     (H, W, C) or, for one channel, (H, W); linear; NaN is kept as it is
    channels  C names, such as R, G, B or Y
    metadata  each entry becomes the attribute `isas:<key>`; `what` is the ImageDescription as well

    With R, G and B the file says that it is scene-linear with Rec. 709 primaries, by name
    (colorInteropID) and by numbers (chromaticities); without them, or with `data`, that it holds
    data, which no viewer should convert. Date and time are UTC.

    Raises IsasError naming the file when it cannot be written.
    """
    pixels = np.ascontiguousarray(image, dtype=np.float32)
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    if pixels.ndim != 3 or pixels.shape[2] != len(channels):
        raise ValueError(f"write_exr: shape {np.shape(image)} does not fit channels {channels}")
    height, width, count = pixels.shape
    spec = oiio.ImageSpec(width, height, count, oiio.FLOAT)
    spec.channelnames = tuple(channels)
    if set("RGB") <= set(channels) and not data:
        spec.attribute("oiio:ColorSpace", "lin_rec709_scene")
        spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), _REC709)
    else:
        spec.attribute("oiio:ColorSpace", "data")
    spec.attribute("compression", "zip")
    spec.attribute("utcOffset", 0.0)  # the header's date has no time zone of its own
    _describe(spec, {key: _attribute(value) for key, value in metadata.items()})
    _write(Path(path), "openexr", spec, pixels)


def to_display(image: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """Linear values to display values, uint8; any shape, such as (H, W, 3).

    One curve: x = clip(exposure · image, 0, 1), then the sRGB curve (IEC 61966-2-1), rounded.
    NaN becomes black: a caller who shows pictures that may hold NaN marks those pixels itself.
    """
    flat = np.asarray(image).reshape(-1)
    shown = np.empty(flat.shape, np.uint8)
    for part in memory.parts(flat.size):
        scaled = flat[part].astype(np.float64) * exposure
        clipped = np.clip(np.nan_to_num(scaled, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
        shown[part] = np.rint(srgb_encode(clipped) * 255.0)
    return shown.reshape(np.shape(image))


def exposure_for(pictures: Iterable[np.ndarray]) -> float:
    """The factor that brings the 99th percentile of all finite values of linear pictures, of any
    shapes, to 1, which is white; 1 where no such value is positive."""
    level = percentile(pictures, 99.0)
    return 1.0 / level if level > 0 else 1.0


def percentile(pictures: Iterable[np.ndarray], percent: float) -> float:
    """That of all finite values of pictures, of any shapes; 0 without any."""
    values = [np.asarray(picture)[np.isfinite(picture)] for picture in pictures]
    together = np.concatenate(values) if values else np.zeros(0)
    return float(np.percentile(together, percent)) if together.size else 0.0


def write_png(
    path: str | Path, image: np.ndarray, metadata: dict[str, str | float | int] | None = None
) -> None:
    """Writes an 8-bit picture, uint8 (H, W, C) already encoded for display, whole or not at all.

    The file says that it is sRGB. Each entry of `metadata` becomes a text chunk `isas:<key>`;
    `what` is the Description as well. Raises IsasError naming the file when it cannot be written.
    """
    pixels = np.ascontiguousarray(image)
    if pixels.dtype != np.uint8 or pixels.ndim != 3:
        raise ValueError(f"write_png: wants uint8 (H, W, C), got {pixels.dtype} {pixels.shape}")
    height, width, count = pixels.shape
    spec = oiio.ImageSpec(width, height, count, oiio.UINT8)
    spec.attribute("oiio:ColorSpace", "srgb_rec709_display")
    _describe(spec, {key: _text(value) for key, value in (metadata or {}).items()})
    _write(Path(path), "png", spec, pixels)


def write_preview(
    path: str | Path,
    image: np.ndarray,
    exposure: float = 1.0,
    metadata: dict[str, str | float | int] | None = None,
    data: bool = False,
) -> None:
    """Writes a PNG of a linear picture, (H, W, 1 or 3), shown through `to_display`; of `data`, the
    numbers as they are.

    Its text chunks state the curve and the exposure besides `metadata` (see `write_png`). Raises
    IsasError naming the file when it cannot be written.
    """
    curve = "clip(exposure * linear, 0, 1), then sRGB (IEC 61966-2-1), 8 bits"
    shown = None if data else to_display(image, exposure)
    if shown is None:
        curve, exposure = "none: clip(numbers, 0, 1), 8 bits", 1.0
        shown = np.rint(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)
    stated = {**(metadata or {}), "curve": curve, "exposure": float(exposure)}
    write_png(path, shown, stated)


def _describe(spec: oiio.ImageSpec, metadata: dict[str, str | float | int]) -> None:
    """Who made the picture, when (UTC) and what it is; `metadata`: of types the format holds."""
    now = datetime.datetime.now(datetime.timezone.utc)
    spec.attribute("Software", f"isas {__version__}")
    spec.attribute("DateTime", now.strftime("%Y:%m:%d %H:%M:%S"))
    if "what" in metadata:
        spec.attribute("ImageDescription", str(metadata["what"]))
    for key, value in {"date": now.isoformat(timespec="seconds"), **metadata}.items():
        spec.attribute(f"isas:{key}", value)


def _text(value: str | float | int) -> str:
    """A metadata value as a PNG's text chunk holds it; what lies outside ASCII is escaped."""
    return str(value).encode("ascii", "backslashreplace").decode()


def _attribute(value: str | float | int) -> str | float | int:
    """A metadata value in a type that an EXR header holds (its integers have 32 bits)."""
    if isinstance(value, (bool, np.bool_)):
        return str(bool(value))
    if isinstance(value, (int, np.integer)):
        return int(value) if int(value) in _INT32 else str(int(value))
    if isinstance(value, (float, np.floating)):
        return float(value)
    return str(value)


def _read_colours(path: Path, turned: bool) -> tuple[np.ndarray, bool, Said]:
    """The colour channels as stored, (H, W, 1 or 3) float32 with integers scaled to [0, 1], whether
    they are linear as is usual of such files, and what the file says of them. Raises InputError for
    a file that holds no such picture.
    """
    if raw.names(path):
        return raw.read(path, turned), True, Said()
    if heif.names(path):
        pixels, said = heif.read(path)
        return pixels[..., :3], False, said
    source = _opened(path)
    try:
        spec = _spec(source)
        if spec.format.basetype in _INTEGER_FORMATS:
            scale, linear = _INTEGER_FORMATS[spec.format.basetype], False
        elif spec.format.basetype in _FLOAT_FORMATS:
            scale, linear = 1.0, True
        else:
            raise InputError(f"{path}: pixels of type {spec.format}; 8 or 16 bit or float expected")
        # As stored and in floating point: what a damaged header asks for may be anything.
        needed, most = 8.0 * spec.image_pixels() * spec.nchannels, memory.available()
        if needed > most:
            raise InputError(
                f"{path}: {spec.width} × {spec.height} pixels need {memory.gib(needed)} of memory, "
                f"and {memory.gib(most)} are free"
            )
        pixels = _pixels(path, source, oiio.UNKNOWN)
    finally:
        source.close()
    pixels = _framed(pixels, spec)
    colours = pixels[..., _colour_channels(path, spec)].astype(np.float32) / np.float32(scale)
    if turned:
        colours = upright(colours, _orientation(spec))
    return colours, linear, profiles.said(path, spec)


def _pixels(path: Path, source: oiio.ImageInput, kind) -> np.ndarray:
    """All pixels of an open file, (H, W, C) of the type ``kind``. Raises InputError, also where a
    part of them is missing, which readers fill up with grey and note alone."""
    pixels, told = source.read_image(kind), _message(source)
    if pixels is None:
        raise InputError(f"{path}: cannot be read: {_first_line(told)}")
    if any(words in told.lower() for words in _BROKEN):
        raise InputError(
            f"{path}: is cut short or damaged, and a part of its pixels is missing: copy it anew"
        )
    return pixels


def _spec(source: oiio.ImageInput) -> oiio.ImageSpec:
    """What an open file's header says. Only an EXR holds a part of a picture: the offset that
    programs leave in a cropped PNG or TIFF says where it was cut out."""
    spec = source.spec()
    if source.format_name() != "openexr":
        spec.x = spec.full_x = spec.y = spec.full_y = 0
        spec.full_width, spec.full_height = spec.width, spec.height
    return spec


def _frame(spec: oiio.ImageSpec) -> tuple[int, int]:
    """Width and height of the picture, of which an EXR may hold but a part."""
    known = spec.full_width > 0 and spec.full_height > 0
    return (spec.full_width, spec.full_height) if known else (spec.width, spec.height)


def _framed(pixels: np.ndarray, spec: oiio.ImageSpec) -> np.ndarray:
    """The pixels of a file, (H, W, C), where they belong in the picture; 0 beside them."""
    width, height = _frame(spec)
    left, top = spec.x - spec.full_x, spec.y - spec.full_y
    if (left, top, spec.width, spec.height) == (0, 0, width, height):
        return pixels
    whole = np.zeros((height, width, pixels.shape[2]), pixels.dtype)
    down, across = (
        slice(max(at, 0), max(at + n, 0)) for at, n in ((top, spec.height), (left, spec.width))
    )
    part = pixels[max(-top, 0) :, max(-left, 0) :]
    place = whole[down, across]
    place[:] = part[: place.shape[0], : place.shape[1]]
    return whole


def _check_png(path: Path) -> None:
    """Raises InputError for a damaged PNG, some of which OpenImageIO does not survive."""
    with open(path, "rb") as file:
        if file.read(len(_PNG)) != _PNG:
            return
    try:
        # Not by Image.open, which takes large pictures for attacks.
        with PngImagePlugin.PngImageFile(path) as picture:
            picture.verify()  # the checksums; nothing is decoded
    except Exception as error:  # whatever its reader meets
        raise InputError(f"{path}: a damaged PNG: {' '.join(str(error).split())}") from error


@contextmanager
def _without_gains(path: Path) -> Iterator[Path]:
    """The file; of a JPEG with a gain map (Ultra HDR) a copy that says nothing of it: OpenImageIO
    would brighten the picture by that. What is opened within stays open."""
    with open(path, "rb") as file:
        first = file.read(_FIRST)
        if not first.startswith(_JPEG) or _GAIN not in first:
            yield path
            return
        with tempfile.NamedTemporaryFile(prefix="isas-", suffix=".jpg") as copy:
            copy.write((first + file.read()).replace(_GAIN, _PLAIN))
            copy.flush()
            yield Path(copy.name)


def _opened(path: Path) -> oiio.ImageInput:
    """A picture file, open. Raises InputError."""
    if not path.is_file():
        raise InputError(f"{path}: no such picture file")
    _check_png(path)
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)  # a product with alpha could not be decoded
    try:
        with _without_gains(path) as plain:
            source = oiio.ImageInput.open(str(plain), config)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if source is None:
        raise InputError(f"{path}: cannot be read as a picture: {_reason(oiio)}")
    return source


def _colour_channels(path: Path, spec: oiio.ImageSpec) -> list[int]:
    """Which channels hold colour: R, G, B, CIE's X, Y, Z or Y by name, else all but alpha and
    depth."""
    names = [name.upper() for name in spec.channelnames]
    for wanted in ("RGB", "XYZ", "Y"):
        if all(name in names for name in wanted):
            return [names.index(name) for name in wanted]
    others = [i for i in range(spec.nchannels) if i not in (_alpha(spec), spec.z_channel)]
    if len(others) not in (1, 3):
        told = "".join(f"; {line}" for line in partly([path]))
        names = ", ".join(spec.channelnames)
        raise InputError(f"{path}: no channels R, G, B or Y; it has {names}{told}")
    return others


def _parts(path: Path) -> list[str]:
    """Names of an EXR's parts, or their numbers, where there are several."""
    if path.suffix.lower() != ".exr":
        return []
    count = _header(path).get_int_attribute("oiio:subimages", 1)
    if count < 2:
        return []
    source = _opened(path)
    specs = [source.spec(number, 0) for number in range(count)]
    source.close()
    return [s.get_string_attribute("oiio:subimagename", str(n)) for n, s in enumerate(specs, 1)]


def _alpha(spec: oiio.ImageSpec) -> int | None:
    """Which channel is alpha, or None."""
    # Of a GIF OpenImageIO 3.2 names the channel after the last.
    if spec.alpha_channel >= spec.nchannels:
        return spec.channelnames.index("A") if "A" in spec.channelnames else None
    return None if spec.alpha_channel < 0 else spec.alpha_channel


def _orientation(spec: oiio.ImageSpec) -> int:
    """1, upright, for a tag that stands for no turn, as the 0 that cameras and scanners write."""
    found = spec.get_int_attribute("Orientation", 1)
    return found if 1 <= found <= 8 else 1


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Turns (H, W) or (H, W, C) float32 pixels as the Exif orientation (1 to 8) says."""
    if orientation == 1:
        return pixels
    stored = oiio.ImageBuf(np.ascontiguousarray(pixels))
    stored.specmod().attribute("Orientation", orientation)
    turned = oiio.ImageBufAlgo.reorient(stored).get_pixels(oiio.FLOAT)
    return turned if pixels.ndim == 3 else turned.reshape(turned.shape[:2])


def _write(path: Path, format_name: str, spec: oiio.ImageSpec, pixels: np.ndarray) -> None:
    """Writes `pixels` in the named format, atomically."""

    def write(temporary: Path) -> None:
        # The format is named, not guessed: a temporary name has no telling extension.
        output = oiio.ImageOutput.create(format_name)
        if output is None:
            raise OSError(_first_line(oiio.geterror()))
        done = output.open(str(temporary), spec) and output.write_image(pixels)
        message = "" if done else output.geterror()
        if not (output.close() and done):
            raise OSError(_first_line(message or output.geterror()))

    write_atomically(path, write)


def _reason(source) -> str:
    """Why ``source``, a file or OpenImageIO itself, failed, in one line."""
    return _first_line(_message(source))


def _message(source) -> str:
    try:
        return source.geterror()
    except UnicodeDecodeError:  # it quotes the damaged file
        return "damaged"


def _first_line(message: str) -> str:
    """OpenImageIO's messages may run over several lines; an error here has one."""
    lines = [line for line in message.splitlines() if line.strip()]
    return lines[0].strip() if lines else "no reason given"
