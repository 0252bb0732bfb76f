"""What `ours` owes to each of its settings, and what one of its looks finds.

On each scene, with everything as `isas run` has it but for what a contestant names: `ours` as it
is, with looks that are not denoised, with one every 20 steps, as in the paper, and with the paper's
batch, about 100 K paths (each of a pixel's two is one); `uniform` as it is, and with that batch.
All at three factors on the rates with the first seed, then each at its best, by the final parameter
error, with three others, which alone are reported. Contestants take turns. Writes
results/settings.csv, a row for each scene and contestant, and settings_rates.csv. Billed: 6
contestants × (3 rates + 3 seeds) × 15 s, so 9 minutes a scene, 18 for both.

With `--views`: `ours` and `uniform` with 16 views and with 32 of half the pixels, to the same
tables: 4 contestants × (3 rates + 3 seeds) × 15 s, so 6 minutes a scene.

Targets, compilation and evaluations come on top.

With `--draws`, in a minute or two: a look at the start values, with everything simulated. Writes
results/density_<scene>.png, the first view beside the density of `ours` as it is measured and
denoised, from the same paths (the paper's figure 2), and draws.csv: the share of the draws on each
object with an unknown, beside its share of the pixels (figure 5).

    .venv/bin/python benchmarks/settings.py [--views | --draws] [--scenes pottery …]
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

import _contest
import numpy as np
import pages
import pandas

from isas_cli import records

RESULTS = Path(__file__).parent / "results"
SCENES, VIEWED = ("pottery", "jumpydumpy"), ("bowl",)
SETTINGS = ["evaluation.pixels=65536", *_contest.QUIET]
FACTORS = (0.5, 1.0, 2.0)  # of the scene's rates
MEASURES = ("parameter_rmse", "image_rmse")
KEYS = ("scene", "method")
OURS, UNIFORM, PYRAMID = "ours", "uniform", "multiresolution"
RAW, SMALLER = {"sampler.stage1.denoise": "none"}, {"estimator.batch": 50000}
CHANGES = {OURS: ({}, RAW, {"sampler.refresh": 20}, SMALLER), UNIFORM: ({}, SMALLER)}
VIEWS = {16: 256, 32: 181}  # how many, and pixels a side: as many in all


def methods(views: bool) -> dict[str, dict]:
    """Settings by name."""
    if views:
        return {
            f"{sampler}, {count} views": {"sampler": sampler}
            | {"scene.arguments.views": count, "scene.arguments.resolution": side}
            for count, side in VIEWS.items()
            for sampler in CHANGES
        }
    return {
        ", ".join([sampler, *(f"{key}={value}" for key, value in change.items())]): {
            "sampler": sampler,
            **change,
        }
        for sampler, changes in CHANGES.items()
        for change in changes
    }


def beside(name: str) -> str:
    """What a contestant is set against: its sampler as it is; where that is `ours`, with however
    many views, `uniform`; of that nothing."""
    sampler, _, change = name.partition(", ")
    if "=" in change:
        return sampler
    return name.replace(OURS, UNIFORM) if sampler == OURS else ""


def measured(run: records.Run) -> dict:
    last = run.history.iloc[-1]
    found = {name: last[name] for name in MEASURES} | {"iterations": int(last["iteration"])}
    found["paths"] = last["paths"] / last["iteration"]
    return found | {"stage1_share": last["stage1_seconds"] / last["seconds"]}


def table(found: pandas.DataFrame, seconds: float) -> pandas.DataFrame:
    """Medians; ``paths`` a step, those of looks too; ``time``: share of the budget to the median
    final parameter error of what a contestant stands ``beside``."""
    goals = found.groupby("method")[MEASURES[0]].median()
    rivals = found["method"].map(beside)
    times = [
        _contest.reached(history, goals[rival]) / seconds if rival else np.nan
        for history, rival in zip(found["history"], rivals)
    ]
    columns = [*_contest.ranged(*MEASURES), "iterations", "paths", "stage1_share", "time"]
    found = found.assign(beside=rivals, time=times)
    return _contest.told(found, seconds, columns, same=(*KEYS, "factor", "beside"))


def draws(scene: str) -> pandas.DataFrame:
    """A row for each object; draws the densities."""
    import drjit as dr
    import mitsuba as mi
    from _child import problem_of

    from isas_cli.config.compose import compose, instantiate
    from isas_cli.losses import L2
    from isas_cli.measure.variance import pictures
    from isas_cli.rendering import rays

    problem, cfg = problem_of([f"scene={scene}"])

    def looked(sampler: str, change: dict):
        settings = [f"{key}={value}" for key, value in change.items()]
        node = compose([f"scene={scene}", f"sampler={sampler}", *settings]).sampler
        made = instantiate(node, "sampler").on(problem, L2(), cfg.estimator["batch"])
        return made.distribution(made.look(problem.unknowns.starts(), 1, 0))

    densities = {"as measured": looked(OURS, RAW), "denoised": looked(OURS, {})}
    with tempfile.TemporaryDirectory(prefix="isas-settings-") as folder:
        pictures.densities(problem, densities, [0], Path(folder), {})
        shutil.copy(Path(folder) / "densities_v00.png", RESULTS / f"density_{scene}.png")
    pixels = problem.views.locate(dr.arange(mi.UInt32, problem.views.total))
    middle = mi.Point2f(0.5)
    ray, _ = rays.through(problem.sensors, problem.views, *pixels, middle, middle)
    hit = problem.scene.ray_intersect_preliminary(ray)
    unknown = {key.partition(".")[0] for key in problem.unknowns.keys}
    shapes = [shape for shape in problem.scene.shapes() if shape.id() in unknown]
    met = {s.id(): np.array(hit.is_valid() & (hit.shape == mi.ShapePtr(s))) for s in shapes}
    met["all else"] = ~np.any(list(met.values()), axis=0)
    both = {OURS: densities["denoised"], PYRAMID: looked(PYRAMID, {})}
    chances = {n: np.array(each.probability(*pixels), np.float64) for n, each in both.items()}
    rows = []
    for name, own in met.items():
        row = {"scene": scene, "object": name, "pixels": own.mean()}
        rows.append(row | {sampler: each[own].sum() for sampler, each in chances.items()})
    return pandas.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", help="of those whose unknown is on a surface")
    parser.add_argument("--seconds", type=float, default=15, help="of each run")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4])
    kinds = parser.add_mutually_exclusive_group()
    kinds.add_argument("--views", action="store_true", help="more views, of fewer pixels")
    kinds.add_argument("--draws", action="store_true", help="what a look finds; no races")
    chosen = parser.parse_args()
    if chosen.draws:
        from isas_cli.runtime import backend

        backend.start()
        for scene in chosen.scenes or (*SCENES, "multires"):
            made = draws(scene)
            print(made.round(3).to_string(index=False), flush=True)
            _contest.write(RESULTS / "draws.csv", made)
        return pages.write()
    for scene in chosen.scenes or (VIEWED if chosen.views else SCENES):
        with tempfile.TemporaryDirectory(prefix="isas-settings-") as root:
            first, found = _contest.judged(
                *(scene, Path(root), SETTINGS, methods(chosen.views), FACTORS, chosen.seeds),
                *(chosen.seconds, measured, MEASURES[0]),
            )
            made = table(found, chosen.seconds)
        print(made.round(4).to_string(index=False), flush=True)
        # After each scene: what is measured survives what follows.
        _contest.write(RESULTS / "settings.csv", made, KEYS)
        _contest.write(RESULTS / "settings_rates.csv", first, KEYS)
        pages.write()


if __name__ == "__main__":
    main()
