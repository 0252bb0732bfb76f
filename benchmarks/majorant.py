"""How many collisions pay where a medium is thin: the gradient's variance and time by majorant.

On smoke and lego, at the start, on the way and near the truth, with least majorants from 4 to 64
per size of the box (`volume._FEWEST`): the time of an estimate, and the summed variance of the
derivatives by density and by albedo, over those at 4. Sides take turns. Writes
results/majorant.csv.

    .venv/bin/python benchmarks/majorant.py
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from pathlib import Path

import _rows

HERE = Path(__file__).parent
SCENES = {"smoke": "scatters", "lego": "emits"}
LEAST = (4.0, 8.0, 16.0, 25.0, 64.0)
BLENDS = (0.0, 0.2, 0.5, 0.9)  # of start and truth


def measure(scene: str, estimates: int, batch: int) -> None:
    from isas_cli.runtime import backend

    backend.start()
    import numpy as np
    from _child import problem_of

    from isas_cli import losses
    from isas_cli.estimators.two_path import TwoPath
    from isas_cli.measure.variance.run import point
    from isas_cli.rendering import volume
    from isas_cli.rendering.pixels import PixelDistribution, Tiles
    from isas_cli.unknowns.parameters import as_numpy

    sizes = [f"scene.sizes.{size}.levels=1" for size in ("tiny", "default")]
    problem, _ = problem_of([f"scene={scene}", "target.spp=16", *sizes])
    uniform = PixelDistribution.uniform(Tiles.over(problem.views))
    sides = {least: TwoPath(problem, losses.L2(), batch) for least in LEAST}
    for blend in BLENDS:
        values = point(problem, blend)
        taken, seconds = ({least: [] for least in LEAST} for _ in range(2))
        for number in range(-3, estimates):
            for least, estimator in sides.items():
                volume._FEWEST[SCENES[scene]] = least  # read where a kernel is traced
                begun = time.perf_counter()
                gradients = estimator.estimate(values, uniform, 1, number % (1 << 24), 0.0)
                found = {key: as_numpy(g).ravel().astype("f8") for key, g in gradients.items()}
                if number >= 0:
                    seconds[least].append(time.perf_counter() - begun)
                    taken[least].append(found)
        for least in LEAST:
            row = {"scene": scene, "blend": blend, "least": least}
            pairs = zip(seconds[least], seconds[LEAST[0]])
            row["time"] = statistics.median(a / b for a, b in pairs)
            for key in values:
                own, first = (np.stack([g[key] for g in taken[n]]) for n in (least, LEAST[0]))
                name = "density" if "sigma_t" in key else "albedo"
                row[name] = own.var(axis=0, ddof=1).sum() / first.var(axis=0, ddof=1).sum()
            _rows.emit(row)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--estimates", type=int, default=200)
    parser.add_argument("--batch", type=int, default=16384)
    parser.add_argument("--scene", choices=SCENES, help="this one alone, in this process")
    chosen = parser.parse_args()
    if chosen.scene:
        return measure(chosen.scene, chosen.estimates, chosen.batch)
    import pandas

    rows = []
    for scene in SCENES:
        command = [sys.executable, __file__, "--scene", scene]
        command += ["--estimates", str(chosen.estimates), "--batch", str(chosen.batch)]
        rows += _rows.collect(command)
    table = pandas.DataFrame(rows)
    print(table.round(3).to_string(index=False))
    table.to_csv(HERE / "results" / "majorant.csv", index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
