"""What the first look of `progress` may cost: everything once, or twice.

Both and `uniform` in turns, at the rates that reproduce.py found best for each, some seeds: the
error over that of `uniform` after a sixteenth, an eighth, a quarter, half and all of the time.
Writes results/first_look.csv.

    .venv/bin/python benchmarks/first_look.py
"""

from __future__ import annotations

import argparse
import datetime
import tempfile
from pathlib import Path

import numpy as np
import pages
import pandas
import reproduce

from isas_cli.runtime import backend

RESULTS = Path(__file__).parent / "results"
SCENES = ("pottery", "bowl", "earth", "catcake")
SHARES = (0.0625, 0.125, 0.25, 0.5, 1.0)
BASE = "uniform"
SIDES = {"once": ["sampler.passes=1"], "twice": ["sampler.passes=2"], BASE: []}


def rate(scene: str, sampler: str) -> float:
    table = pandas.read_csv(RESULTS / f"{scene}.csv").set_index("sampler")
    return float(table.loc[sampler, "rate"])


def measured(scene: str, side: str, seed: int, seconds: float, folder: str) -> list[dict]:
    import isas_cli

    sampler = BASE if side == BASE else "progress"
    run = isas_cli.run(
        *(f"scene={scene}", f"sampler={sampler}", *SIDES[side], *reproduce.COMMON),
        *(*reproduce.SCENES[scene].settings, f"optimizer.lr={rate(scene, sampler)}"),
        *(f"seed={seed}", f"budget.seconds={seconds}", "frames.views=0", "report=false"),
        *("effects=full", f"hydra.run.dir={folder}", "overwrite=true"),
    )
    history = run.history
    errors = np.interp(
        np.multiply(SHARES, seconds), history["seconds"], np.log(history[reproduce.MEASURE])
    )
    place = {"scene": scene, "side": side, "seed": seed, "seconds": seconds}
    return [place | {"share": s, "error": np.exp(e)} for s, e in zip(SHARES, errors)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=15)
    parser.add_argument("--seeds", nargs="+", type=int, default=[2, 3, 4])
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    chosen = parser.parse_args()
    backend.start()
    rows = []
    with tempfile.TemporaryDirectory(prefix="isas-first-look-") as folder:
        for scene in chosen.scenes:
            for seed in chosen.seeds:
                for side in SIDES:
                    rows += measured(scene, side, seed, chosen.seconds, folder)
            table = pandas.DataFrame(rows).assign(day=datetime.date.today().isoformat())
            table.to_csv(RESULTS / "first_look.csv", index=False, float_format="%.4g")
    pages.write()


if __name__ == "__main__":
    main()
