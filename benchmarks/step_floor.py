"""The gradient step against its floor: the same rays traced, and nothing else done.

`passes` is the floor: both paths of every pixel traced and the second one differentiated, as the
estimator does it (short paths give radiance and derivative in one pass), with the rays in memory
and the adjoint a constant: no drawing, no camera, no target and loss, no Adam, no new values in
the scene. `prb` is what the same costs with Mitsuba's stock integrator: two primal passes and the
replay of the second. Both scatter the derivative to the unknowns: there is no gradient without.

Sides in turn within one process per scene, all on the same draws, in rotating order; a ratio is
the median over the rounds with its range. Writes results/step_floor.csv.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from pathlib import Path

import _rows
import pages
import pandas

HERE = Path(__file__).parent
SCENES = ("pottery", "jumpydumpy", "dodoco", "smoke", "lego")
SAMPLERS = ("uniform", "ours")
BATCHES = (65536, 4096)
TARGET = 1.3


def measure(scene: str, rounds: int, steps: int, more: list[str]) -> list[dict]:
    lists = ",".join(map(str, BATCHES)), ",".join(SAMPLERS)
    # The step's cost does not depend on how clean the targets are. Grids are whole from the start.
    overrides = [f"scene={scene}", "target.spp=1", *more]
    if scene in ("smoke", "lego"):
        overrides += [f"scene.sizes.{size}.levels=1" for size in ("tiny", "default")]
    command = [sys.executable, str(HERE / "_floor.py"), str(rounds), str(steps), *lists, *overrides]
    return [{"scene": scene} | row for row in _rows.collect(command)]


def spread(ratio: pandas.Series) -> str:
    return f"{statistics.median(ratio):.2f} ({ratio.min():.2f} … {ratio.max():.2f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--steps", type=int, default=10, help="steps per side and round")
    parser.add_argument("--quick", action="store_true", help="tiny scenes, two rounds of two steps")
    parser.add_argument("--output", type=Path, help="default: results/step_floor.csv, if not quick")
    chosen = parser.parse_args()
    rounds, steps, more, output = chosen.rounds, chosen.steps, [], chosen.output
    if chosen.quick:
        rounds, steps, more = 2, 2, ["size=tiny"]
    elif output is None:
        output = HERE / "results" / "step_floor.csv"
    rows = []
    for scene in SCENES:
        found = pandas.DataFrame(measure(scene, rounds, steps, more))
        rows.append(found)
        for (batch, sampler), group in found.groupby(["batch", "sampler"], sort=False):
            own = group["step"] / group["passes"]
            above = f", above {TARGET}" if statistics.median(own) > TARGET else ""
            stock = group["step"] / group["prb"]
            told = "" if stock.isna().all() else f", step / prb = {spread(stock)}"
            print(
                f"{scene:10s} {sampler:8s} {batch:6d} pixels: step / passes = {spread(own)}{told}, "
                f"step {1e3 * statistics.median(group['step']):.1f} ms{above}"
            )
    if output is not None:
        output.parent.mkdir(exist_ok=True)
        pandas.concat(rows).to_csv(output, index=False, float_format="%.6f")
        pages.write()


if __name__ == "__main__":
    main()
