"""What stage 1 takes of a run's billed time with every sampler, at the default settings.

Looks and steps are timed in turn within one process per scene, sampler after sampler, round after
round; medians over the rounds. A run of the default budget is then gone through iteration by
iteration: `share` is what its looks take of it, `share_half` and `share_double` of half and twice
that budget. A first look may be dearer than later ones, and later ones become rarer.

Writes results/stage1_share.csv.
"""

from __future__ import annotations

import argparse
import datetime
import statistics
import sys
from pathlib import Path

import _rows
import pages
import pandas
from _child import Side, problem_of

HERE = Path(__file__).parent
SCENES = ("pottery", "jumpydumpy", "dodoco")
SECONDS = 60.0
TARGET = 0.08


class Times(Side):
    """Of one sampler's looks and steps, on a problem that all share."""

    def __init__(self, problem, cfg, name: str, overrides: list[str]):
        super().__init__(problem, cfg.optimizer, cfg.estimator["batch"], name, overrides)
        self.forget()

    def round(self, number: int, steps: int) -> None:
        """A first look, some steps, a later look, some steps."""
        for half, (iteration, looks) in enumerate(((0, self.firsts), (64, self.looks))):
            looks.append(self.look(number + 1, iteration))
            self.steps += [self.step((2 * number + half) * steps + i) for i in range(steps)]

    def forget(self) -> None:
        self.firsts, self.looks, self.steps = [], [], []

    def row(self) -> dict:
        first, look, step = map(statistics.median, (self.firsts, self.looks, self.steps))
        found = {"sampler": self.name, "first_ms": 1e3 * first, "look_ms": 1e3 * look}
        found["step_ms"] = 1e3 * step
        for name, factor in (("share", 1.0), ("share_half", 0.5), ("share_double", 2.0)):
            found[name] = self._share(first, look, step, factor * SECONDS)
        return found

    def _share(self, first: float, look: float, step: float, budget: float) -> float:
        spent, looks, iteration = 0.0, 0.0, 0
        while spent < budget:
            if self.sampler.settings.due(iteration):
                more = look if iteration else first
                looks, spent = looks + more, spent + more
            spent += step
            iteration += 1
        return looks / spent


def one(scene: str, rounds: int, steps: int, more: list[str]) -> None:
    """Prints a row per sampler."""
    from isas_cli.config.compose import options
    from isas_cli.config.presets import PRESETS
    from isas_cli.runtime import backend

    backend.start()
    # What a path costs does not depend on how clean the targets are.
    overrides = [f"scene={scene}", "target.spp=1", *more]
    problem, cfg = problem_of(overrides)
    # All that draw pixels for path replay.
    drawing = [name for name in options("sampler") if name not in (*PRESETS, "differences")]
    sides = [Times(problem, cfg, name, overrides) for name in drawing]
    for number in range(-1, rounds):
        for side in sides:
            side.round(number + 1, steps)
            if number < 0:  # compiled and recorded now
                side.round(number + 1, 2)
                side.forget()
    for side in sides:
        _rows.emit({"scene": scene} | side.row())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=4, help="steps after each look")
    parser.add_argument("--quick", action="store_true", help="tiny scenes, nothing written")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    more = ["size=tiny"] if chosen.quick else []
    if chosen.one:
        return one(chosen.one, chosen.rounds, chosen.steps, more)
    rows = []
    for scene in SCENES:
        command = [sys.executable, __file__, *sys.argv[1:], "--one", scene]
        rows += _rows.collect(command)
        found = pandas.DataFrame([row for row in rows if row["scene"] == scene])
        print(found.to_string(index=False, float_format="%.3g"), flush=True)
    above = [f"{row['sampler']} on {row['scene']}" for row in rows if row["share"] > TARGET]
    print(f"above {TARGET:.0%} of {SECONDS:.0f} s: {', '.join(above) or 'none'}")
    if not chosen.quick:
        table = pandas.DataFrame(rows).assign(day=datetime.date.today().isoformat())
        table.to_csv(HERE / "results" / "stage1_share.csv", index=False, float_format="%.4g")
        pages.write()


if __name__ == "__main__":
    main()
