"""What stage 1 takes of a run's billed time with every sampler, at the default settings.

Looks and steps are timed in turn within one process per scene, sampler after sampler, round after
round; medians over the rounds. A run of the default budget is then gone through iteration by
iteration: `share` is what its looks take of it, `share_half` and `share_double` of half and twice
that budget. A first look may be dearer than later ones, and later ones become rarer.

Writes results/stage1_share.csv.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from pathlib import Path

import _rows
import pages
import pandas

HERE = Path(__file__).parent
SCENES = ("pottery", "jumpydumpy", "dodoco")
SECONDS = 60.0
TARGET = 0.08


class Side:
    """One sampler's looks and steps, on a problem that all share."""

    def __init__(self, problem, cfg, name: str, overrides: list[str]):
        from isas_cli import losses
        from isas_cli.config.compose import compose, instantiate
        from isas_cli.engine.optimiser import Stepper
        from isas_cli.estimators.two_path import TwoPath

        self.problem, self.name, batch = problem, name, cfg.estimator.batch
        node, loss = compose([*overrides, f"sampler={name}"]).sampler, losses.L2()
        self.sampler = instantiate(node, "sampler").on(problem, loss, batch)
        self.stepper = Stepper(problem.unknowns, cfg.optimizer)
        self.estimator = TwoPath(problem, loss, batch)
        self.firsts, self.looks, self.steps = [], [], []

    def _timed(self, into: list, work) -> None:
        from isas_cli.runtime import backend

        backend.sync()
        start = time.perf_counter()
        work()
        backend.sync()
        into.append(time.perf_counter() - start)

    def _look(self, base: int, iteration: int) -> None:
        import drjit as dr

        moments = None
        if "moments" in self.sampler.settings.needs and iteration and self.stepper.taken:
            moments = self.stepper.moments(0.1)
        weights = self.sampler.look(self.stepper.values, base, iteration, moments)
        self.distribution = self.sampler.distribution(weights)
        dr.eval(self.distribution.cdf)

    def _step(self, iteration: int) -> None:
        unknowns = self.problem.unknowns
        unknowns.attach(self.stepper.values)
        self.estimator.accumulate(self.distribution, 1, iteration)
        self.stepper.step(unknowns.gradients(), 0.0)

    def round(self, number: int, steps: int) -> None:
        """A first look, some steps, a later look, some steps."""
        self._timed(self.firsts, lambda: self._look(number + 1, 0))
        for i in range(steps):
            self._timed(self.steps, lambda: self._step(2 * number * steps + i))
        self._timed(self.looks, lambda: self._look(number + 1, 64))
        for i in range(steps):
            self._timed(self.steps, lambda: self._step((2 * number + 1) * steps + i))

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
    from _child import problem_of

    from isas_cli.config.compose import options
    from isas_cli.config.presets import PRESETS
    from isas_cli.runtime import backend

    backend.start()
    # What a path costs does not depend on how clean the targets are.
    overrides = [f"scene={scene}", "target.spp=1", *more]
    problem, cfg = problem_of(overrides)
    # All that draw pixels for path replay.
    drawing = [name for name in options("sampler") if name not in (*PRESETS, "differences")]
    sides = [Side(problem, cfg, name, overrides) for name in drawing]
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
        table = pandas.DataFrame(rows)
        table.to_csv(HERE / "results" / "stage1_share.csv", index=False, float_format="%.4g")
        pages.write()


if __name__ == "__main__":
    main()
