"""Shapes from images: estimators and samplers race at equal time, and what a step costs.

Each scene from a sphere: `estimator=silhouettes` with each of three samplers (`progress` is
refused), with silhouettes drawn by residuals and by length alone, with shadows' edges and without,
and Mitsuba's own loop (`sampler=mitsuba`; with shadows' edges where the scene asks for them), at
three rates each with the first seed, and at one beyond where the best was an end of them, then each
at its best with three others, which alone are reported. Writes results/shapes.csv (a row per scene
and method), shapes_rates.csv and shapes_<scene>.png (chamfer distance against billed time).

With `--rebuilds`: the same time on kirby with fewer and larger steps, and so fewer rebuilds of the
tree that rays are traced with, each at its own best rate; the smallest says what a step costs
without samples. Writes results/shapes_rebuilds.csv.

With `--levels`: `silhouettes` with uniform pixels on kirby of 10,242 vertices, as it is and from
meshes of a quarter and of a sixteenth of them, and on that of 40,962 (24 seconds a run), each at
its own best rate. Writes results/shapes_levels.csv.

With `--step`: one step's time with films of 16 × 512² and 20,480 triangles, `silhouettes` against
Mitsuba's loop at one path a pixel, in turns; prints the ratio, writes results/shapes_step.csv.

    .venv/bin/python benchmarks/shapes.py
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import _contest
import pages
import pandas

from isas_cli import records

RESULTS = Path(__file__).parent / "results"
ERROR, STOCK = "parameter_rmse", "Mitsuba's loop"
MEASURES = ("normals", "volume", "overlap", "folded")
SCENES = ("kirby", "dodoco_b", "shadowplay")
SHADOWS = {"kirby": 0, "dodoco_b": 0, "shadowplay": 4096}  # what each scene calls for
OURS = "silhouettes"
SAMPLERS = ("uniform", "relevant", "ours")


def methods(scene: str) -> dict[str, dict]:
    """Settings by name."""
    shadows = SHADOWS[scene]
    base = {"estimator": OURS, "estimator.batch": 16384, "estimator.shadows": shadows}
    found = {f"{OURS}, {s}": base | {"sampler": s} for s in SAMPLERS}
    uniform, by_length = base | {"sampler": "uniform"}, {"estimator.adaptive": "false"}
    found |= {f"{name}, by length": each | by_length for name, each in found.items()}
    other, shadows = ("no shadows", 0) if shadows else ("and shadows", 4096)
    found[f"{OURS}, uniform, {other}"] = uniform | {"estimator.shadows": shadows}
    kind = "uniform" if SHADOWS[scene] else "direct"
    return found | {STOCK: {"sampler": "mitsuba", "sampler.silhouettes": kind}}


FACTORS = (0.3, 1.0, 3.0)  # of the scene's rate, 0.03
SETTINGS = ["evaluation.count=6", *_contest.QUIET]
SETTINGS += ["optimizer.schedule=cosine", "optimizer.final=0.1", "~scene.method"]


def measured(run: records.Run) -> dict:
    last = run.history.iloc[-1]
    found = {"start": run.history[ERROR].iloc[0], "chamfer": last[ERROR]}
    found |= {name: last[f"value/figure.vertices/{name}"] for name in MEASURES}
    found |= {"outlines": last["value/outlines/overlap"], "image_rmse": last["image_rmse"]}
    return found | {"iterations": int(last["iteration"])}


def table(
    found: pandas.DataFrame, seconds: float, rival: str = STOCK, column: str = "time_to_stock"
) -> pandas.DataFrame:
    """Medians; ``column``: share of the budget to the median final error of the ``rival``."""
    columns = ["start", "chamfer_low", "chamfer_high", "chamfer", "outlines", *MEASURES]
    columns += ["image_rmse", "iterations", column]
    return _contest.told(found, seconds, columns, ERROR, {column: rival})


def steps(rounds: int = 5) -> pandas.DataFrame:
    from isas_cli.runtime import backend

    backend.start()
    import time

    from isas_cli.config.compose import compose, translate
    from isas_cli.engine import experiment
    from isas_cli.engine.choices import Choices
    from isas_cli.engine.display import Display
    from isas_cli.engine.experiment import Phases
    from isas_cli.engine.workshop import Workshop

    views = ["scene=kirby", "~scene.method", "scene.arguments.resolution=512", "target.spp=1"]
    views += ["evaluation.pixels=64", "evaluation.spp=2", "budget.iterations=100"]
    sides = {
        OURS: ["estimator=silhouettes", "sampler=uniform", "estimator.shadows=0"],
        STOCK: ["sampler=mitsuba", "sampler.silhouettes=direct"],
    }
    workshop, loops = None, {}
    for name, settings in sides.items():
        cfg = compose(translate([*views, *settings]))
        typed, budget = experiment.checked(cfg)
        if workshop is None:
            with Display(budget) as display:
                workshop = Workshop(experiment.built(typed, Phases(display)))
        loops[name] = workshop.loop(Choices.of(cfg), typed, budget)
        loops[name].rehearse()
    rows = []
    for number in range(rounds):
        for name, loop in loops.items():
            count = 8 if name == OURS else 1
            backend.sync()
            begun = time.perf_counter()
            for _ in range(count):
                loop._iterate()
            backend.sync()
            spent = (time.perf_counter() - begun) / count
            rows.append({"round": number, "side": name, "seconds": spent})
    return pandas.DataFrame(rows)


def rebuilds(seeds: list[int], seconds: float) -> pandas.DataFrame:
    """A row for each number of samples a step, over the usual one: medians."""
    usual = 16384
    contestants = {
        int(usual * times): methods("kirby")[f"{OURS}, uniform"]
        | {"estimator.batch": int(usual * times), "estimator.edges": int(usual * times / 4)}
        for times in (1 / 64, 1 / 4, 1, 4)
    }
    with tempfile.TemporaryDirectory(prefix="isas-shapes-") as root:
        _, found = _contest.judged(
            *("kirby", Path(root), SETTINGS, contestants, FACTORS, seeds, seconds),
            *(measured, "chamfer", 1),
        )
    columns = ["iterations", *_contest.ranged("chamfer")]
    table = _contest.told(found, seconds, columns, same=("method", "factor"))
    table = table.assign(method=table["method"] / usual).rename(columns={"method": "samples"})
    (steps,) = table.loc[table["samples"] == 1, "iterations"]
    return table.assign(step=steps / table["iterations"])


SIZES = {"default": 8.0, "paper": 24.0}  # billed seconds


def levels(seeds: list[int]) -> pandas.DataFrame:
    """A row for each size and number of levels: medians."""
    rows = []
    for size, seconds in SIZES.items():
        contestants = {
            f"{count} levels": methods("kirby")[f"{OURS}, uniform"]
            | {f"scene.sizes.{size}.levels": count}
            for count in (1, 2, 3)
        }
        with tempfile.TemporaryDirectory(prefix="isas-shapes-") as root:
            own = [*SETTINGS, f"size={size}", "evaluation.count=12"]
            _, found = _contest.judged(
                *("kirby", Path(root), own, contestants, FACTORS, seeds, seconds),
                *(measured, "chamfer", 1),
            )
        rows.append(table(found, seconds, "1 levels", "time_to_one").assign(size=size))
    return pandas.concat(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=8, help="of each run, but for --levels")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4])
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--rebuilds", action="store_true")
    parser.add_argument("--levels", action="store_true")
    parser.add_argument("--step", action="store_true")
    chosen = parser.parse_args()
    if chosen.step:
        found = steps()
        found.to_csv(RESULTS / "shapes_step.csv", index=False, float_format="%.5f")
        middle = found.groupby("side")["seconds"].median()
        pages.write()
        print(f"a step: {middle[OURS] / middle[STOCK]:.4f} of Mitsuba's")
        return
    if chosen.rebuilds:
        found = rebuilds(chosen.seeds, chosen.seconds)
        found.to_csv(RESULTS / "shapes_rebuilds.csv", index=False, float_format="%.4g")
        pages.write()
        print(found.to_string(index=False))
        return
    if chosen.levels:
        found = levels(chosen.seeds)
        found.to_csv(RESULTS / "shapes_levels.csv", index=False, float_format="%.4g")
        pages.write()
        print(found.to_string(index=False))
        return
    for scene in chosen.scenes:
        with tempfile.TemporaryDirectory(prefix="isas-shapes-") as root:
            contestants = methods(scene)
            first, found = _contest.judged(
                *(scene, Path(root), SETTINGS, contestants, FACTORS, chosen.seeds, chosen.seconds),
                *(measured, "chamfer", 1),
            )
            _contest.draw(found, RESULTS / f"shapes_{scene}.png", ERROR, "chamfer distance")
            # After each scene: what is measured survives what follows.
            _contest.write(RESULTS / "shapes.csv", table(found, chosen.seconds))
            _contest.write(RESULTS / "shapes_rates.csv", first)
            pages.write()


if __name__ == "__main__":
    main()
