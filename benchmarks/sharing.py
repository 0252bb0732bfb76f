"""How light and BSDF samples share the work, and what roulette saves: noise and time of a gradient.

On the scenes of `effects.py`, at the start, all effects: the gradient's noise (`effects/probe.py`:
of each entry, the geometric mean of the ratio of its mean squares, ± one standard error) and the
time of an estimate, with four light samples at the first hit, each picked from four directions,
with one that is, and with four that are not; with the power heuristic's weights instead of the
balance heuristic's (of one sample and of four); with Russian roulette from the first or second
vertex on; and with directions found the other way: by tickets at one sample, by Mitsuba's search in
the map of the sky at four of four; over one light sample of one direction, balance heuristic, and
the scene's roulette. Sides take turns; times are medians of the turns' ratios.
Writes results/sharing.csv.

    .venv/bin/python benchmarks/sharing.py
"""

from __future__ import annotations

import argparse
import dataclasses
import statistics
import sys

import _contest
import _rows
import pages
from effects import SCENES
from reproduce import RESULTS

BATCHES, TURNS = 64, 5


@dataclasses.dataclass(frozen=True)
class Side:
    """``directions``: that each light sample is picked from; ``other``: with directions to the sky
    found the other way than in runs."""

    heuristic: str = "balance"
    lights: int = 1
    directions: int = 1
    roulette: int | None = None
    other: bool = False


def measure(scene: str) -> None:
    from isas_cli.runtime import backend

    backend.start()
    import drjit as dr
    import numpy as np
    from _child import problem_of

    from isas_cli import losses
    from isas_cli.effects import probe
    from isas_cli.rendering import attached, light, replayed
    from isas_cli.rendering.integrators import Paths

    balance = light.mis_weight
    probe._LEAST_BATCHES = probe._MOST_BATCHES = BATCHES

    def power(a, b):
        return balance(dr.square(a), dr.square(b))

    problem, _ = problem_of([f"scene={scene}", "target.spp=16"])
    depth, sky_for = problem.integrator.max_depth, light.sky_for
    tickets, usual = sky_for(problem.scene, 4), Side()
    sides = [Side(h, n, n) for n in (1, 4) for h in ("balance", "power")]
    sides += [Side(directions=4), Side(lights=4)] + [Side(roulette=n) for n in (1, 2)]
    if tickets is not None:
        sides += [Side(lights=n, directions=n, other=True) for n in (1, 4)]
    paths = {
        side: Paths(
            *(depth, depth, (side.lights, side.lights), side.roulette), directions=side.directions
        )
        for side in sides
    }
    measured = probe.Probe(problem, losses.L2(), 3)
    kernels = {
        side: measured._kernel(problem.integrator.cut(own), False) for side, own in paths.items()
    }
    squares, seconds = {}, {side: [] for side in sides}
    for _ in range(TURNS):
        for side, own in paths.items():
            for module in (attached, light, replayed):  # read where a kernel is traced
                module.mis_weight = balance if side.heuristic == "balance" else power
                module.sky_for = sky_for
                if side.other:
                    module.sky_for = lambda *_, lights=side.lights: None if lights > 1 else tickets
            _, gradients, spent = measured._repeated(kernels[side], own, fixed=True)
            seconds[side].append(spent)
            squares[side] = {key: rows.astype(np.float64) ** 2 for key, rows in gradients.items()}
    for side in sides:
        noise, error = probe.noise_ratio(squares[side], squares[usual])
        time = statistics.median(a / b for a, b in zip(seconds[side], seconds[usual]))
        row = {"scene": scene} | dataclasses.asdict(side)
        _rows.emit(row | {"noise": noise, "error": error, "time": time})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", help=f"of {', '.join(SCENES)}")
    parser.add_argument("--scene", help="this one alone, in this process")
    chosen = parser.parse_args()
    if chosen.scene:
        return measure(chosen.scene)
    import pandas

    for scene in chosen.scenes or SCENES:
        rows = _rows.collect([sys.executable, __file__, "--scene", scene])
        print(pandas.DataFrame(rows).round(3).to_string(index=False), flush=True)
        _contest.write(RESULTS / "sharing.csv", pandas.DataFrame(rows))
    pages.write()


if __name__ == "__main__":
    main()
