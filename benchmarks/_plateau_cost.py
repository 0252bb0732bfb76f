"""What one gradient of PRDPT's tasks costs, by method: `plateau_cost.py`, in a process per task.

usage: _plateau_cost.py ROUNDS STEPS METHODS OVERRIDES…

Prints, per round and method, one row: seconds of a step, the median of STEPS, and its paths.
"""

from __future__ import annotations

import statistics
import sys

import _rows
from _child import timed

from isas_cli.runtime import backend

UPDATES = "updates"  # of `plateau`'s step, what putting its states into the scene takes
SIDES = {
    "plateau": ["sampler=plateau"],
    "plateau_drawn": ["sampler=plateau", "sampler.base=differences"],
    UPDATES: ["sampler=plateau"],
    "finite_differences": ["sampler=finite_differences"],
    "direct": ["sampler=mitsuba", "sampler.silhouettes=direct"],
    "uniform": ["sampler=mitsuba", "sampler.silhouettes=uniform"],
    "grid": ["sampler=mitsuba", "sampler.silhouettes=grid"],
    "octree": ["sampler=mitsuba", "sampler.silhouettes=octree"],
}
GUIDED = ("grid", "octree")  # of many seconds a step


def loops(overrides: dict[str, list[str]]) -> dict:
    """A loop per side, all on one problem, that of the first."""
    from isas_cli.config.compose import compose, translate
    from isas_cli.engine import experiment
    from isas_cli.engine.choices import Choices
    from isas_cli.engine.display import RaceDisplay
    from isas_cli.engine.workshop import Workshop

    cfgs = {side: compose(translate(own)) for side, own in overrides.items()}
    checked = {side: experiment.checked(cfg) for side, cfg in cfgs.items()}
    with RaceDisplay(1) as display:
        first = next(iter(checked.values()))[0]
        problem = experiment.built(first, experiment.Phases(display))
    workshop = Workshop(problem)
    return {side: workshop.loop(Choices.of(cfgs[side]), *checked[side]) for side in cfgs}


def step(loop, number: int) -> float:
    """Seconds of one gradient at the start's values; all waits are in it."""
    values = loop.problem.unknowns.starts()
    # A run's widths half way.
    drawn = loop._distribution, 0, number, 0.5
    return timed(lambda: loop.estimator.estimate(values, *drawn))


def updates(loop) -> float:
    """Seconds of putting the states of one joint pair and of its residual into the scene, nothing
    traced: where geometry moves, most of it is Mitsuba building its BVH anew."""
    blur = loop.estimator.blur
    θ = blur.vector(loop.problem.unknowns.starts())
    σ = blur.widths(θ, 0.5)
    offsets = σ / 2, -σ / 2, σ, -σ
    return sum(timed(lambda: blur.write(θ + offset)) for offset in offsets)


def look(loop) -> float:
    """Seconds of one look at the images, for each step until the next."""
    refresh = loop.sampler.settings.refresh
    return timed(lambda: loop._look(0)) / refresh if refresh else 0.0


def main() -> None:
    rounds, steps, sides = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3].split(",")
    backend.start()
    every = loops({side: [*sys.argv[4:], *SIDES[side]] for side in sides})
    for loop in every.values():
        loop._look(0)
        for number in range(2):
            step(loop, number)
    for number in range(rounds):
        turn = number % len(sides)
        for side in sides[turn:] + sides[:turn]:
            first = 100 + number * steps
            loop, paths = every[side], every[side].estimator.paths_per_step
            if side == UPDATES:
                seconds, paths = statistics.median(updates(loop) for _ in range(steps)), 0
            else:
                found = [step(loop, first + i) for i in range(steps)]
                seconds = statistics.median(found) + look(loop)
            row = {"round": number, "side": side, "seconds": seconds, "paths": paths}
            _rows.emit(row)


if __name__ == "__main__":
    main()
