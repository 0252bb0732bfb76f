"""The PRDPT authors' own shadows scene: when each way arrives.

`shadows_prdpt` by default, with 60 and with 46 billed seconds; with the loss blurred as their
public code does; with that code's schedule besides (width 0.5 up to half of the budget, then
linearly to 0.01, rate 0.02 throughout, all pixels with 32 paths); and by Mitsuba's derivative.
Three seeds, ways take turns. Writes results/prdpt_shadows.csv, a row a run: squared parameter error
(mean over the two numbers) and image error at the end, and billed seconds and iterations from which
on the first stays below 1e-3 and 1e-5 (empty: never). Their code is not among them: it is run
beside this by hand, see the page.

    .venv/bin/python benchmarks/prdpt_shadows.py
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import pages
import pandas
from _contest import QUIET, reached

import isas_cli

RESULTS = Path(__file__).parent / "results"
SCENE, SEEDS, SECONDS, SHORT = "shadows_prdpt", [1, 2, 3], 60, 46
GOALS = (1e-3, 1e-5)
SETTINGS = ["evaluation.count=60", "evaluation.pixels=4096", "evaluation.spp=16", *QUIET]
SETTINGS += ["target.spp=4096"]
THEIRS = "scene.unknowns={ball.place: {start: [-0.5, 2.5], lr: 0.02, "
THEIRS += "blur: {start: 0.5, end: 0.01, hold: 0.5, until: 1.0}}}"
WAYS = {
    "default": [],
    "default, shorter": [f"budget.seconds={SHORT}"],
    "loss blurred": ["estimator.smooth=loss"],
    "loss blurred, their schedule": [
        *("estimator.smooth=loss", THEIRS, "optimizer.schedule=constant"),
        *(f"estimator.batch={128 * 96}", "estimator.spp=32"),
    ],
    "sampler=mitsuba": ["sampler=mitsuba"],
}


def told(run) -> dict:
    history, row = run.history, {}
    row["end"] = float(history["parameter_rmse"].iloc[-1] ** 2)
    row["image_rmse"] = float(history["image_rmse"].iloc[-1])
    row["seconds"] = run.config["budget"]["seconds"]
    row["iterations"] = int(history["iteration"].iloc[-1])
    for goal in GOALS:
        seconds = reached(history, np.sqrt(goal), "parameter_rmse")
        row[f"seconds_{goal:g}"] = seconds if np.isfinite(seconds) else np.nan
        steps = np.interp(seconds, history["seconds"], history["iteration"])
        row[f"iterations_{goal:g}"] = steps if np.isfinite(seconds) else np.nan
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    chosen = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory(prefix="isas-prdpt-") as made:
        for seed in SEEDS:
            for name, own in WAYS.items():
                run = isas_cli.run(
                    *(f"scene={SCENE}", f"budget.seconds={chosen.seconds}", *SETTINGS, *own),
                    *(f"seed={seed}", f"hydra.run.dir={made}/{len(rows)}"),
                )
                rows.append({"way": name, "seed": seed, **told(run)})
                print(rows[-1], flush=True)
    found = pandas.DataFrame(rows)
    found.to_csv(RESULTS / "prdpt_shadows.csv", index=False, float_format="%.4g")
    pages.write()


if __name__ == "__main__":
    main()
