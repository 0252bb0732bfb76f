"""`isas landscape`: the loss along a run's unknowns, hard and blurred, and the way it took."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas

from .. import records
from ..engine import experiment, resumption
from ..engine.display import Display
from ..records import VALUE_PREFIX, write_atomically
from ..runtime import interrupt
from ..runtime.budget import Budget
from ..runtime.errors import InputError, nearest
from . import one

FILE = "landscape.csv"
# Beyond start, truth and all that the run visited, in widths of the first blur: shown, and as far
# again as there is blur to speak of.
_BEYOND, _BLURRED = 1.0, 3.0
# Paths a pixel and point; of another renderer each is a whole picture.
_USUAL, _FEW = 32, 2


def main(folder: Path, along: list[str] | None = None, spp: int | None = None) -> int:
    """Measure and draw the landscape of the run in ``folder``; writes landscape.csv and
    plots/landscape.png beside its record and prints the picture's path.

    The other unknowns stay at the truth, or, where it is not known, where the run ended.
    ``along``: one or two numbers, as history.csv names them without "value/"; None: all, where the
    run has no more. Raises InputError for others, for unknowns without a blur, and where scene or
    targets have changed since the run.
    """
    if spp is not None and spp < 1:
        raise InputError(f"--spp {spp}: at least 1")
    run = records.load(folder)
    one.check_writable(folder, "a landscape is drawn beside the run: copy it")
    cfg = resumption.anywhere(folder, run)
    keys = run.manifest.get("unknowns", {})
    names = [c[len(VALUE_PREFIX) :] for c in run.history.columns if c.startswith(VALUE_PREFIX)]
    names = [name for name in names if _of_unknown(name, keys)]
    chosen = _chosen(along, names, folder)
    typed, _ = experiment.checked(cfg)
    _, (choices,) = experiment.started([cfg], typed)
    if choices.loss.windows:
        raise InputError(f"{folder}: loss={cfg.loss.name}: a landscape is of losses of pixels")
    with interrupt.prompt(), Display(Budget(iterations=1)) as display:
        phases = experiment.Phases(display)
        problem = experiment.built(typed, phases, (), [(run.manifest, folder)])
        phases.begin("landscape")
        spp = spp or (_FEW if problem.integrator.black_box else _USUAL)
        found = _measured(problem, choices, cfg.seed, run, chosen, spp, phases)
        phases.begin(None)
    _write(found, Path(folder))
    from ..report.landscape_plot import draw

    others = len(names) > len(chosen)
    stay = "the truth" if problem.truth_known else "the run's end"
    print(draw(Path(folder), f"the other unknowns: at {stay}" if others else ""))
    return 0


def _of_unknown(name: str, keys) -> bool:
    """Whether ``name`` is a number of an unknown, and not one that is derived from it."""
    key, _, entry = name.rpartition("/")
    return name in keys or (key in keys and entry.isdigit())


def _chosen(along: list[str] | None, names: list[str], folder: Path) -> list[str]:
    valid = f"it has: {', '.join(names)}" if names else "it has no unknown of few numbers"
    for name in along or []:
        if name not in names:
            raise InputError(f"{folder}: along {name}: {nearest(name, names)}")
    chosen = along or names
    if len(set(chosen)) != len(chosen) or len(chosen) not in (1, 2):
        raise InputError(f"{folder}: a landscape is along one or two numbers: --along; {valid}")
    return list(chosen)


def _measured(problem, choices, seed: int, run, names: list[str], spp: int, phases):
    from ..measure.landscape import measure, points
    from ..unknowns.blur import Blur

    blur = Blur(problem, "isas landscape")
    at = blur.vector(problem.unknowns.truths() or _last(problem, run.folder))
    start, end = (blur.widths(at, spent) for spent in (0.0, 1.0))
    places = _places(problem)
    entries = [places[name] for name in names]
    bounds, axes = [], []
    for name, entry in zip(names, entries):
        visited = [*run.history[f"{VALUE_PREFIX}{name}"], at[entry]]
        margin = _BEYOND * start[entry]
        low, high = np.nanmin(visited) - margin, np.nanmax(visited) + margin
        bounds.append((low, high))
        tail, count = _BLURRED * start[entry], points(problem, len(names))
        spacing = (high - low + 2 * tail) / (count - 1)
        # One of the points is where the minimum should be, which may be sharp.
        first = at[entry] - spacing * np.floor((at[entry] - low + tail) / spacing)
        axes.append(first + spacing * np.arange(count))
    # A blur that is narrower than the grid would show the sharp loss.
    spacing = np.array([axis[1] - axis[0] for axis in axes])
    narrower = np.maximum(np.sqrt(start * end)[entries], spacing)
    widths = [tuple(start[entries]), tuple(np.minimum(narrower, start[entries]))]
    loss, smooth = choices.loss, getattr(choices.estimator, "smooth", "image")

    def done(finished: int, total: int) -> None:
        interrupt.check()
        phases.display.phase(f"landscape {finished} of {total}")

    found = measure(problem, loss, at, entries, names, axes, widths, smooth, spp, seed, done)
    return found.within(bounds)


def _last(problem, folder: Path) -> dict:
    """The values that the run ended with."""
    arrays, _ = records.load_checkpoint(folder)
    values = problem.unknowns.values_of({k: arrays[f"value/{k}"] for k in problem.unknowns.keys})
    return problem.unknowns.values_of(problem.unknowns.arrays(values))


def _places(problem) -> dict[str, int]:
    """Which entry of all unknowns' a name of history.csv is."""
    places, offset = {}, 0
    for unknown in problem.unknowns:
        size = unknown.start.size
        for i in range(size):
            places[unknown.key if size == 1 else f"{unknown.key}/{i}"] = offset + i
        offset += size
    return places


def _write(found, folder: Path) -> None:
    grid = np.meshgrid(*found.axes, indexing="ij")
    table = {name: values.ravel() for name, values in zip(found.names, grid)}
    table["hard"] = found.hard.ravel()
    for σ, values in zip(found.widths, found.blurred):
        table["blurred " + " ".join(f"{width:.3g}" for width in σ)] = values.ravel()
    frame = pandas.DataFrame(table)
    write_atomically(folder / FILE, lambda path: frame.to_csv(path, index=False))
