"""A race between ways of spending samples, and a plot of one's own from its records.

    python examples/race.py FOLDER [SETTING…]

Each sampler with several seeds, in turns, at equal billed time; then error against time, the median
of the seeds and their range. `isas compare FOLDER` makes tables and a page of the same records.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import numpy as np

import isas_cli
from isas_cli.cli.app import main as isas

SAMPLERS, SEEDS = ("uniform", "progress"), (1, 2, 3)


def main(folder: Path, *settings: str) -> Path:
    raced = [f"samplers=[{','.join(SAMPLERS)}]", f"seed=[{','.join(map(str, SEEDS))}]"]
    race = ["race", "scene=pottery", *raced, "budget.seconds=15", f"hydra.run.dir={folder}"]
    if status := isas([*race, *settings]):
        sys.exit(status)
    return drawn(folder)


def drawn(folder: Path) -> Path:
    """Every run lies in a folder of its own, with its settings beside its numbers."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    runs = [isas_cli.load(path.parent) for path in sorted(folder.rglob("manifest.json"))]
    figure, axes = pyplot.subplots(figsize=(6, 4), layout="constrained")
    for sampler in SAMPLERS:
        own = [run.history for run in runs if run.config["sampler"]["name"] == sampler]
        times = np.linspace(0, min(history.seconds.max() for history in own), 100)
        errors = [np.interp(times, each.seconds, each.parameter_rmse) for each in own]
        (line,) = axes.plot(times, np.median(errors, axis=0), label=sampler)
        axes.fill_between(
            times, *np.quantile(errors, [0, 1], axis=0), color=line.get_color(), alpha=0.2
        )
    axes.set(xlabel="billed seconds", ylabel="parameter error", yscale="log")
    axes.legend()
    path = folder / "race.png"
    figure.savefig(path, dpi=150)
    print(path)
    return path


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]), *sys.argv[2:])
