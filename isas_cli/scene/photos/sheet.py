"""A contact sheet: every photograph with the object's outline and the known points over it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, PngImagePlugin

from ...runtime import images
from ...runtime.cache import digest
from ...runtime.files import write_atomically
from .checks import View
from .edges import Outline
from .photographs import Photographs

# Pixels; more views than that are thinned out evenly.
_WIDE, _GAP, _TEXT, _MOST = 320, 6, 16, 60
_LINE, _POINT, _FOUND = (0, 230, 80), (255, 60, 40), (60, 160, 255)
_DIMMED = 0.35  # what does not count
_OF = "isas:photographs"  # a PNG's word for whose sheet it is


def write(checked: list[View], photographs: Photographs, path: Path, folder: Path) -> int:
    """Writes the sheet of the set in ``folder`` as PNG; returns how many views are on it."""
    chosen = np.unique(np.linspace(0, len(checked) - 1, min(_MOST, len(checked))).round())
    surface = photographs.surface
    outline = None if surface is None else Outline(surface)
    cells = [_cell(checked[int(n)], photographs, outline) for n in chosen]
    columns = min(len(cells), 5)
    rows = [cells[n : n + columns] for n in range(0, len(cells), columns)]
    heights = [max(cell.height for cell in row) + _GAP for row in rows]
    sheet = Image.new("RGB", (columns * (_WIDE + _GAP) + _GAP, sum(heights) + _GAP), (24, 24, 24))
    top = _GAP
    for row, height in zip(rows, heights):
        for column, cell in enumerate(row):
            sheet.paste(cell, (_GAP + column * (_WIDE + _GAP), top))
        top += height
    of = PngImagePlugin.PngInfo()
    of.add_text(_OF, _mark(folder))
    write_atomically(path, lambda temporary: sheet.save(temporary, format="PNG", pnginfo=of))
    return len(cells)


def shows(path: Path, folder: Path) -> bool:
    """Whether a file is a sheet of the set in ``folder``."""
    try:
        with Image.open(path) as opened:
            return opened.info.get(_OF) == _mark(folder)
    except (OSError, SyntaxError, ValueError):
        return False


def _mark(folder: Path) -> str:
    """Of a folder, which a file that may be given away does not tell."""
    return digest(str(folder.resolve()))


def _cell(view: View, photographs: Photographs, outline: Outline | None) -> Image.Image:
    """One photograph, its name below."""
    shown, camera = view.photograph, view.photograph.camera
    light = shown.image * np.where(shown.mask > 0, 1, _DIMMED)[..., None]
    scale = _WIDE / camera.width
    size = _WIDE, max(1, round(camera.height * scale))
    small = Image.fromarray(images.to_display(light)).resize(size, Image.Resampling.BILINEAR)
    cell = Image.new("RGB", (size[0], size[1] + _TEXT), (24, 24, 24))
    cell.paste(small, (0, 0))
    draw = ImageDraw.Draw(cell)
    if outline is not None:
        for (x0, y0), (x1, y1) in outline.seen(camera) * scale:
            draw.line((x0, y0, x1, y1), fill=_LINE, width=1)
    if photographs.capture.points is not None:
        pixels, depth = camera.project(photographs.capture.points)
        keep = depth > 0
        if view.points is not None and photographs.capture.observed:
            keep &= np.isin(np.arange(len(pixels)), view.points[0])
        for x, y in pixels[keep] * scale:
            draw.line((x - 3, y, x + 3, y), fill=_POINT)
            draw.line((x, y - 3, x, y + 3), fill=_POINT)
    if view.points is not None:
        for x, y in view.points[1] * scale:
            draw.ellipse((x - 3, y - 3, x + 3, y + 3), outline=_FOUND)
    draw.rectangle((0, size[1], size[0], size[1] + _TEXT), fill=(24, 24, 24))
    told = f"{camera.name}{', held out' if view.held else ''}"
    # Pillow's own font has no other letters.
    draw.text((2, size[1] + 2), told[-52:].encode("ascii", "replace").decode(), fill=(220,) * 3)
    return cell
