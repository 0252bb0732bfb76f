"""One scene of `step_floor.py`, in a process of its own: prints a row per round.

usage: _floor.py ROUNDS STEPS BATCHES SAMPLERS OVERRIDES…   (BATCHES, SAMPLERS: with commas)

Times are medians over STEPS, in seconds. A material of another scene would be compiled into every
kernel of this one, hence a process per scene.
"""

from __future__ import annotations

import itertools
import math
import statistics
import sys

import _rows
from _child import Side, problem_of, timed

from isas_cli.runtime import backend

_WARM_UP = 5
SIDES = ("step", "passes", "prb")


class Sides(Side):
    """``step``: a gradient step, from its values to new ones. ``passes`` and ``prb``: two ways to
    trace the rays of its two paths, drawn and spawned beforehand, with a fixed adjoint. Media that
    only emit and absorb have no counterpart of Mitsuba's: there is no ``prb``."""

    def __init__(self, problem, cfg, batch: int, name: str, overrides: list[str]):
        import drjit as dr
        from mitsuba.python.ad.integrators.common import RBIntegrator

        super().__init__(problem, cfg.optimizer, batch, name, overrides)
        self.look(1, 0)
        self._spawn = dr.freeze(self._spawned(batch))
        self._passes = {"passes": dr.freeze(own_passes(problem.integrator))}
        if type(problem.integrator.mitsuba).sample is not RBIntegrator.sample:
            self._passes["prb"] = dr.freeze(stock_passes(problem.integrator))
        self.names = ("step", *self._passes)

    @staticmethod
    def _spawned(batch: int):
        import drjit as dr

        from isas_cli.rendering import rays

        def spawned(sensors, views, distribution, seeds):
            view, column, row, _ = distribution.draw(batch, seeds[0])
            both = []
            for seed in seeds[1:]:
                stream = rays.stream(seed, batch)
                ray, _ = rays.spawn(sensors, views, view, column, row, stream)
                both.append((ray.o, ray.d))
            dr.eval(both)
            return both

        return spawned

    def _seeds(self, i: int) -> list:
        import drjit as dr
        import mitsuba as mi

        from isas_cli.runtime import streams

        purposes = ("draw", "primal", "adjoint")
        return [dr.opaque(mi.UInt32, streams.seed(1, i, purpose)) for purpose in purposes]

    def measure(self, side: str, i: int) -> float:
        """Seconds of step ``i``, or of its passes."""
        if side == "step":
            return self.step(i)
        p, seeds = self.problem, self._seeds(i)
        both = self._spawn(p.sensors, p.views, self.distribution, seeds)
        p.unknowns.attach(self.stepper.values)
        return timed(lambda: self._passes[side](p.scene, p.unknowns.leaves, both, seeds))


def _stream(seed, ray):
    """The path's random stream where the camera left it: two pairs of numbers are used up."""
    import drjit as dr

    from isas_cli.rendering import rays

    stream = rays.stream(seed, dr.width(ray.o))
    stream.next_2d()
    stream.next_2d()
    return stream


def own_passes(integrator):
    """isas's own: both paths' radiance, and their derivative where both are differentiated, else
    the second one's."""
    import drjit as dr
    import mitsuba as mi

    def kernel(scene, leaves, both, seeds):
        with dr.suspend_grad():
            traced = [mi.Ray3f(o, d) for o, d in both]
            streams = [_stream(seed, ray) for seed, ray in zip(seeds[1:], traced)]

            kept = []  # what nobody refers to is not computed

            def adjoints(radiances):
                kept.extend(radiances)
                dr.schedule(kept)  # in one kernel with what follows, as in the step
                return [mi.Color3f(1.0 / dr.width(traced[0].o)) for _ in radiances]

            integrator.pair(scene, streams, traced, adjoints)
            dr.eval(kept)

    return kernel


def stock_passes(integrator):
    """Mitsuba's: two primal passes, and the second one's paths replayed for the derivative."""
    import drjit as dr
    import mitsuba as mi

    from isas_cli.rendering.integrators import Integrator

    integrator = Integrator(integrator.mitsuba)

    def kernel(scene, leaves, both, seeds):
        with dr.suspend_grad():
            first, second = (mi.Ray3f(o, d) for o, d in both)
            streams = _stream(seeds[1], first), _stream(seeds[2], second)
            radiance, _ = integrator.primal(scene, streams[0], first)
            dr.schedule(radiance)
            replayed = streams[1].clone()
            _, state = integrator.primal(scene, streams[1], second)
            dr.eval(state)
            adjoint = mi.Color3f(1.0 / dr.width(second.o))
            integrator.mitsuba.sample(
                mode=dr.ADMode.Backward,
                scene=scene,
                sampler=replayed,
                ray=second,
                depth=mi.UInt32(0),
                δL=adjoint,
                δaovs=None,
                state_in=state,
                active=mi.Bool(True),
            )

    return kernel


def main(rounds: int, steps: int, batches: str, samplers: str, overrides: list[str]) -> None:
    backend.start()
    problem, cfg = problem_of(overrides)
    for batch, name in itertools.product(map(int, batches.split(",")), samplers.split(",")):
        sides = Sides(problem, cfg, batch, name, overrides)
        count = itertools.count()
        names = sides.names
        for side in names:
            for _ in range(_WARM_UP):
                sides.measure(side, next(count))
        for round_ in range(rounds):
            times = {side: [] for side in names}
            for turn in range(steps):
                i = next(count)  # the same draws for all sides
                order = turn + round_
                for side in (names[(order + k) % len(names)] for k in range(len(names))):
                    times[side].append(sides.measure(side, i))
            row = {"batch": batch, "sampler": name, "round": round_}
            row |= {side: statistics.median(times.get(side, [math.nan])) for side in SIDES}
            _rows.emit(row)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:5], sys.argv[5:])
