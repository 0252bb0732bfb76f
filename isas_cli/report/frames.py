"""Picture sheets: what was asked for, where the run began, what it found and what is wrong with it.

The frames are linear; a sheet shows them through `images.to_display` with one exposure, stated on
it, so that the pictures of a row, and the rows among themselves, can be compared.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from .. import images
from ..errors import InputError
from ..records import key_of
from .figures import STYLE, Picture, figure, save

_VIEW = re.compile(r"(target|start|result|error|density)_v(\d+)$")
_TEXTURE = re.compile(r"(truth|start|result)_(.+)$")
_LARGEST = 512  # pixels a side: a sheet shows less than that
_CELL, _GAP, _LEFT, _TOP, _BOTTOM = 2.1, 0.08, 0.4, 0.55, 0.75  # inches
_MAGENTA = (255, 0, 255)  # no colour map here holds it: it marks NaN and infinite pixels


@dataclass(frozen=True)
class _Scale:
    """How a column of numbers is coloured, and what its bar says."""

    label: str
    colours: Colormap
    norm: Normalize
    extend: str  # the ends at which values beyond the bar are shown in its last colour


def write_sheets(folder: Path) -> list[Picture]:
    """Writes plots/sheet.png (views) and plots/textures.png (unknown textures) from frames/*.exr.

    Returns those for which there were frames. A frame that is missing or cannot be read leaves a
    grey field that says so.
    """
    views: dict[str, dict[str, np.ndarray]] = {}
    textures: dict[str, dict[str, np.ndarray]] = {}
    for path in sorted(Path(folder).glob("frames/*.exr")):
        view, texture = _VIEW.match(path.stem), _TEXTURE.match(path.stem)
        match, rows = (view, views) if view else (texture, textures)
        frame = _read_reduced(path) if match else None
        if match and frame is not None:
            rows.setdefault(match.group(2), {})[match.group(1)] = frame
    made = []
    with matplotlib.rc_context({**STYLE, "axes.grid": False}):
        if views:
            made.append(_views_sheet(views, Path(folder) / "plots" / "sheet.png"))
        if textures:
            made.append(_textures_sheet(textures, Path(folder) / "plots" / "textures.png"))
    return made


def _views_sheet(views: dict[str, dict[str, np.ndarray]], path: Path) -> Picture:
    """One row for each view: target, start, result, error and density."""
    columns = ["target", "start", "result", "error", "density"]
    exposure, words = _exposure(views, ("target", "result", "start"))
    scales = {
        "error": _error_scale([row["error"] for row in views.values() if "error" in row]),
        "density": _density_scale([row["density"] for row in views.values() if "density" in row]),
    }
    rows = {f"view {int(name)}": row for name, row in sorted(views.items())}
    canvas = _sheet(rows, columns, exposure, scales, words)
    save(canvas, path)
    return Picture(
        path,
        f"Target, start, result, absolute error and sampling density. {words}. "
        "Non-finite pixels are magenta.",
    )


def _textures_sheet(textures: dict[str, dict[str, np.ndarray]], path: Path) -> Picture:
    """One row for each unknown texture: truth, start, result and error (if the truth is known)."""
    rows = {}
    for name, row in sorted(textures.items()):
        both = "truth" in row and "result" in row and row["truth"].shape == row["result"].shape
        error = {"error": np.abs(row["result"] - row["truth"])} if both else {}
        rows[key_of(name)] = {**row, **error}
    columns = ["start", "result"]
    if any("truth" in row for row in rows.values()):
        columns = ["truth", *columns, "error"]
    exposure, words = _exposure(rows, ("truth", "result", "start"), at_least=1.0)
    scales = {"error": _error_scale([row["error"] for row in rows.values() if "error" in row])}
    save(_sheet(rows, columns, exposure, scales, words), path)
    return Picture(
        path,
        f"Unknown textures ({', '.join(rows)}): {', '.join(columns)}. {words}. "
        "Non-finite texels are magenta.",
    )


def _sheet(
    rows: dict[str, dict[str, np.ndarray]],
    columns: list[str],
    exposure: float,
    scales: dict[str, _Scale],
    words: str,
) -> Figure:
    """Lays the cells out by hand, in inches, so that all have one size whatever the labels are."""
    heights = [_CELL * _aspect(row) for row in rows.values()]
    width = _LEFT + len(columns) * (_CELL + _GAP)
    below = _BOTTOM if scales.keys() & set(columns) else 0.1
    height = _TOP + sum(heights) + _GAP * len(rows) + below
    canvas = figure(width, height, layout=None)
    canvas.text(_LEFT / width, 1 - 0.12 / height, words, va="top", fontsize=9, color="#444444")
    bottom = height - _TOP
    for index, (title, row) in enumerate(rows.items()):
        cell_height = heights[index]
        bottom -= cell_height + _GAP
        for place, column in enumerate(columns):
            left = _LEFT + place * (_CELL + _GAP)
            box = (left / width, bottom / height, _CELL / width, cell_height / height)
            axes = canvas.add_axes(box, xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
            _cell(axes, row.get(column), exposure, scales.get(column))
            if index == 0:
                axes.set_title(column, fontsize=11, pad=4)
            if place == 0:
                axes.set_ylabel(_shortened(title, cell_height), fontsize=9)
    for column, scale in scales.items():
        if column in columns:
            left = _LEFT + columns.index(column) * (_CELL + _GAP)
            box = ((left + 0.1) / width, 0.52 / height, (_CELL - 0.2) / width, 0.12 / height)
            _bar(canvas, canvas.add_axes(box), scale)
    return canvas


def _cell(axes: Axes, image: np.ndarray | None, exposure: float, scale: _Scale | None) -> None:
    """One picture: through the display curve, or through its column's colour scale."""
    if image is None:
        axes.set_facecolor("#eeeeee")
        axes.text(0.5, 0.5, "not saved", ha="center", va="center", transform=axes.transAxes)
        return
    finite = np.isfinite(image).all(axis=2)
    if scale is None:
        shown = images.to_display(image, exposure)
    else:
        shown = scale.colours(scale.norm(np.nan_to_num(image.mean(axis=2))), bytes=True)[..., :3]
    axes.imshow(np.where(finite[..., None], shown, np.uint8(_MAGENTA)), aspect="auto")


def _bar(canvas: Figure, axes: Axes, scale: _Scale) -> None:
    """The colour bar of a column, horizontal, below its last row."""
    bar = canvas.colorbar(
        ScalarMappable(scale.norm, scale.colours),
        cax=axes,
        orientation="horizontal",
        extend=scale.extend,
    )
    bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    bar.ax.xaxis.set_minor_formatter(NullFormatter())
    bar.ax.tick_params(labelsize=8)
    bar.outline.set_visible(False)
    bar.set_label(scale.label, fontsize=8)


def _exposure(
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
    level = max(_percentile(frames, 99.0), at_least)
    exposure = 1.0 / level if level > 0 else 1.0
    if level == at_least:
        return exposure, f"sRGB curve, exposure {exposure:.3g}: {level:.3g} is white"
    reason = f"the 99th percentile of the {source}, {level:.3g}, is white"
    return exposure, f"sRGB curve, exposure {exposure:.3g}: {reason}"


def _error_scale(frames: list[np.ndarray]) -> _Scale:
    """Linear from zero to the 99th percentile of all rows."""
    top = _percentile([frame.mean(axis=2) for frame in frames], 99.0)
    norm = Normalize(0.0, top or 1.0, clip=True)
    label = "mean absolute difference of channels"
    return _Scale(label, matplotlib.colormaps["magma"], norm, "max")


def _density_scale(frames: list[np.ndarray]) -> _Scale:
    """Logarithmic around 1, which is uniform, over at least a factor of ten each way."""
    positive = [frame[..., 0][frame[..., 0] > 0] for frame in frames]
    low = min(_percentile(positive, 1.0) or 0.1, 0.1)
    high = max(_percentile(positive, 99.9), 10.0)
    label = "probability relative to uniform"
    norm = LogNorm(max(low, high * 1e-6), high, clip=True)
    return _Scale(label, matplotlib.colormaps["viridis"], norm, "both")


def _percentile(frames: list[np.ndarray], percent: float) -> float:
    """The percentile of all finite values, 0 without any."""
    values = np.concatenate([frame[np.isfinite(frame)] for frame in frames] or [np.zeros(0)])
    return float(np.percentile(values, percent)) if values.size else 0.0


def _aspect(row: dict[str, np.ndarray]) -> float:
    """Height over width of a row's pictures, kept where a label still fits."""
    frame = next(iter(row.values()))
    return float(np.clip(frame.shape[0] / frame.shape[1], 0.35, 2.0))


def _shortened(title: str, inches: float) -> str:
    """A row's label, cut in the middle where it would run into the next row."""
    room = int(inches / 0.065)  # a letter is about that wide
    if len(title) <= room:
        return title
    return title[: room // 2 - 1] + "…" + title[len(title) - (room - room // 2) :]


def _read_reduced(path: Path) -> np.ndarray | None:
    """A frame as (H, W, 3), box-averaged to at most _LARGEST pixels a side; None if unreadable."""
    try:
        frame = images.read(path, finite=False)
    except InputError:
        return None
    step = -(-max(frame.shape[:2]) // _LARGEST)
    height, width = (max(size // step, 1) for size in frame.shape[:2])
    cut = frame[: height * step, : width * step]
    if step == 1:
        return cut
    return cut.reshape(height, -1, width, cut.shape[1] // width, 3).mean(axis=(1, 3))
