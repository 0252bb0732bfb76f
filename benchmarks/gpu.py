"""On a graphics card: races of samplers at the default size and at the papers' sizes, and a step
against Mitsuba's usual loop.

Races (`_contest.judged`): the default configuration, each method at three factors on its rate with
the first seed (and at one beyond an end), then at its best with two others, which alone are
reported. At the default size Mitsuba's usual loop races, too; at the papers' its step, all pixels
of all views, takes more memory than a card has. Steps are those of `step_time.py`, sides in turn, a
process each. Writes results/gpu_race.csv (a row a method), gpu_rates.csv (a row a run) and
gpu_steps.csv (a row a process), with the card's name and the day.

    .venv/bin/python benchmarks/gpu.py
"""

from __future__ import annotations

import argparse
import datetime
import tempfile
from pathlib import Path

import _contest
import pages
import pandas
from step_time import SIDES, measure

from isas_cli import records
from isas_cli.runtime import backend

RESULTS = Path(__file__).parent / "results"
BATCHES = (65536, 1 << 20)
ERROR, STOCK = "parameter_rmse", "Mitsuba's loop"
MEASURES = (ERROR, "image_rmse", "iteration", "paths")
METHODS = {name: {"sampler": name} for name in ("uniform", "ours", "progress")}
VARIANT = "cuda_ad_rgb"
CARD = f"variant={VARIANT}"  # of other processes, where auto might take LLVM
PLAIN = ["evaluation.count=24", CARD, *_contest.QUIET]
# Films of 8 to 67 million pixels: at the default noise their targets would take minutes.
PAPER = ["size=paper", "estimator.batch=1048576", "target.noise=0.06"]
PAPERS = ("bowl", "earth", "pottery")


def steps(rounds: int) -> pandas.DataFrame:
    measure("isas", BATCHES[0], 1, CARD)  # fills the caches of targets and kernels
    rows = []
    for batch in BATCHES:
        for number in range(rounds):
            for side in SIDES:
                row = {"batch": batch, "round": number, "side": side}
                rows.append(row | {"seconds": measure(side, batch, 25, CARD)})
    return pandas.DataFrame(rows)


def measured(run: records.Run) -> dict:
    first, last = run.history.iloc[0], run.history.iloc[-1]
    found = dict(last[[*MEASURES]]) | {"target_noise": run.config["target"].get("noise")}
    return found | {"share_of_start": last[ERROR] / first[ERROR]}


def race(scene: str, size: str, seconds: float) -> tuple[pandas.DataFrame, pandas.DataFrame]:
    """The runs at all rates, and a row a method."""
    methods, settings = METHODS, [*PLAIN, *PAPER]
    if size == "default":
        methods = METHODS | {STOCK: {"sampler": "mitsuba"}}
        settings = [*PLAIN, "estimator.batch=65536"]
    with tempfile.TemporaryDirectory(prefix="isas-gpu-") as root:
        first, found = _contest.judged(
            *(scene, Path(root), settings, methods, (0.3, 1.0, 3.0), [1, 2, 3]),
            *(seconds, measured, ERROR, 1),
        )
    rivals = {"time_to_uniform": "uniform"}
    columns = [*MEASURES, f"{ERROR}_low", f"{ERROR}_high", "target_noise", "share_of_start"]
    same = ("scene", "size", "method", "factor")
    first, found = (each.assign(size=size) for each in (first, found))
    return first, _contest.told(found, seconds, [*columns, *rivals], ERROR, rivals, same)


def write(name: str, rows: pandas.DataFrame, keys: list[str]) -> None:
    """Whatever card earlier rows are of."""
    _contest.write(RESULTS / name, rows, keys)
    print(rows.to_string(index=False), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=2)
    parser.add_argument("--paper", type=float, default=5, help="seconds at the papers' sizes")
    parser.add_argument("--parts", nargs="+", default=["default", *PAPERS, "steps"])
    chosen = parser.parse_args()
    card = {"card": backend.start(VARIANT).device, "day": datetime.date.today().isoformat()}
    for part in chosen.parts:
        if part == "steps":
            write("gpu_steps.csv", steps(chosen.rounds).assign(**card), ["batch"])
        else:
            own = part, "paper", chosen.paper
            if part == "default":
                own = "pottery", part, chosen.seconds
            first, found = (each.assign(**card) for each in race(*own))
            first = first[["scene", "size", "method", "factor", "seed", ERROR, "card", "day"]]
            write("gpu_rates.csv", first, ["scene", "size"])
            write("gpu_race.csv", found, ["scene", "size"])
    pages.write()


if __name__ == "__main__":
    main()
