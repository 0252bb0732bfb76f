"""The cells of picture sheets: frames read, brought to display values or coloured by a scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from ..runtime import images
from ..runtime.errors import InputError
from .figures import figure

LARGEST = 512  # pixels a side: a sheet shows less than that
_MAGENTA = (255, 0, 255)  # no colour map here holds it: it marks NaN and infinite pixels
_CELL, _GAP, _LEFT, _RIGHT, _TOP, _BARS = 2.1, 0.08, 0.4, 0.3, 0.6, 0.6  # inches


@dataclass(frozen=True)
class Scale:
    """How numbers are coloured, the same for all cells that share it, and what its bar says."""

    label: str
    colours: Colormap
    norm: Normalize
    extend: str  # the ends at which values beyond the bar are shown in its last colour


def colours(image: np.ndarray, exposure: float, scale: Scale | None = None) -> np.ndarray:
    """A linear frame (H, W, 3) as uint8 (H, W, 3): by the display curve or, as the mean of its
    channels, by a scale. Pixels that are not finite are magenta."""
    finite = np.isfinite(image).all(axis=2)
    if scale is None:
        shown = images.to_display(image, exposure)
    else:
        shown = scale.colours(scale.norm(np.nan_to_num(image.mean(axis=2))), bytes=True)[..., :3]
    return np.where(finite[..., None], shown, np.uint8(_MAGENTA))


def draw(axes: Axes, image: np.ndarray | None, exposure: float, scale: Scale | None) -> None:
    """One cell; a grey field that says so where there is no frame."""
    if image is None:
        axes.set_facecolor("#eeeeee")
        axes.text(0.5, 0.5, "not saved", ha="center", va="center", transform=axes.transAxes)
        return
    axes.imshow(colours(image, exposure, scale), aspect="auto")


def bar(canvas: Figure, axes: Axes, scale: Scale) -> None:
    """The horizontal colour bar of a scale."""
    made = canvas.colorbar(
        ScalarMappable(scale.norm, scale.colours),
        cax=axes,
        orientation="horizontal",
        extend=scale.extend,
    )
    made.ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    made.ax.xaxis.set_minor_formatter(NullFormatter())
    made.ax.tick_params(labelsize=8)
    made.outline.set_visible(False)
    made.set_label(scale.label, fontsize=8)


@dataclass(frozen=True)
class Row:
    """One line of a sheet: pictures by column, None where none was saved. ``scales``: likewise; one
    that has no picture is shown as its bar."""

    title: str
    pictures: Mapping[str, np.ndarray | None]
    scales: Mapping[str, Scale] = field(default_factory=dict)

    @property
    def height(self) -> float:
        """In inches."""
        saved = (image for image in self.pictures.values() if image is not None)
        return _CELL * aspect(next(saved, np.zeros((1, 1)))) if self.pictures else _BARS


def sheet(
    rows: list[Row], columns: list[str], exposure: float, words: str, inks: Mapping[str, str] = {}
) -> Figure:
    """Lays the cells out by hand, in inches, so that all have one size whatever the labels are.
    ``words`` stand above; ``inks``: colours of columns' titles, others are black."""
    width = _LEFT + len(columns) * (_CELL + _GAP) + _RIGHT
    height = _TOP + sum(row.height + _GAP for row in rows) + _GAP
    canvas = figure(width, height, layout=None)
    canvas.text(_LEFT / width, 1 - 0.12 / height, words, va="top", fontsize=9, color="#444444")
    bottom = height - _TOP
    for row in rows:
        bottom -= row.height + _GAP
        for place, column in enumerate(columns):
            left = _LEFT + place * (_CELL + _GAP)
            if column in row.pictures:
                box = (left / width, bottom / height, _CELL / width, row.height / height)
                axes = canvas.add_axes(box, xticks=[], yticks=[])
                axes.spines[:].set_visible(False)
                draw(axes, row.pictures[column], exposure, row.scales.get(column))
                if row is rows[0]:
                    title, ink = shortened(column, _CELL), inks.get(column, "black")
                    axes.set_title(title, fontsize=11, pad=4, color=ink)
            elif column in row.scales:
                above = bottom + max(row.height / 2, 0.45)  # what its own words need
                box = ((left + 0.1) / width, above / height, (_CELL - 0.3) / width, 0.12 / height)
                bar(canvas, canvas.add_axes(box), row.scales[column])
        label, middle = shortened(row.title, row.height), (bottom + row.height / 2) / height
        canvas.text(0.2 / width, middle, label, rotation=90, ha="center", va="center", fontsize=9)
    return canvas


def exposure(
    rows: dict[str, dict[str, np.ndarray]], sources: tuple[str, ...], at_least: float = 0.0
) -> tuple[float, str]:
    """The factor that brings the 99th percentile of the first source at hand to white, and that
    in words. With `at_least` the level that turns white is no less than that."""
    for source in sources:
        frames = [row[source] for row in rows.values() if source in row]
        if frames:
            break
    else:
        return 1.0, "sRGB curve, exposure 1"
    level = max(images.percentile(frames, 99.0), at_least)
    factor = 1.0 / level if level > 0 else 1.0
    if level == at_least:
        return factor, f"sRGB curve, exposure {factor:.3g}: {level:.3g} is white"
    reason = f"the 99th percentile of the {source}, {level:.3g}, is white"
    return factor, f"sRGB curve, exposure {factor:.3g}: {reason}"


def error_scale(frames: list[np.ndarray]) -> Scale:
    """Linear from zero to the 99th percentile of all frames."""
    top = images.percentile([frame.mean(axis=2) for frame in frames], 99.0)
    norm = Normalize(0.0, top or 1.0, clip=True)
    label = "mean absolute difference of channels"
    return Scale(label, matplotlib.colormaps["magma"], norm, "max")


def density_scale(frames: list[np.ndarray]) -> Scale:
    """Logarithmic around 1, which is uniform, over at least a factor of ten each way."""
    positive = [frame[..., 0][frame[..., 0] > 0] for frame in frames]
    low = min(images.percentile(positive, 1.0) or 0.1, 0.1)
    high = max(images.percentile(positive, 99.9), 10.0)
    label = "probability relative to uniform"
    norm = LogNorm(max(low, high * 1e-6), high, clip=True)
    return Scale(label, matplotlib.colormaps["viridis"], norm, "both")


def aspect(frame: np.ndarray) -> float:
    """Height over width of a cell, kept where a label still fits."""
    return float(np.clip(frame.shape[0] / frame.shape[1], 0.35, 2.0))


def shortened(title: str, inches: float) -> str:
    """A label cut in the middle where it would run into the next cell."""
    room = int(inches / 0.065)  # a letter is about that wide
    if len(title) <= room:
        return title
    return title[: room // 2 - 1] + "…" + title[len(title) - (room - room // 2) :]


def read(path: Path) -> np.ndarray | None:
    """A frame as (H, W, 3); None if unreadable."""
    try:
        return images.read(path, finite=False)
    except InputError:
        return None


def read_reduced(path: Path, largest: int = LARGEST) -> np.ndarray | None:
    """A frame ``reduced``; None if unreadable."""
    frame = read(path)
    return None if frame is None else reduced(frame, largest)


def difference(path: Path, other: Path) -> np.ndarray | None:
    """|frame − other frame|, then ``reduced``, as an error's own picture is: means of the frames
    would have less noise than they. None where one is unreadable or the sizes differ."""
    both = read(path), read(other)
    if any(each is None for each in both) or both[0].shape != both[1].shape:
        return None
    return reduced(np.abs(both[0] - both[1]))


def reduced(frame: np.ndarray, largest: int = LARGEST) -> np.ndarray:
    """Box-averaged to at most ``largest`` pixels a side."""
    step = -(-max(frame.shape[:2]) // largest)
    height, width = (max(size // step, 1) for size in frame.shape[:2])
    cut = frame[: height * step, : width * step]
    if step == 1:
        return cut
    return cut.reshape(height, -1, width, cut.shape[1] // width, 3).mean(axis=(1, 3))
