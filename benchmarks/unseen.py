"""What becomes of texels that no camera ray meets, of which light between surfaces alone tells.

By default, on scenes with unknown textures, after equal steps; no times count. A texel is met where
a ray through any pixel hits it first. Of those that count in the parameters' error, writes
results/unseen.csv: for each scene and both kinds how many they are, and their root mean square
error at the start and at the end (median of the seeds, least and most).

    .venv/bin/python benchmarks/unseen.py [SCENE …] [--iterations N] [--seeds N …]
"""

from __future__ import annotations

import argparse
import tempfile

import _contest
import numpy as np
import pages
import pandas
from reproduce import RESULTS

import isas_cli

SCENES = ("multires", "pottery")
SETTINGS = ["evaluation.count=1", *_contest.QUIET]
RAYS = 16  # through each pixel


def met(problem) -> dict[str, np.ndarray]:
    """By key, the entries of the unknowns whose value what is seen first depends on."""
    import drjit as dr
    import mitsuba as mi

    from isas_cli.rendering import rays

    unknowns, total = problem.unknowns, problem.views.total
    found = {u.key: np.zeros(u.start.shape, bool) for u in unknowns}
    rng = mi.PCG32(total)
    for _ in range(RAYS):
        unknowns.attach(unknowns.starts())
        place = problem.views.locate(dr.arange(mi.UInt32, total))
        within = mi.Point2f(rng.next_float32(), rng.next_float32())
        ray, _ = rays.through(problem.sensors, problem.views, *place, within, mi.Point2f(0.5))
        hit = problem.scene.ray_intersect(ray)
        colour = hit.bsdf().eval_diffuse_reflectance(hit, hit.is_valid())
        dr.backward(dr.sum(dr.select(hit.is_valid(), dr.mean(colour), 0)))
        for key, gradient in unknowns.taken().items():
            found[key] |= np.array(gradient).reshape(found[key].shape) != 0
    unknowns.write(unknowns.starts())
    return found


def measured(scene: str, seeds: list[int], iterations: int) -> list[dict]:
    from isas_cli.config.compose import compose, translate
    from isas_cli.engine import experiment
    from isas_cli.engine.display import Display
    from isas_cli.engine.experiment import Phases
    from isas_cli.runtime import backend

    backend.start()
    typed, budget = experiment.checked(compose(translate([f"scene={scene}", *SETTINGS])))
    with Display(budget) as display:
        problem = experiment.built(typed, Phases(display))
    direct, errors = met(problem), []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            asked = f"scene={scene}", f"seed={seed}", f"budget.iterations={iterations}"
            run = isas_cli.run(*asked, *SETTINGS, f"hydra.run.dir={folder}")
            errors.append({u.key: run.parameters()[u.key] - u.truth for u in problem.unknowns})
    rows = []
    maps = [u for u in problem.unknowns if direct[u.key].any()]
    for kind in (True, False):
        chosen = {u.key: np.asarray(u.seen) & (direct[u.key] == kind) for u in maps}
        count = sum(int(each.sum()) for each in chosen.values())
        all_ = sum(int(np.sum(u.seen)) for u in maps)
        starts = _rms([(u.start - u.truth)[chosen[u.key]] for u in maps])
        ends = [_rms([each[u.key][chosen[u.key]] for u in maps]) for each in errors]
        row = {"scene": scene, "met": kind, "share": count / all_, "iterations": iterations}
        row |= {"seeds": len(seeds), "start": starts, "end": float(np.median(ends))}
        rows.append(row | {"end_low": min(ends), "end_high": max(ends)})
    return rows


def _rms(parts: list[np.ndarray]) -> float:
    every = np.concatenate([np.ravel(each) for each in parts])
    return float(np.sqrt(np.mean(every.astype(np.float64) ** 2))) if every.size else float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE")
    parser.add_argument("--iterations", type=int, default=300)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2])
    chosen = parser.parse_args()
    for scene in chosen.scenes or SCENES:
        made = pandas.DataFrame(measured(scene, chosen.seeds, chosen.iterations))
        print(made.to_string(index=False), flush=True)
        _contest.write(RESULTS / "unseen.csv", made)
    pages.write()


if __name__ == "__main__":
    main()
