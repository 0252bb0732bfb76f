"""One gradient step against Mitsuba's stock loop, on pottery with 16 × 512² views.

Sides in turn (A B C A B C …), a process each; a step's time is the median of its process, a ratio
is the median over the rounds with its range. Writes results/step_time.csv.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
from pathlib import Path

import pages
import pandas

HERE = Path(__file__).parent
SIDES = ("stock", "isas", "isas-ours", "isas-auto", "isas-single")
SCENE = ["scene=pottery", "scene.arguments.resolution=512"]
# The step's cost does not depend on how clean the targets are.
OVERRIDES = [*SCENE, "target.spp=1"]


def measure(side: str, batch: int, steps: int, *more: str) -> float:
    command = [sys.executable, str(HERE / "_child.py"), side, str(batch), str(steps), *OVERRIDES]
    done = subprocess.run([*command, *more], capture_output=True, text=True, check=True)
    return float(done.stdout.split()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--steps", type=int, default=25)
    chosen = parser.parse_args()
    measure("isas", 4096, 1)  # fills the caches of targets and kernels
    rows = []
    for batch in (4096, 65536):
        for round_ in range(chosen.rounds):
            for side in SIDES:
                seconds = measure(side, batch, chosen.steps)
                rows.append({"batch": batch, "round": round_, "side": side, "seconds": seconds})
    table = pandas.DataFrame(rows)
    table.to_csv(HERE / "results" / "step_time.csv", index=False, float_format="%.5f")
    pages.write()
    wide = table.pivot(index=["batch", "round"], columns="side", values="seconds")
    for side in SIDES[1:]:
        for batch, group in (wide[side] / wide["stock"]).groupby("batch"):
            print(
                f"{batch:6d} pixels: {side} / stock = {statistics.median(group):.2f} "
                f"({group.min():.2f} … {group.max():.2f} over {len(group)} rounds)"
            )


if __name__ == "__main__":
    main()
