"""What a file says of its colours, and the way from there to light of Rec. 709's primaries, which
are sRGB's: through OpenImageIO, OpenColorIO within it, and LittleCMS (Pillow's) for grey ones."""

from __future__ import annotations

import functools
import hashlib
import io
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from PIL import Image, ImageCms, PngImagePlugin

_LINEAR, _SRGB = "lin_rec709_scene", "srgb_rec709_scene"
# What an ICC profile's own space is: D65, as OpenColorIO has it.
_XYZ = "CIE XYZ-D65 - Scene-referred"
# PNG's gAMA of 1/2.2 stands beside sRGB's colours in older files, for programs that know no other.
_AS_SRGB = ("g22_rec709_scene",)
# Transfer functions whose 1 is white; others' is a lamp's.
_PLAIN = ("lin", "srgb", "g18", "g22", "g24", "g26")
# Of light: one level of 8 bits. A profile that is sRGB's but for rounding is taken as sRGB.
_SAME = 0.004
_CLOSE = 0.002  # x and y of primaries
# x and y of sRGB's red, green, blue and white.
_PRIMARIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
# The same of CIE's X, Y and Z, as EXR says them.
_CIE = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)
_ADOBE = "g22_adobergb_scene"


@dataclass(frozen=True)
class Said:
    """What a file says of its numbers: an ``icc`` profile, or the name of a colour ``space``, which
    may have other ``primaries`` than its name tells; ``name``: in words; ``lost``: that it says
    something which is not known, or two things that differ."""

    icc: bytes | None = None
    space: str | None = None
    primaries: tuple[float, ...] | None = None
    name: str = ""
    lost: bool = False


def said(path: Path, spec: oiio.ImageSpec) -> Said:
    """Of a file that OpenImageIO has opened, whose colours these are."""
    icc, space = spec.getattribute("ICCProfile"), spec.get_string_attribute("oiio:ColorSpace")
    if spec.getattribute("pnm:binary") is not None:
        return Said()  # OpenImageIO calls all of these Rec709, those of light too
    if icc is not None:
        name = spec.get_string_attribute("ICCProfile:profile_description")
        return Said(icc=bytes(bytearray(icc)), name=f"colour profile '{name or 'of no name'}'")
    if {"icc_profile"} == {"icc_profile", "srgb"} & set(_of_png(path)):
        # The reader throws profiles away that are damaged, or not of this kind of picture.
        return Said(lost=True, name="a colour profile that is damaged or not of such a picture")
    if spec.get_int_attribute("Exif:ColorSpace", 1) == 0xFFFF:
        return _uncalibrated(path)
    primaries = spec.getattribute("chromaticities")
    names = {name.upper() for name in spec.channelnames}
    if primaries is None and set("XYZ") <= names and not set("RGB") <= names:
        primaries = _CIE
    own = space and oiio.ColorConfig.default_colorconfig().get_chromaticities(space)
    if primaries is not None and own:
        if not np.allclose(own, primaries, atol=_CLOSE):
            return Said(lost=True, name=f"colour space {space} beside other primaries")
        primaries = _PRIMARIES  # said once more
    if primaries is None and spec.getattribute("CICP") is None:
        primaries = _primaries(_of_png(path))
    if primaries is not None and not np.allclose(primaries, _PRIMARIES, atol=_CLOSE):
        return Said(None, space or None, tuple(primaries), "the primaries that it names")
    return Said(space=space or None, name=f"colour space {space}")


def to_linear(said: Said, decode: Callable | None) -> tuple[Callable | None, str | None]:
    """What turns a file's numbers ``(H, W, C)``, integers scaled to [0, 1], into light, and why
    that is not as the file says, in words, where it is not. ``decode``: what does it where a file
    says nothing; None for numbers that are light already, and for that."""
    if said.lost:
        return decode, said.name
    if said.icc is not None:
        if decode is None:  # light beyond 1 has no place in a profile
            named = said.name.lower()
            ours = "linear" in named and any(each in named for each in ("srgb", "709"))
            return decode, None if ours else said.name
        return _by_profile(said, decode)
    config, space = oiio.ColorConfig.default_colorconfig(), said.space
    found = decode
    if space is not None and space not in _AS_SRGB and not config.equivalent(space, _SRGB):
        plain = space.partition("_")[0] in _PLAIN and config.getColorSpaceIndex(space) >= 0
        if space in ("data", "raw", "unknown") or config.equivalent(space, _LINEAR):
            found = None if config.equivalent(space, _LINEAR) else decode
        elif not plain or (decode is None and not config.isColorSpaceLinear(space)):
            return decode, said.name
        else:
            found = _converted(space)
    if said.primaries is None:
        return found, None
    own = next((name for name in _linear_spaces() if _has(name, said.primaries)), None)
    if own is None:
        return found, said.name
    turn = _converted(own)
    return (turn if found is None else lambda pixels: turn(found(pixels))), None


def _by_profile(said: Said, decode: Callable) -> tuple[Callable, str | None]:
    how = _known(said.icc, decode)
    if how == "profile":
        return functools.partial(_through, said.icc), None
    return decode, None if how == "sRGB" else said.name


@functools.lru_cache(maxsize=64)
def _known(icc: bytes, decode: Callable) -> str:
    """``sRGB``, for a profile that is no other, ``profile`` for one that is, or nothing for one
    that cannot be heeded: a printer's, or a table's."""
    ramp = np.linspace(0, 1, 9, dtype=np.float32)
    every = np.stack(np.meshgrid(ramp, ramp, ramp), axis=-1).reshape(-1, 27, 3)
    try:
        if icc[16:20] == b"GRAY":
            grey = np.arange(256, dtype=np.uint8)[None]
            shown = ImageCms.profileToProfile(
                Image.fromarray(grey),
                ImageCms.ImageCmsProfile(io.BytesIO(icc)),
                ImageCms.createProfile("sRGB"),
                outputMode="RGB",
            )
            apart = decode(np.asarray(shown)[..., 0] / 255) - decode(grey / 255)
            return "sRGB" if np.abs(apart).max() < 2 * _SAME else ""
        apart = _through(icc, every) - decode(every)
    except (OSError, ValueError, ImageCms.PyCMSError):
        return ""
    return "sRGB" if np.abs(apart).max() < _SAME else "profile"


@functools.lru_cache(maxsize=1)
def _folder() -> tempfile.TemporaryDirectory:
    """Until the program ends."""
    return tempfile.TemporaryDirectory(prefix="isas-profiles-")


def _through(icc: bytes, pixels: np.ndarray) -> np.ndarray:
    """Light of numbers ``(H, W, 3)`` by a profile of three curves and a matrix. Raises
    ValueError for another."""
    # Files that were read are remembered by their names.
    file = Path(_folder().name) / f"{hashlib.blake2b(icc, digest_size=16).hexdigest()}.icc"
    if not file.exists():
        file.write_bytes(icc)
    buffer = oiio.ImageBuf(np.ascontiguousarray(pixels, np.float32))
    # Its direction is that of a display: from light to the device.
    found = oiio.ImageBufAlgo.ociofiletransform(buffer, str(file), unpremult=False, inverse=True)
    if found.has_error or found.nchannels != 3:
        found.geterror()
        raise ValueError
    return _converted(_XYZ)(found.get_pixels(oiio.FLOAT))


def _converted(space: str) -> Callable:
    """From a colour space of that name to light."""

    def convert(pixels: np.ndarray) -> np.ndarray:
        count = pixels.shape[2]
        three = np.ascontiguousarray(np.broadcast_to(pixels, (*pixels.shape[:2], 3)), np.float32)
        found = oiio.ImageBufAlgo.colorconvert(oiio.ImageBuf(three), space, _LINEAR)
        return found.get_pixels(oiio.FLOAT)[..., :count]

    return convert


@functools.lru_cache(maxsize=1)
def _linear_spaces() -> list[str]:
    config = oiio.ColorConfig.default_colorconfig()
    names = config.getColorSpaceNames()
    return [n for n in names if config.isColorSpaceLinear(n) and config.get_chromaticities(n)]


def _has(space: str, primaries: tuple[float, ...]) -> bool:
    own = oiio.ColorConfig.default_colorconfig().get_chromaticities(space)
    return np.allclose(own, primaries, atol=_CLOSE)


def _of_png(path: Path) -> dict:
    """What a PNG says of itself, by Pillow's names; nothing of another file."""
    if path.suffix.lower() != ".png":
        return {}
    try:
        with PngImagePlugin.PngImageFile(path) as picture:
            return picture.info
    except (OSError, SyntaxError, ValueError):
        return {}


def _primaries(found: dict) -> tuple[float, ...] | None:
    """Primaries and white, as OpenImageIO has them of other files, which it does not read of a
    PNG; None where nothing says them, or something else does."""
    if "srgb" in found or len(found.get("chromaticity", ())) != 8:
        return None
    return (*found["chromaticity"][2:], *found["chromaticity"][:2])


def _uncalibrated(path: Path) -> Said:
    """Of a photograph that says that it is not sRGB, and has no profile: cameras say Adobe RGB
    so."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large pictures, which are taken for attacks
            with Image.open(path) as picture:
                exif = picture.getexif()
                exif.get_ifd(0x8769)  # Pillow finds the next only through it
                index = exif.get_ifd(0xA005).get(1)
    except (OSError, SyntaxError, ValueError, KeyError, Image.DecompressionBombError):
        index = None
    if index == "R03":
        return Said(space=_ADOBE, name="Adobe RGB")
    return Said(lost=True, name="a colour space that is not sRGB and has no name")
