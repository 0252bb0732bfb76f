"""On a graphics card: a step against Mitsuba's usual loop, and a race of samplers.

Steps are those of `step_time.py`, sides in turn, a process each. The race: pottery with 65,536
pixels a step, each method at three factors on its rate with the first seed (and at one beyond an
end), then at its best with three others, which alone are reported. Writes results/gpu_steps.csv (a
row a process), gpu_rates.csv (a row a run) and gpu_race.csv (a row a method, medians and ranges),
with the card's name and the day.

    .venv/bin/python benchmarks/gpu.py
"""

from __future__ import annotations

import argparse
import datetime
import tempfile
from pathlib import Path

import _contest
import numpy as np
import pages
import pandas
from reproduce import reached
from step_time import SIDES, measure

from isas_cli import records
from isas_cli.runtime import backend

RESULTS = Path(__file__).parent / "results"
BATCHES = (65536, 1 << 20)
ERROR, STOCK = "parameter_rmse", "Mitsuba's loop"
MEASURES = (ERROR, "image_rmse", "iteration", "paths")
METHODS = {name: {"sampler": name} for name in ("uniform", "ours", "progress")}
METHODS[STOCK] = {"sampler": "mitsuba"}
SETTINGS = ["estimator.batch=65536", "evaluation.count=24", "effects=full"]
SETTINGS += ["optimizer.schedule=exponential"]
SETTINGS += ["frames.views=0", "frames.snapshots=0", "report=false"]


def steps(rounds: int) -> pandas.DataFrame:
    measure("isas", BATCHES[0], 1)  # fills the caches of targets and kernels
    rows = []
    for batch in BATCHES:
        for number in range(rounds):
            for side in SIDES:
                row = {"batch": batch, "round": number, "side": side}
                rows.append(row | {"seconds": measure(side, batch, 25)})
    return pandas.DataFrame(rows)


def measured(run: records.Run) -> dict:
    return dict(run.history.iloc[-1][[*MEASURES]])


def race(seconds: float) -> tuple[pandas.DataFrame, pandas.DataFrame]:
    """The runs at all rates, and a row a method."""
    with tempfile.TemporaryDirectory(prefix="isas-gpu-") as root:
        first, found = _contest.judged(
            *("pottery", Path(root), SETTINGS, METHODS, (0.3, 1.0, 3.0), [1, 2, 3, 4]),
            *(seconds, measured, ERROR, True),
        )
    goal = found[found["method"] == "uniform"][ERROR].median()
    rows = []
    for name, own in found.groupby("method", sort=False):
        row = {"scene": "pottery", "method": name, "factor": own["factor"].iloc[0]}
        row |= {"seeds": len(own), "seconds": seconds, **own[[*MEASURES]].median()}
        row |= {f"{ERROR}_low": own[ERROR].min(), f"{ERROR}_high": own[ERROR].max()}
        times = [reached(h, goal, ERROR) / seconds for h in own["history"]]
        row["time_to_uniform"] = np.median(times)
        rows.append(row)
    return first, pandas.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=2)
    chosen = parser.parse_args()
    card = {"card": backend.start("cuda_ad_rgb").device, "day": datetime.date.today().isoformat()}
    found = steps(chosen.rounds).assign(**card)
    found.to_csv(RESULTS / "gpu_steps.csv", index=False, float_format="%.5f")
    print(found.to_string(index=False), flush=True)
    first, found = (each.assign(**card) for each in race(chosen.seconds))
    first = first[["scene", "method", "factor", "seed", ERROR, "card", "day"]]
    first.to_csv(RESULTS / "gpu_rates.csv", index=False, float_format="%.4g")
    found.to_csv(RESULTS / "gpu_race.csv", index=False, float_format="%.4g")
    print(found.to_string(index=False), flush=True)
    pages.write()


if __name__ == "__main__":
    main()
