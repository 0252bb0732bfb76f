"""Pictures of the page: before/after pairs as data addresses, small enough to travel with it."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from ...records import key_of
from .. import cells, frames
from .gather import Method
from .typical import pictured, typical_run, words

_VIEW = "00"
_LARGEST = 512  # pixels a side
_SMALL = 192  # pixels a side: below, pixels are doubled, tripled … and kept sharp
_QUALITY = 88
_MOST = 16383  # pixels a side of a WebP


@dataclass(frozen=True)
class Slide:
    """One slider: a picture of one method against another, addresses ready for `src`."""

    method: str
    before: str
    after: str
    caption: str


@dataclass(frozen=True)
class Group:
    """Sliders that show the same pair for each method."""

    before: str  # what is on the left
    after: str
    title: str
    slides: list[Slide]


def groups(methods: list[Method]) -> tuple[list[Group], str]:
    """The sliders of one scene and, in sentences, how its pictures are exposed and whose they are.

    start ↔ result and target ↔ result of view 0, and truth ↔ result (or, without a truth, start ↔
    result) of each unknown texture; of each method the run with the median final error. Pairs of
    which a picture was not saved are left out.
    """
    methods, more = pictured(methods)
    shown = {method.label: frames.read(typical_run(method).folder, _VIEW) for method in methods}
    captions = {method.label: words([method]) for method in methods}
    views = {label: own[_VIEW] for label, (own, _) in shown.items() if _VIEW in own}
    exposure, reason = cells.exposure(views, ("target", "result", "start"))
    made = [
        _group(f"View 0, {before} against result", before, views, exposure, captions)
        for before in ("start", "target")
    ]
    for name in sorted({name for _, textures in shown.values() for name in textures}):
        rows = {label: t[name] for label, (_, t) in shown.items() if name in t}
        before = "truth" if any("truth" in row for row in rows.values()) else "start"
        factor, _ = cells.exposure(rows, ("truth", "result", "start"), at_least=1.0)
        title = f"{key_of(name)}, {before} against result"
        made.append(_group(title, before, rows, factor, captions))
    return [group for group in made if group.slides], f"{reason}.{more}"


def data_address(image: np.ndarray) -> str:
    """uint8 (H, W, 3) as the address of a WebP inside the page; small pictures are enlarged."""
    picture = Image.fromarray(image)
    longest = max(picture.size)
    if longest > _LARGEST:
        picture.thumbnail((_LARGEST, _LARGEST), Image.Resampling.BOX)
    elif longest < _SMALL:
        factor = -(-_SMALL // longest)
        size = (picture.width * factor, picture.height * factor)
        picture = picture.resize(size, Image.Resampling.NEAREST)
    return _webp(picture, lossless=longest < _SMALL)


def file_address(path: Path) -> str:
    """A picture file as an address inside the page: a WebP as it is, others made one, at a
    fraction of a PNG's size."""
    if path.suffix == ".webp":
        return address("image/webp", path.read_bytes())
    with Image.open(path) as picture:
        return _webp(picture.convert("RGB"), lossless=False)


def least_width(path: Path) -> int:
    """The width in pixels below which a sheet's labels could not be read."""
    with Image.open(path) as picture:
        return round(0.6 * picture.width)


def address(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _webp(picture: Image.Image, lossless: bool) -> str:
    picture.thumbnail((_MOST, _MOST))
    buffer = io.BytesIO()
    picture.save(buffer, "WEBP", lossless=lossless, quality=_QUALITY, method=4)
    return address("image/webp", buffer.getvalue())


def _group(
    title: str, before: str, rows: frames.Frames, exposure: float, captions: dict[str, str]
) -> Group:
    slides = []
    for label, row in rows.items():
        if before in row and "result" in row:
            pair = (data_address(cells.colours(row[n], exposure)) for n in (before, "result"))
            slides.append(Slide(label, *pair, captions[label]))
    return Group(before, "result", title, slides)
