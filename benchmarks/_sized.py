"""One point of `cost_against_size.py`: the jar of pottery at one size, ready to be measured.

usage: _sized.py VIEWS RESOLUTION TEXTURE DEPTH BATCH SAMPLERS   (SAMPLERS: with commas)

Prints a line when all is compiled. Then, for each line on standard input, which is a number of
seconds, measures every sampler for about so long and prints a JSON object a sampler. All views
share one camera, and targets and texture are constant: what a point costs then depends on its size
and not on what comes into view.
"""

from __future__ import annotations

import itertools
import json
import statistics
import sys

import psutil
from _child import Side

from isas_cli.config.schema import OptimizerConfig, UnknownConfig
from isas_cli.runtime import backend

_WARM_UP = 5
_LEAST, _MOST = 2, 12  # steps per turn
_RUN = 1000  # iterations over which looks are counted
KEY = "jar.bsdf.base_color.data"


def problem_of(views: int, resolution: int, texture: int, depth: int):
    import drjit as dr
    import mitsuba as mi
    import numpy as np
    from isas_cli.scenes import pottery

    from isas_cli.rendering import integrators
    from isas_cli.scene.problem import Problem
    from isas_cli.scene.views import Views
    from isas_cli.unknowns.specs import parse
    from isas_cli.unknowns.unknowns import Unknowns

    dictionary = pottery.build(1, resolution, 64)
    camera = next(name for name in dictionary if name.startswith("sensor"))
    for number in range(1, views):
        dictionary[f"{camera}_{number:03d}"] = dictionary[camera]
    scene = mi.load_dict(dictionary, optimize=False)
    params = mi.traverse(scene)
    params[KEY] = mi.TensorXf(np.full((texture, texture, 3), 0.5, np.float32))
    params.update()
    found = parse(mi.traverse(scene), {KEY: UnknownConfig(start=0.5)}, truth_known=True)
    sizes = [(resolution, resolution)] * views
    made = Problem(
        "sized",
        scene,
        integrators.adapt(mi.load_dict({"type": "prb", "max_depth": depth})),
        scene.sensors_dr(),
        sizes,
        Views.of(sizes),
        Unknowns(mi.traverse(scene), found),
        "sized",
    )
    made.set_targets(dr.opaque(mi.Float, 0.2, 3 * made.views.total), None, "sized")
    return made


class Point(Side):
    """Looks and steps, numbered one after the other."""

    def __init__(self, problem, batch: int, name: str):
        super().__init__(problem, OptimizerConfig(), batch, name, ["scene=pottery"])
        self.numbers = itertools.count(1)
        for _ in range(_WARM_UP):
            self.look(1, next(self.numbers))
            self.step(next(self.numbers))

    def measure(self, seconds: float) -> dict:
        """Medians over as many steps as fit; one look for every four of them."""
        steps, looks = [], []
        while len(steps) < _LEAST or (len(steps) < _MOST and sum(steps) + sum(looks) < seconds):
            if len(steps) % 4 == 0:
                looks.append(self.look(1, next(self.numbers)))
            steps.append(self.step(next(self.numbers)))
        return {
            "sampler": self.name,
            "step": statistics.median(steps),
            "look": statistics.median(looks),
            "looks": sum(map(self.sampler.settings.due, range(_RUN))) / _RUN,
            "memory": psutil.Process().memory_info().rss,
        }


def main(views: int, resolution: int, texture: int, depth: int, batch: int, samplers: str) -> None:
    backend.start()
    problem = problem_of(views, resolution, texture, depth)
    points = [Point(problem, batch, name) for name in samplers.split(",")]
    print("ready", flush=True)
    for line in sys.stdin:
        for point in points:
            print(json.dumps(point.measure(float(line))), flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:6]), sys.argv[6])
