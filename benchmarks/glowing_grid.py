"""What is not physically based: a grid that glows, from the pictures of `object_joint`.

The PBDR paper sets a radiance field (its Eq. 2, NeRF) beside physically based rendering. No package
for it was tried here: this is a grid of densities and colours that glows alike in all directions,
around the bowl, under the same unknown sky: no surface, no material, no gloss. Same
pictures, budget and loss as `pbdr.py`'s, and a further budget; uniform pixels, as radiance fields
are fitted, and `ours`, each at its own best rate. Views between those given, and these under
another sky, beside the true pictures.

Writes results/glowing_grid.csv and glowing_grid_rates.csv.

    .venv/bin/python benchmarks/glowing_grid.py
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

RESULTS = Path(__file__).parent / "results"
SCENE, BUDGETS, FACTORS = "object_joint", (8.0, 24.0), (0.3, 1.0, 3.0)
LEVELS = 3
NUMBERS = {"resolution": 192, "views": 16, "grid": 64}
MIDDLE, HALF = (0.0, 0.31, 0.0), 0.66  # a cube around the bowl
SAMPLERS = ("uniform", "ours")
PATHS = 128, 512  # of the pictures from elsewhere: of a result, of the truth
_BOX = "box.interior_medium"
UNKNOWNS = {
    f"{_BOX}.sigma_t.data": {"start": 1.0, "range": [0.001, 300.0], "lr": 0.5, "levels": LEVELS},
    f"{_BOX}.albedo.data": {"start": 0.3, "range": [0.0, 3.0], "lr": 0.03, "levels": LEVELS},
    "sky.data": {"start": 0.8, "lr": 0.03},
}


def build(resolution: int, views: int, grid: int, novel: bool = False, relit: bool = False) -> dict:
    """The grid, of nothing, before `object_joint`'s cameras; ``novel``: before those that no run
    has seen; ``relit``: under another sky."""
    import mitsuba as mi
    import numpy as np
    import pbdr
    from isas_cli.scenes import object_joint

    found = object_joint.build(views, resolution, 8)
    del found["bowl"]
    if novel:
        found = {k: v for k, v in found.items() if not k.startswith("sensor_")}
        found |= pbdr._views(SCENE)
    if relit:
        found |= pbdr._light(SCENE, found)
    place = mi.ScalarTransform4f().translate(MIDDLE).scale(HALF)
    inside = place.translate([-1, -1, -1]).scale(2)

    def volume(value: float, channels: int) -> dict:
        values = np.full((grid, grid, grid, channels), value, np.float32)
        held = mi.VolumeGrid(values)
        return {"type": "gridvolume", "grid": held, "to_world": inside, "raw": True}

    medium = {"type": "heterogeneous", "sigma_t": volume(1e-3, 1), "albedo": volume(0.3, 3)}
    box = {"type": "cube", "to_world": place, "bsdf": {"type": "null"}, "interior": medium}
    return found | {"integrator": {"type": "emission"}, "box": box}


def _arguments() -> list[str]:
    """Of the scene that this file builds."""
    return [
        "scene=lego",
        f"scene.builder={Path(__file__).stem}.build",
        *(f"scene.arguments.{name}={number}" for name, number in NUMBERS.items()),
        f"scene.unknowns={json.dumps(UNKNOWNS)}",
    ]


def _elsewhere(values: dict, truths: dict[str, list]) -> dict[str, float]:
    """Means over views that no run has seen: ``novel_psnr``, … and ``relit_psnr``, …"""
    import numpy as np

    from isas_cli.config.compose import compose, translate
    from isas_cli.config.schema import typed
    from isas_cli.engine import assemble
    from isas_cli.rendering.renderer import Renderer
    from isas_cli.runtime import likeness

    found = {}
    for kind, pictures in truths.items():
        settings = [*_arguments(), "target.spp=1", "target.noise=null"]
        cfg = typed(compose(translate(settings)))
        cfg.scene.arguments |= {"novel": True, "relit": kind == "relit"}
        problem = assemble.problem(cfg.scene, cfg.target, lambda done, total: None)
        own = {k: v for k, v in values.items() if kind == "novel" or not k.startswith("sky")}
        unknowns = problem.unknowns
        unknowns.write(unknowns.truths() | unknowns.values_of(own))
        renderer = Renderer(problem)
        each = [
            likeness.metrics(
                renderer.view(v, PATHS[0], lambda s: s), truth, np.ones(truth.shape[:2])
            )
            for v, truth in enumerate(pictures)
        ]
        for name in each[0]:
            found[f"{kind}_{name}"] = np.mean([one[name] for one in each])
    return found


def _truths(run) -> dict[str, list]:
    """What the scene of a ``run`` is, from views that no run has seen, and under another sky."""
    import mitsuba as mi
    import numpy as np
    import pbdr

    found = {}
    for kind in ("novel", "relit"):
        scene, unknowns, _ = pbdr._moved(run, kind == "relit")
        unknowns.write(unknowns.truths())
        views = range(len(scene.sensors()))
        found[kind] = [
            np.array(mi.render(scene, sensor=v, spp=PATHS[1], seed=v))[..., :3] for v in views
        ]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4])
    parser.add_argument("--seconds", nargs="+", type=float, default=BUDGETS)
    chosen = parser.parse_args()
    # Of this process and of those that it starts: the builder is this file.
    os.environ["ISAS_ALLOW"] = Path(__file__).stem
    os.environ["PYTHONPATH"] = str(Path(__file__).parent)
    from isas_cli.runtime import backend

    backend.start()
    import _contest
    import pages
    import pandas
    import pbdr

    from isas_cli import records

    def measured(run: records.Run) -> dict:
        first, last = run.history.iloc[0], run.history.iloc[-1]
        found = {"start": first[pbdr.ERROR], pbdr.ERROR: last[pbdr.ERROR]}
        return found | {"re": 3 * last[pbdr.ERROR] ** 2, "iterations": int(last["iteration"])}

    with tempfile.TemporaryDirectory(prefix="isas-glowing-") as root:
        seen = Path(root) / "pictures"
        command = [sys.executable, "-m", "isas_cli", "run", f"scene={SCENE}", "target.noise=0.01"]
        command += ["budget.iterations=1", "frames.views=16", "frames.spp=1", "report=false"]
        subprocess.run([*command, "frames.snapshots=0", f"hydra.run.dir={seen}"], check=True)
        truths = _truths(records.load(seen))
        pictures = ",".join(map(str, sorted((seen / "frames").glob("target_v*.exr"))))
        settings = [each for each in pbdr.SETTINGS if not each.startswith("target.")]
        settings += [*_arguments()[1:], f"scene.targets=[{pictures}]"]
        methods = {name: {"sampler": name} for name in SAMPLERS}
        for seconds in chosen.seconds:
            where = "lego", Path(root) / f"{seconds:g}", settings, methods, FACTORS
            first, found = _contest.judged(*where, chosen.seeds, seconds, measured, pbdr.ERROR, 2)
            rows = [_elsewhere(records.load(each).parameters(), truths) for each in found["folder"]]
            other = pandas.DataFrame(rows)
            columns = ["start", *_contest.ranged(pbdr.ERROR, "re"), "iterations", *other]
            made = _contest.told(found.join(other), seconds, columns, pbdr.ERROR)
            made, first = (each.assign(scene=SCENE) for each in (made, first))
            print(made.to_string(index=False), flush=True)
            _contest.write(RESULTS / "glowing_grid.csv", made, ("seconds",))
            _contest.write(
                RESULTS / "glowing_grid_rates.csv", first.assign(seconds=seconds), ("seconds",)
            )
    pages.write()


if __name__ == "__main__":
    main()
