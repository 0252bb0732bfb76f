"""One side of `step_time.py`, in a process of its own: prints the median seconds of a step.

usage: _child.py SIDE BATCH STEPS OVERRIDES…

SIDE is `stock` (RayDataLoader, mi.render, dr.backward), `isas` (uniform sampling and all effects,
so that both sides look at the same pixels and paths), `isas-ours` (the same step where `ours` sends
it), `isas-auto` (uniform pixels, the plan of effects that a run of a minute makes) or `isas-single`
(that plan with one light sample a vertex, as the stock loop has, picked at the first). A
Python-side sensor such as the loader's joins every later SensorPtr call of its process, hence the
processes.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace

from isas_cli.runtime import backend

_WARM_UP = 8


def problem_of(overrides: list[str]):
    from omegaconf import OmegaConf

    from isas_cli.config.compose import compose
    from isas_cli.engine import assemble

    cfg = OmegaConf.to_object(compose(overrides))
    return assemble.problem(cfg.scene, cfg.target, lambda done, total: None), cfg


def timed(work: Callable[[], None]) -> float:
    """Seconds of ``work``, with all that it waits for."""
    backend.sync()
    start = time.perf_counter()
    work()
    backend.sync()
    return time.perf_counter() - start


class Side:
    """Looks and steps of one sampler, on a problem that sides may share; each returns its
    seconds."""

    def __init__(self, problem, rates, batch: int, name: str, overrides: list[str]):
        from isas_cli import losses
        from isas_cli.config.compose import compose, instantiate
        from isas_cli.engine.optimiser import Stepper
        from isas_cli.estimators.two_path import TwoPath

        self.problem, self.name, loss = problem, name, losses.L2()
        node = compose([*overrides, f"sampler={name}"]).sampler
        self.sampler = instantiate(node, "sampler").on(problem, loss, batch)
        self.stepper = Stepper(problem.unknowns, rates)
        self.estimator = TwoPath(problem, loss, batch)

    def look(self, seed: int, iteration: int) -> float:
        return timed(lambda: self._look(seed, iteration))

    def _look(self, seed: int, iteration: int) -> None:
        import drjit as dr

        moments = None
        if "moments" in self.sampler.settings.needs and iteration and self.stepper.taken:
            moments = self.stepper.moments(0.1)
        weights = self.sampler.look(self.stepper.values, seed, iteration, moments)
        self.distribution = self.sampler.distribution(weights)
        dr.eval(self.distribution.cdf)

    def step(self, iteration: int) -> float:
        return timed(lambda: self._step(iteration))

    def _step(self, iteration: int) -> None:
        unknowns = self.problem.unknowns
        unknowns.attach(self.stepper.values)
        self.estimator.accumulate(self.distribution, 1, iteration)
        self.stepper.step(unknowns.gradients(), 0.0)


def stock(batch: int, overrides: list[str]):
    import drjit as dr
    import mitsuba as mi
    from mitsuba.python.ad.loaders import RayDataLoader

    problem, cfg = problem_of(overrides)
    key = problem.unknowns.keys[0]
    params = mi.traverse(problem.scene)
    targets = [mi.TensorXf(problem.target_image(v)) for v in range(len(problem.film_sizes))]
    loader = RayDataLoader(problem.scene.sensors(), targets, batch)
    optimizer = mi.ad.Adam(lr=cfg.optimizer.lr, mask_updates=True)
    optimizer[key] = problem.unknowns.starts()[key]
    params.update(optimizer)

    def step(i: int) -> None:
        target, sensor = loader.next()
        image = mi.render(problem.scene, params, sensor=sensor, spp=1, seed=i)
        dr.backward(dr.mean(dr.square(image - target)))
        optimizer.step()
        optimizer[key] = dr.clip(optimizer[key], 0.0, 1.0)
        params.update(optimizer)

    return step


SAMPLERS = {
    "isas": "uniform",
    "isas-ours": "ours",
    "isas-auto": "uniform",
    "isas-single": "uniform",
}


def isas(side: str, batch: int, overrides: list[str]):
    from isas_cli import effects, losses
    from isas_cli.config.compose import compose, instantiate

    problem, cfg = problem_of(overrides)
    if side in ("isas-auto", "isas-single"):
        chosen = compose([*overrides, f"sampler={SAMPLERS[side]}"])
        settings = instantiate(chosen.effects, "effects")
        if side == "isas-single":
            settings = replace(settings, light_samples=[1, 1], directions=4)
        estimator = instantiate(chosen.estimator, "estimator")
        plan = effects.decide(problem, settings, estimator, losses.L2(), 60.0)
        print(plan.paths)
        problem = plan.on(problem)
    made = Side(problem, cfg.optimizer, batch, SAMPLERS[side], overrides)
    made.look(1, 0)
    return made.step


def main(side: str, batch: int, steps: int, overrides: list[str]) -> None:
    from isas_cli.config.compose import compose

    backend.start(compose(overrides).variant)
    if side == "stock":
        step = stock(batch, overrides)
    else:
        step = isas(side, batch, overrides)
    for i in range(_WARM_UP):
        step(i)
    print(statistics.median(timed(lambda: step(_WARM_UP + i)) for i in range(steps)))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])
