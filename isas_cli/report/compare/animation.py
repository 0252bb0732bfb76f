"""The optimisation as it went: an animated WebP with the methods side by side at equal billed time.

Between two snapshots a method shows the earlier one, so nobody is shown an image that it had not
yet reached.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
import OpenImageIO as oiio
from PIL import Image, ImageDraw, ImageFont

from ...records import Run, write_atomically
from .. import cells
from ..chart import Style
from ..figures import Picture
from . import labels
from .gather import Method
from .typical import pictured, typical_run, words

_SIDE = 256  # pixels of the longer side of each picture
_MARGIN, _TITLE, _STAMP = 8, 22, 44  # pixels: around pictures, above them, below them
_FRAMES = 60  # at most
_MILLISECONDS, _LAST_MILLISECONDS = 150, 2500
_LARGEST = 3_000_000  # bytes: the page holds the file
_QUALITIES = (85, 70, 50, 30, 15)


@dataclass(frozen=True)
class _Snapshot:
    """A method's view 0 at a moment: linear (H, W, 3), iteration, billed seconds."""

    image: np.ndarray
    iteration: int
    seconds: float


def write_animation(
    methods: list[Method], styles: dict[str, Style], folder: Path
) -> Picture | None:
    """Writes <scene>_optimisation.webp into `folder`; None where no run saved snapshots.

    methods: those of one scene; one whose run saved none is left out. Raises IsasError when
    the disk refuses.
    """
    methods, more = pictured(methods)
    runs = {method.label: typical_run(method) for method in methods}
    films = {label: film for label, run in runs.items() if len(film := _film(run)) > 1}
    if not films:
        return None
    targets = (
        cells.read_reduced(runs[label].folder / "frames" / "target_v00.exr") for label in films
    )
    target = next((image for image in targets if image is not None), None)
    rows = {"view 0": {} if target is None else {"target": target}}
    rows["view 0"]["start"] = next(iter(films.values()))[0].image
    exposure, reason = cells.exposure(rows, ("target", "start"))
    columns = {} if target is None else {"target": [_Snapshot(target, 0, 0.0)]}
    columns |= films
    size = _size([shot.image for film in films.values() for shot in film])
    pictures = [_picture(columns, styles, exposure, size, moment) for moment in _moments(films)]
    path = folder / f"{labels.stem(methods[0].scene)}_optimisation.webp"
    content = encoded(pictures)
    write_atomically(path, lambda temporary: temporary.write_bytes(content))
    chosen = words([method for method in methods if method.label in films])
    return Picture(
        path,
        f"View 0 during the optimisation, at equal billed seconds; a method shows its latest "
        f"snapshot.{more} {reason}. {chosen}",
    )


def _film(run: Run) -> list[_Snapshot]:
    """The snapshots that a run saved, the start first, by billed seconds."""
    film = []
    for path in sorted((run.folder / "frames").glob("progress_v00_i*.exr")):
        image = cells.read_reduced(path, _SIDE)
        stamp = _stamp(path)
        if image is not None and stamp is not None:
            film.append(_Snapshot(image, *stamp))
    start = cells.read_reduced(run.folder / "frames" / "start_v00.exr", _SIDE)
    if film and start is not None and min(shot.iteration for shot in film) > 0:
        film.append(_Snapshot(start, 0, 0.0))
    return sorted(film, key=lambda shot: shot.seconds)


def _stamp(path: Path) -> tuple[int, float] | None:
    """Iteration and billed seconds from a frame's metadata; None where it has none."""
    source = oiio.ImageInput.open(str(path))
    if source is None:
        oiio.geterror()  # OpenImageIO complains at the end of the process if nobody asks
        return None
    spec = source.spec()
    source.close()
    iteration, seconds = spec.getattribute("isas:iteration"), spec.getattribute("isas:seconds")
    return None if iteration is None or seconds is None else (int(iteration), float(seconds))


def _moments(films: dict[str, list[_Snapshot]]) -> list[float]:
    """The billed seconds at which some method has a new snapshot, thinned to `_FRAMES` at most."""
    every = np.unique([shot.seconds for film in films.values() for shot in film])
    if len(every) <= _FRAMES:
        return [float(x) for x in every]
    return [float(x) for x in every[np.linspace(0, len(every) - 1, _FRAMES).round().astype(int)]]


def _size(frames: list[np.ndarray]) -> tuple[int, int]:
    """Width and height at which all are shown: the largest, enlarged by a whole number, so that
    every pixel keeps the same size, as long as `_SIDE` allows."""
    height, width = (max(frame.shape[axis] for frame in frames) for axis in (0, 1))
    factor = max(_SIDE // max(height, width), 1)
    return width * factor, height * factor


def _picture(
    columns: dict[str, list[_Snapshot]],
    styles: dict[str, Style],
    exposure: float,
    size: tuple[int, int],
    moment: float,
) -> Image.Image:
    """The latest snapshot of each column at one moment, side by side, a time stamp below."""
    width, below = size[0], _TITLE + size[1]
    canvas = Image.new("RGB", (_MARGIN + len(columns) * (width + _MARGIN), below + _STAMP), "white")
    pen = ImageDraw.Draw(canvas)
    for place, (title, film) in enumerate(columns.items()):
        shot = max(
            (s for s in film if s.seconds <= moment), key=lambda s: s.seconds, default=film[0]
        )
        left = _MARGIN + place * (width + _MARGIN)
        shown = Image.fromarray(cells.colours(shot.image, exposure))
        canvas.paste(shown.resize(size, Image.Resampling.NEAREST), (left, _TITLE))
        colour = styles[title].colour if title in styles else "black"
        pen.text((left, 3), _fitting(pen, title, width), colour, _font(13))
        if len(film) > 1:
            last = ", its last" if shot is film[-1] else ""
            pen.text((left, below + 4), f"iteration {shot.iteration:,}{last}", "#555555", _font(11))
    pen.text((_MARGIN, below + 21), f"{moment:.2f} billed seconds", "black", _font(14))
    return canvas


def _fitting(pen: ImageDraw.ImageDraw, text: str, width: int) -> str:
    """The text, cut where it would run into the next picture."""
    while pen.textlength(text, font=_font(13)) > width and len(text) > 2:
        text = text[:-2].rstrip("…") + "…"
    return text


def _font(size: int) -> ImageFont.FreeTypeFont:
    """DejaVu Sans, which matplotlib brings along."""
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans.ttf", size)


def encoded(pictures: list[Image.Image], largest: int = _LARGEST) -> bytes:
    """The best of `_QUALITIES` that takes ``largest`` bytes at most, or the last."""
    durations = [_MILLISECONDS] * (len(pictures) - 1) + [_LAST_MILLISECONDS]
    for quality in _QUALITIES:
        buffer = io.BytesIO()
        pictures[0].save(
            buffer,
            "WEBP",
            save_all=True,
            append_images=pictures[1:],
            duration=durations,
            loop=0,
            quality=quality,
            method=4,
        )
        if buffer.tell() <= largest:
            break
    return buffer.getvalue()
