"""A step of plateau-reduced gradients against one of Mitsuba's derivative, on PRDPT's six tasks.

Paper (§4, "Timing"): its iteration costs an eighth of the differentiable baseline's on average.

Sides in turn within one process per task, in rotating order, with the same batch (Mitsuba's: as
many paths a pixel as fit, at least one; its silhouettes' samples come on top); paths of a step are
in the table. Looks of drawn pixels are shared out over the steps until the next. `updates` is that
part of `plateau`'s own step that puts its states into the scene.

Mitsuba's derivative of what moves samples silhouettes; those seen by way of other surfaces guided
by an octree (its default), by a grid, uniformly, or not at all (`direct`: wrong where shadows
move). A ratio is the median over the rounds with its range. Writes results/plateau_cost.csv;
those guided, of up to a minute a step, only where asked for (results/plateau_cost_guided.csv):

    python benchmarks/plateau_cost.py cup shadows occlusion caustic --steps 1 \\
        --against grid octree --output benchmarks/results/plateau_cost_guided.csv
"""

from __future__ import annotations

import argparse
import statistics
import sys
from pathlib import Path

import _contest
import _rows
import pages
import pandas
from _plateau_cost import GUIDED, SIDES
from _plateau_table import asked

HERE = Path(__file__).parent


def measure(task: str, rounds: int, steps: int, sides: list[str], more: list[str]) -> list[dict]:
    overrides = [f"scene={task}", "~scene.method", "target.spp=16", "budget.seconds=1", *more]
    command = [sys.executable, str(HERE / "_plateau_cost.py"), str(rounds), str(steps)]
    found = _rows.collect([*command, ",".join(sides), *overrides])
    return [{"task": task} | row for row in found]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=3, help="steps per side and round")
    parser.add_argument("--batch", type=int, default=16384)
    others = [side for side in SIDES if side != "plateau"]
    usual = [side for side in others if side not in GUIDED]
    parser.add_argument("--against", nargs="+", default=usual, choices=others, metavar="SIDE")
    parser.add_argument("--quick", action="store_true", help="tiny scenes, one round of one step")
    parser.add_argument("--output", type=Path, help="default: results/plateau_cost.csv")
    chosen = asked(parser)
    rounds, steps, more = chosen.rounds, chosen.steps, [f"estimator.batch={chosen.batch}"]
    output = chosen.output or HERE / "results" / "plateau_cost.csv"
    if chosen.quick:
        rounds, steps, more = 1, 1, ["estimator.batch=1024", "size=tiny"]
    for task in chosen.tasks:
        found = pandas.DataFrame(measure(task, rounds, steps, ["plateau", *chosen.against], more))
        wide = found.pivot(index="round", columns="side", values="seconds")
        for side in chosen.against:
            ratio = wide[side] / wide["plateau"]
            print(
                f"{task:20s} {side:18s} / plateau: {statistics.median(ratio):8.2f} "
                f"({ratio.min():.2f} … {ratio.max():.2f})"
            )
        if not chosen.quick or chosen.output:
            _contest.write(output, found, ("task",), "%.6f")
            pages.write()


if __name__ == "__main__":
    main()
