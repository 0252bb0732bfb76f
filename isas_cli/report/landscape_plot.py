"""plots/landscape.png of a run, from landscape.csv and history.csv."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas

from .. import records
from ..records import VALUE_PREFIX
from .figures import COLOURS, figure, save, styled


def draw(folder: Path, note: str = "") -> Path:
    """Curves over one number, or maps over two, with the run's way on them, and ``note`` above.
    Returns the path."""
    run = records.load(folder)
    table = pandas.read_csv(folder / "landscape.csv")
    names = [c for c in table.columns if f"{VALUE_PREFIX}{c}" in run.history.columns]
    losses = [c for c in table.columns if c not in names]
    way = run.history[[f"{VALUE_PREFIX}{name}" for name in names]].to_numpy()
    path = folder / "plots" / "landscape.png"
    with styled():
        (_curves if len(names) == 1 else _maps)(table, names, losses, way, note, path)
    return path


def _curves(table: pandas.DataFrame, names, losses, way, note: str, path: Path) -> None:
    canvas = figure(7.5, 4.2)
    axes = canvas.subplots()
    place = table[names[0]].to_numpy()
    for name, colour in zip(losses, COLOURS):
        axes.plot(place, table[name], color=colour, label=_label(name))
    widest = table[losses[1]].to_numpy()
    axes.plot(way[:, 0], np.interp(way[:, 0], place, widest), "o-", color="black", label="run")
    axes.plot(way[-1:, 0], np.interp(way[-1:, 0], place, widest), "*", color="black", ms=12)
    axes.set_xlabel(names[0])
    axes.set_ylabel("loss")
    axes.set_title(note)
    axes.legend()
    save(canvas, path)


def _maps(table: pandas.DataFrame, names, losses, way, note: str, path: Path) -> None:
    canvas = figure(3.6 * len(losses) + 0.6, 4.1 if note else 3.8)
    canvas.suptitle(note)
    x, y = (np.unique(table[name]) for name in names)
    row = canvas.subplots(1, len(losses), sharey=True)
    top = max(table["hard"].max(), 1e-12)  # noise may leave an image of nothing below 0
    # Of noise it is below 0 in places as well, and blurred more than that at the corners.
    for axes, name in zip(row, losses):
        values = table[name].to_numpy().reshape(len(x), len(y)).T
        levels = np.linspace(0, top, 21)
        shown = axes.contourf(x, y, values, levels=levels, cmap="viridis", extend="both")
        axes.plot(way[:, 0], way[:, 1], ".-", color="white", lw=1)
        axes.plot(*way[0], "o", color="white")
        axes.plot(*way[-1], "*", color="white", ms=12)
        axes.set_title(_label(name))
        axes.set_xlabel(names[0])
    row[0].set_ylabel(names[1])
    canvas.colorbar(shown, ax=row, label="loss")
    save(canvas, path)


def _label(name: str) -> str:
    kind, _, widths = name.partition(" ")
    return f"blurred, σ = {', '.join(widths.split())}" if widths else kind
