"""HEIC and HEIF pictures, as phones write them, through libheif (`pillow-heif`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .errors import InputError, extra
from .profiles import Said

_PLACES = [f"{colour}_{axis}" for colour in ("red", "green", "blue", "white") for axis in "xy"]
_UNSAID = 2  # of primaries that a file does not tell
_LAMPS = (16, 18)  # PQ and HLG, whose 1 is not white
ENDINGS = (".heic", ".heif", ".hif")


def names(path: str | Path) -> bool:
    """Whether a file is such a picture, by its ending."""
    return Path(path).suffix.lower() in ENDINGS


def size(path: Path) -> tuple[int, int]:
    """Width and height, pixels. Raises InputError."""
    return _opened(path).size


def read(path: Path) -> tuple[np.ndarray, Said]:
    """``(H, W, 1, 3 or 4) float32`` in [0, 1], as stored, the fourth its alpha, and what its
    colours are. The way up is a part of the format: its pixels have no other order. Raises
    InputError."""
    try:
        found = _opened(path)
        pixels = np.asarray(found)
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"{path}: cannot be read: {' '.join(str(error).split())}") from error
    most = 65535 if pixels.dtype == np.uint16 else 255
    colours = pixels if pixels.ndim == 3 else pixels[..., None]
    return colours.astype(np.float32) / np.float32(most), _said(found.info)


def exif(path: Path) -> bytes:
    """What the camera says of the picture, empty where it says nothing. Raises InputError."""
    return _opened(path).info.get("exif") or b""


def _said(info: dict) -> Said:
    icc, numbers = info.get("icc_profile"), info.get("nclx_profile")
    if icc:
        return Said(icc=icc, name="its colour profile")
    if not numbers:
        return Said()
    if numbers["transfer_characteristics"] in _LAMPS:
        return Said(lost=True, name="an HDR transfer function")
    if numbers.get("color_primaries") == _UNSAID:
        return Said()
    places = [numbers[f"color_primary_{name}"] for name in _PLACES]
    return Said(primaries=tuple(places), name="the primaries that it names")


def _opened(path: Path):
    """As `pillow_heif` has it. Raises InputError."""
    if not path.is_file():
        raise InputError(f"{path}: no such picture file")
    try:
        import pillow_heif
    except ImportError:
        raise InputError(
            f"{path}: HEIC pictures are read through pillow-heif, which is not installed: "
            f"{extra('heic')}"
        ) from None
    try:
        return pillow_heif.open_heif(path, convert_hdr_to_8bit=False)
    except (OSError, ValueError, RuntimeError, EOFError) as error:
        told = " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read as a HEIC picture: {told}") from error
