"""How long and how wide open a camera took a picture, as the picture itself says."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from ...runtime import heif

# Of Exif 2.3: the tag of its own directory, and those in it.
_EXIF, _TIME, _APERTURE, _SPEED = 0x8769, 0x829A, 0x829D, 0x8827


@dataclass(frozen=True)
class Taken:
    """``time``, seconds; ``aperture``, the f-number; ``speed``, ISO."""

    time: float
    aperture: float
    speed: float

    @property
    def exposure(self) -> float:
        """What a picture's brightness goes with."""
        return self.time * self.speed / self.aperture**2

    def __str__(self) -> str:
        time = f"1/{1 / self.time:.0f}" if self.time < 0.28 else f"{self.time:g}"
        return f"{time} s f/{self.aperture:g} ISO {self.speed:g}"


def read(file: Path) -> Taken | None:
    """None where the file says nothing of it, or not all three. Reads its header alone."""
    try:
        with warnings.catch_warnings():
            # Of a large picture, which Pillow is wary of, only the header is read.
            warnings.simplefilter("ignore")
            if heif.names(file):  # which Pillow does not read by itself
                said = Image.Exif()
                said.load(heif.exif(file))
                tags = said.get_ifd(_EXIF)
            else:
                with Image.open(file) as opened:
                    tags = opened.getexif().get_ifd(_EXIF)
        speed = tags.get(_SPEED, 0)
        found = [tags.get(_TIME, 0), tags.get(_APERTURE, 0)]
        found.append(speed[0] if isinstance(speed, tuple) else speed)
        time, aperture, speed = (float(x) for x in found)
    except Exception:  # whatever readers make of a format that is not theirs, or of broken tags
        return None
    return Taken(time, aperture, speed) if min(time, aperture, speed) > 0 else None
