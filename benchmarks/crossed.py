"""What it buys to differentiate both paths of a pixel, each with the other's residual.

On each scene, at the start, on the way and near the truth: time and summed variance of a gradient
estimate with `estimator.crossed` over those without, and over those of replayed paths one way, from
uniform pixels, sides in turns, with everything simulated and as many light samples as
`effects=auto` takes there. Then runs with and without at equal time with each of two samplers, each
at its own best of two factors on the rates, by the final parameter error (of media, whose images
say more, by theirs), with three other seeds: final errors, and the time after which the error
without is reached. Estimates alone of media that emit (lego), which do not cross by default, and of
more long paths. Writes results/crossed_estimates.csv, crossed.csv.

    .venv/bin/python benchmarks/crossed.py [--scenes pottery …]
"""

from __future__ import annotations

import argparse
import datetime
import statistics
import sys
import tempfile
import time
from pathlib import Path

import _contest
import _rows
import numpy as np
import pages
import pandas

from isas_cli import records

RESULTS = Path(__file__).parent / "results"
# Billed seconds (None: no runs), and light samples (None: none are drawn), each of several picked
# from four directions.
SCENES = {
    "pottery": (6, 4),
    "jumpydumpy": (6, 4),
    "dodoco": (4, 1),
    "caustic_failure": (5, 1),
    "smoke": (8, None),
    "earth": (6, 1),
    "trashcan": (None, 1),
    "multires": (None, 1),
    "lego": (None, None),
}
MEASURES = ("image_rmse", "parameter_rmse")
BLENDS = (0.0, 0.6, 0.95)  # of start and truth
SAMPLERS = ("uniform", "ours")
FACTORS = (1.0, 2.0)
SETTINGS = ["estimator.batch=16384", "target.noise=0.02", "evaluation.count=24", "effects=full"]
SETTINGS += ["optimizer.schedule=exponential", "evaluation.pixels=32768", *_contest.QUIET]


def settings_of(scene: str) -> list[str]:
    lights = SCENES[scene][1]
    found = [] if lights is None else [f"effects.light_samples=[{lights},{lights}]"]
    found += ["effects.directions=4"] if lights and lights > 1 else []
    textured = ("pottery", "jumpydumpy", "earth", "multires")
    return found + (["scene.arguments.texture=128"] if scene in textured else [])


def estimates(scene: str, count: int) -> None:
    """Rows of time and variance, crossed over the other sides."""
    from isas_cli.runtime import backend

    backend.start()
    from dataclasses import replace

    from _child import problem_of

    from isas_cli import losses
    from isas_cli.estimators.two_path import TwoPath
    from isas_cli.measure.variance.run import point
    from isas_cli.rendering.integrators import Replayed
    from isas_cli.rendering.pixels import PixelDistribution, Tiles
    from isas_cli.unknowns.parameters import as_numpy

    lights = SCENES[scene][1] or 1
    plain = [each for each in settings_of(scene) if not each.startswith("effects")]
    problem, _ = problem_of([f"scene={scene}", "target.noise=0.02", *plain])
    whole = problem.integrator
    directions = 4 if lights > 1 else 1
    paths = replace(whole.paths, lights=(lights, lights), directions=directions, crossed=False)
    sides = {"crossed": whole.cut(replace(paths, crossed=True)), "one way": whole.cut(paths)}
    sides["crossed"].crosses = True  # also where it does not pay
    if whole.samples_lights:
        sides["replayed"] = Replayed(whole.mitsuba, paths)
    sides = {
        name: TwoPath(replace(problem, integrator=each), losses.L2(), 16384)
        for name, each in sides.items()
    }
    uniform = PixelDistribution.uniform(Tiles.over(problem.views))
    for blend in BLENDS:
        values = point(problem, blend)
        seconds, sums = {name: [] for name in sides}, {}
        for number in range(-3, count):
            for name, estimator in sides.items():
                begun = time.perf_counter()
                gradients = estimator.estimate(values, uniform, 1, number % (1 << 24), 0.0)
                found = {key: as_numpy(g).ravel().astype("f8") for key, g in gradients.items()}
                if number < 0:
                    continue
                seconds[name].append(time.perf_counter() - begun)
                for key, entries in found.items():
                    first, second = sums.get((name, key), (0, 0))
                    sums[name, key] = first + entries, second + entries**2
        for key in values:
            variance = {
                name: float(np.sum(sums[name, key][1] - sums[name, key][0] ** 2 / count))
                for name in sides
            }
            row = {"scene": scene, "key": key, "blend": blend}
            for rival in list(sides)[1:]:
                pairs = zip(seconds["crossed"], seconds[rival])
                slower = statistics.median(a / b for a, b in pairs)
                ratio = variance["crossed"] / variance[rival]
                own = {"time": slower, "variance": ratio, "product": ratio * slower}
                row |= {f"{name}, {rival}": value for name, value in own.items()}
            _rows.emit(row)


def methods() -> dict[str, dict]:
    return {
        f"{sampler}, {name}": {"sampler": sampler, "estimator.crossed": crossed}
        for sampler in SAMPLERS
        for name, crossed in (("crossed", "true"), ("one way", "false"))
    }


def measured(run: records.Run) -> dict:
    last = run.history.iloc[-1]
    found = {"sampler": run.config["sampler"]["name"]}
    found["crossed"] = run.config["estimator"]["crossed"]
    return found | {name: last[name] for name in (*MEASURES, "iteration")}


def table(found: pandas.DataFrame, seconds: float) -> pandas.DataFrame:
    """A row per scene and sampler: medians of final errors crossed over one way, with the range of
    all pairs of seeds, and the share of the time after which the error of one way is reached."""
    rows = []
    for (scene, sampler), own in found.groupby(["scene", "sampler"]):
        both, once = (own[own["crossed"] == side] for side in (True, False))
        row = {"scene": scene, "sampler": sampler, "seconds": seconds, "seeds": len(both)}
        row |= {"factor": both["factor"].iloc[0], "factor_one_way": once["factor"].iloc[0]}
        for name in MEASURES:
            if not own[name].all():  # below the evaluation's noise
                continue
            ratios = both[name].to_numpy()[:, None] / once[name].to_numpy()
            goal = once[name].median()
            row[name] = both[name].median() / goal
            row |= {f"{name}_low": ratios.min(), f"{name}_high": ratios.max()}
            times = [_contest.reached(h, goal, name) / seconds for h in both["history"]]
            row[f"{name}_time"] = np.median(times)
        row["steps"] = both["iteration"].median() / once["iteration"].median()
        rows.append(row)
    return pandas.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=[*SCENES])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4])
    parser.add_argument("--count", type=int, default=300, help="estimates a side")
    parser.add_argument("--no-runs", action="store_true", help="estimates alone")
    parser.add_argument("--child", action="store_true", help="estimates of one scene, as rows")
    chosen = parser.parse_args()
    if chosen.child:
        return estimates(*chosen.scenes, chosen.count)
    for scene in chosen.scenes:
        command = [sys.executable, __file__, "--child", "--scenes", scene]
        found = pandas.DataFrame(_rows.collect([*command, "--count", str(chosen.count)]))
        print(found.round(3).to_string(index=False), flush=True)
        _contest.write(RESULTS / "crossed_estimates.csv", found)
        seconds, lights = SCENES[scene]
        if seconds is None or chosen.no_runs:
            continue
        with tempfile.TemporaryDirectory(prefix="isas-crossed-") as root:
            where = scene, Path(root), [*SETTINGS, *settings_of(scene)], methods(), FACTORS
            by = MEASURES[lights is not None]
            _, judged = _contest.judged(*where, chosen.seeds, seconds, measured, by)
            made = table(judged, seconds).assign(day=datetime.date.today().isoformat())
        print(made.round(3).to_string(index=False), flush=True)
        _contest.write(RESULTS / "crossed.csv", made)
    pages.write()


if __name__ == "__main__":
    main()
