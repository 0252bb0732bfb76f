"""Camera raw files, through LibRaw (`rawpy`): what the sensor counted, linear."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .errors import InputError, extra

ENDINGS = (".dng", ".nef", ".cr2", ".cr3", ".arw", ".raf", ".orf", ".rw2", ".pef")
# LibRaw's number of a turn → Exif's.
_FLIPS = {3: 3, 5: 8, 6: 6}


def names(path: str | Path) -> bool:
    """Whether a file is a camera's raw one, by its ending."""
    return Path(path).suffix.lower() in ENDINGS


def size(path: Path, turned: bool = True) -> tuple[int, int]:
    """Width and height of the picture as `read` turns it, pixels. Raises InputError."""
    with _opened(path) as raw:
        sizes = raw.sizes
    over = turned and sizes.flip & 4
    return (sizes.height, sizes.width) if over else (sizes.width, sizes.height)


def orientation(path: Path) -> int:
    """As Exif counts it. Raises InputError."""
    with _opened(path) as raw:
        return _FLIPS.get(raw.sizes.flip, 1)


def read(path: Path, turned: bool = True) -> np.ndarray:
    """(H, W, 3) float32: linear, in sRGB's colours, with the camera's own white balance, turned the
    way the file asks, unless not ``turned``; 1 is the white level. Raises InputError."""
    with _opened(path) as raw:
        pixels = raw.postprocess(
            gamma=(1, 1),
            no_auto_bright=True,
            adjust_maximum_thr=0,  # else the brightest pixel may become the white level
            use_camera_wb=True,
            output_bps=16,
            user_flip=None if turned else 0,
        )
    return pixels.astype(np.float32) / np.float32(65535)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator:
    """As `rawpy` has it. Raises InputError."""
    if not path.is_file():
        raise InputError(f"{path}: no such picture file")
    try:
        import rawpy
    except ImportError:
        raise InputError(
            f"{path}: camera raw files are read through rawpy, which is not installed: "
            f"{extra('raw')}"
        ) from None
    try:
        with rawpy.imread(str(path)) as raw:
            yield raw
    except (rawpy.LibRawError, OSError) as error:
        told = b" ".join(x for x in error.args if isinstance(x, bytes)).decode() or error
        raise InputError(f"{path}: cannot be read as a camera raw file: {told}") from error
