"""A renderer that is none of Mitsuba's, and what it was called with, out of its pictures.

    python examples/black_box.py [SETTING…]

It draws a disc behind a board, with hard edges and noise, and has no derivative. What
`estimator=plateau` asks for is pictures alone: of parameters moved by offsets as wide as each
unknown's blur. A renderer that is another program is called by a command instead:

    export ISAS_ALLOW=./draw
    isas run scene=external 'external.command=./draw --radius={radius} --seed={seed} {out}' …
"""

from __future__ import annotations

import json
import os
import sys

import numpy as np

import isas_cli

SIDE, SAMPLES = 64, 4
TRUTH = {"x": 0.62, "y": 0.45, "radius": 0.18}
STARTS = {"x": (0.25, 0.2), "y": (0.75, 0.2), "radius": (0.08, 0.05)}  # and widths of the blur


def render(parameters: dict[str, np.ndarray], seed: int, view: int) -> np.ndarray:
    """Linear pixels ``(SIDE, SIDE, 3)``: means over random points of each pixel."""
    rng = np.random.default_rng([seed, view])
    rows, columns = np.mgrid[:SIDE, :SIDE][..., None]
    offsets = rng.random((2, SIDE, SIDE, SAMPLES))
    x, y = (columns + offsets[0]) / SIDE, (rows + offsets[1]) / SIDE
    away = np.hypot(x - parameters["x"], y - parameters["y"])
    colour = np.where(away[..., None] < parameters["radius"], [0.9, 0.5, 0.1], [0.1, 0.2, 0.4])
    board = (np.abs(x - 0.45) < 0.08)[..., None]
    return np.where(board, [0.3, 0.3, 0.3], colour).mean(axis=2)


def main(*settings: str) -> isas_cli.records.Run:
    os.environ["ISAS_ALLOW"] = "black_box"  # code that is not isas's own runs where this says so
    unknowns = ", ".join(
        f'"{name}": {{"start": {start}, "range": [0, 1], "lr": 0.02, '
        f'"blur": {{"start": {blur}, "end": 0.005}}}}'
        for name, (start, blur) in STARTS.items()
    )
    run = isas_cli.run(
        "scene=external",
        *("external.function=black_box.render", f"external.width={SIDE}"),
        f"external.parameters={json.dumps(TRUTH)}",
        f"scene.unknowns={{{unknowns}}}",
        *("estimator.batch=4096", "budget.iterations=300"),
        *settings,
    )
    for name, value in run.parameters().items():
        print(f"{name}: {float(value[0]):.3f}, in truth {TRUTH[name]}")
    return run


if __name__ == "__main__":
    main(*sys.argv[1:])
