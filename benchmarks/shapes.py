"""Shapes from images: estimators and samplers race at equal time, and what a step costs.

`kirby` from a sphere: `estimator=silhouettes` with each of three samplers, and Mitsuba's own loop
(`sampler=mitsuba`, silhouettes that the camera sees), at three rates each with the first seed, then
each at its best with three others, which alone are reported. Writes results/shapes.csv (a row per
method), shapes_rates.csv and shapes.png (chamfer distance against billed time).

With `--step`: one step's time with films of 16 × 512² and 20,480 triangles, `silhouettes` against
Mitsuba's loop at one path a pixel, in turns; prints the ratio, writes results/shapes_step.csv.

    .venv/bin/python benchmarks/shapes.py
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas
from reproduce import reached

from isas_cli import records

RESULTS = Path(__file__).parent / "results"
ERROR, STOCK = "parameter_rmse", "Mitsuba's loop"
OURS = {"estimator": "silhouettes", "estimator.batch": 16384}
METHODS = {
    "silhouettes, uniform": OURS | {"sampler": "uniform"},
    "silhouettes, relevant": OURS | {"sampler": "relevant"},
    "silhouettes, ours": OURS | {"sampler": "ours"},
    STOCK: {"sampler": "mitsuba", "sampler.silhouettes": "direct"},
}
FACTORS = (0.3, 1.0, 3.0)  # of the scene's rate, 0.03
SETTINGS = ["evaluation.count=16", "frames.views=0", "frames.snapshots=0", "report=false"]
SETTINGS += ["optimizer.schedule=cosine", "optimizer.final=0.1"]


def race(folder: Path, contestants: list[dict], seeds: list[int], seconds: float) -> None:
    listed = [",".join(f"{k}:{v}" for k, v in each.items()) for each in contestants]
    command = [sys.executable, "-m", "isas_cli", "race", "scene=kirby", *SETTINGS]
    command += [f"budget.seconds={seconds}", f"seed=[{','.join(map(str, seeds))}]"]
    command += ["contestants=[" + ",".join(f"{{{each}}}" for each in listed) + "]"]
    subprocess.run([*command, f"hydra.run.dir={folder}"], check=True)


def runs(folder: Path) -> pandas.DataFrame:
    rows = []
    for path in sorted(folder.rglob("summary.json")):
        run = records.load(path.parent)
        own = run.config["estimator"]["name"], run.config["sampler"]["name"]
        name = f"silhouettes, {own[1]}" if own[0] == "silhouettes" else STOCK
        last = run.history.iloc[-1]
        rows.append(
            {
                "method": name,
                "factor": run.config["optimizer"]["factor"],
                "seed": run.config["seed"],
                "history": run.history,
                "start": run.history[ERROR].iloc[0],
                "chamfer": last[ERROR],
                "normals": last["value/figure.vertices/normals"],
                "volume": last["value/figure.vertices/volume"],
                "folded": last["value/figure.vertices/folded"],
                "image_rmse": last["image_rmse"],
                "iterations": int(last["iteration"]),
            }
        )
    return pandas.DataFrame(rows)


def table(found: pandas.DataFrame, seconds: float) -> pandas.DataFrame:
    """Medians; ``time_to_stock``: share of the budget to the median final error of Mitsuba's."""
    goal = found[found["method"] == STOCK]["chamfer"].median()
    rows = []
    for name, own in found.groupby("method", sort=False):
        row = {"method": name, "factor": own["factor"].iloc[0], "seeds": len(own)}
        row |= {"seconds": seconds, "start": own["start"].median()}
        row |= {"chamfer_low": own["chamfer"].min(), "chamfer_high": own["chamfer"].max()}
        for measure in ("chamfer", "normals", "volume", "folded", "image_rmse", "iterations"):
            row[measure] = own[measure].median()
        row["time_to_stock"] = np.median([reached(h, goal) / seconds for h in own["history"]])
        rows.append(row)
    return pandas.DataFrame(rows)


def draw(found: pandas.DataFrame) -> None:
    figure, ax = plt.subplots(figsize=(6.5, 4), layout="constrained")
    for number, (name, own) in enumerate(found.groupby("method", sort=False)):
        for history in own["history"]:
            label = name if history is own["history"].iloc[0] else None
            ax.plot(history["seconds"], history[ERROR], color=f"C{number}", label=label)
    ax.set(yscale="log", xlabel="billed seconds", ylabel="chamfer distance", title="kirby")
    ax.legend(fontsize=8)
    figure.savefig(RESULTS / "shapes.png", dpi=90)
    plt.close(figure)


def steps(rounds: int = 5) -> pandas.DataFrame:
    from isas_cli.runtime import backend

    backend.start()
    import time

    from isas_cli.config.compose import compose, translate
    from isas_cli.engine import experiment
    from isas_cli.engine.display import Display
    from isas_cli.engine.experiment import Phases
    from isas_cli.engine.workshop import Workshop

    views = ["scene=kirby", "scene.arguments.resolution=512", "target.spp=1"]
    views += ["evaluation.pixels=64", "evaluation.spp=2", "budget.iterations=100"]
    sides = {
        "silhouettes": ["estimator=silhouettes", "sampler=uniform"],
        STOCK: ["sampler=mitsuba", "sampler.silhouettes=direct"],
    }
    workshop, loops = None, {}
    for name, settings in sides.items():
        cfg = compose(translate([*views, *settings]))
        typed, budget = experiment.checked(cfg)
        if workshop is None:
            with Display(budget) as display:
                workshop = Workshop(experiment.built(typed, Phases(display)))
        loops[name] = workshop.loop(cfg, typed, budget)
        loops[name].rehearse()
    rows = []
    for number in range(rounds):
        for name, loop in loops.items():
            count = 8 if name == "silhouettes" else 1
            backend.sync()
            begun = time.perf_counter()
            for _ in range(count):
                loop._iterate()
            backend.sync()
            spent = (time.perf_counter() - begun) / count
            rows.append({"round": number, "side": name, "seconds": spent})
    return pandas.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4])
    parser.add_argument("--step", action="store_true")
    chosen = parser.parse_args()
    if chosen.step:
        found = steps()
        found.to_csv(RESULTS / "shapes_step.csv", index=False, float_format="%.5f")
        middle = found.groupby("side")["seconds"].median()
        print(f"a step: {middle['silhouettes'] / middle[STOCK]:.4f} of Mitsuba's")
        return
    with tempfile.TemporaryDirectory(prefix="isas-shapes-") as root:
        every = [m | {"optimizer.factor": f} for m in METHODS.values() for f in FACTORS]
        race(Path(root) / "rates", every, chosen.seeds[:1], chosen.seconds)
        first = runs(Path(root) / "rates")
        best = first.loc[first.groupby("method", sort=False)["chamfer"].idxmin()]
        pairs = [
            METHODS[m] | {"optimizer.factor": f} for m, f in zip(best["method"], best["factor"])
        ]
        race(Path(root) / "seeds", pairs, chosen.seeds[1:], chosen.seconds)
        found = runs(Path(root) / "seeds")
    first.drop(columns="history").to_csv(
        RESULTS / "shapes_rates.csv", index=False, float_format="%.4g"
    )
    measured = table(found, chosen.seconds)
    measured.to_csv(RESULTS / "shapes.csv", index=False, float_format="%.4g")
    draw(found)
    print(measured.to_string())


if __name__ == "__main__":
    main()
