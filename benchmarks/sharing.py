"""How light and BSDF samples share the work, and what roulette saves: noise and time of a gradient.

On every scene with surfaces, at the start, all effects: the gradient's noise (`effects/probe.py`:
of each entry, the geometric mean of the ratio of its mean squares, ± one standard error) and the
time of an estimate, with the power heuristic's weights instead of the balance heuristic's, with
four light samples at the first hit (each of both heuristics), and with Russian roulette from the
first or second vertex on; over one light sample, balance heuristic, and the scene's roulette.
Writes results/sharing.csv.

    .venv/bin/python benchmarks/sharing.py
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

import _rows

HERE = Path(__file__).parent
SCENES = ("pottery", "bowl", "jumpydumpy", "dodoco_a", "catcake", "earth2mars", "earth")
SCENES += ("trashcan", "dodoco", "caustic_failure", "multires")
BATCHES = 64


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
    depth = problem.integrator.max_depth
    usual = Paths(depth, depth)
    many = dataclasses.replace(usual, lights=(4, 4))
    sides = {
        ("balance", 1, None): usual,
        ("power", 1, None): usual,
        ("balance", 4, None): many,
        ("power", 4, None): many,
    }
    sides |= {("balance", 1, n): dataclasses.replace(usual, roulette=n) for n in (1, 2)}
    measured = probe.Probe(problem, losses.L2(), 3)
    first = None
    for (heuristic, lights, roulette), paths in sides.items():
        for module in (attached, light, replayed):
            module.mis_weight = balance if heuristic == "balance" else power
        kernel = measured._kernel(problem.integrator.cut(paths), False)
        _, gradients, seconds = measured._repeated(kernel, paths, fixed=True)
        squares = {key: rows.astype(np.float64) ** 2 for key, rows in gradients.items()}
        first = first or (squares, seconds)
        noise, error = probe.noise_ratio(squares, first[0])
        row = {"scene": scene, "heuristic": heuristic, "lights": lights, "roulette": roulette}
        _rows.emit(row | {"noise": noise, "error": error, "time": seconds / first[1]})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", help=f"of {', '.join(SCENES)}", default=SCENES)
    parser.add_argument("--scene", help="this one alone, in this process")
    chosen = parser.parse_args()
    if chosen.scene:
        return measure(chosen.scene)
    import pandas

    rows = []
    for scene in chosen.scenes:
        rows += _rows.collect([sys.executable, __file__, "--scene", scene])
    table = pandas.DataFrame(rows)
    print(table.round(3).to_string(index=False))
    table.to_csv(HERE / "results" / "sharing.csv", index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
