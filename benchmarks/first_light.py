"""Pottery, 16 × 512² views: how far 60 billed seconds go, what stage 1 costs, how soon it starts.

Runs `isas run` once per sampler, learning rate and seed, the samplers in turn; every sampler gets
the same grid of learning rates and is judged by its best. The first run of all fills the caches
of targets and kernels and does not count. Writes results/first_light.csv (one row per run) and
results/first_light.png (the best run of each sampler).
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas
from matplotlib.figure import Figure

from isas_cli import records

HERE = Path(__file__).parent
ISAS = [sys.executable, "-m", "isas_cli"]
SCENE = ["scene=pottery", "scene.arguments.resolution=512", "frames.views=0"]
GOAL = 0.4  # of the start's parameter error


def run(folder: Path, *overrides: str) -> tuple[records.Run, float]:
    """The record, and the seconds from the command to the first billed iteration."""
    begin = time.perf_counter()
    command = [*ISAS, "run", *SCENE, f"hydra.run.dir={folder}", *overrides]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    # The history's first row is written right before the first billed iteration.
    while process.poll() is None and not (folder / "history.csv").exists():
        time.sleep(0.02)
    started = time.perf_counter() - begin
    _, errors = process.communicate()
    if process.returncode:
        raise SystemExit(errors)
    return records.load(folder), started


def seconds_to(history: pandas.DataFrame, share: float) -> float:
    """Billed seconds until the parameter error first falls to ``share`` of its start, between
    evaluations by linear interpolation of log error; NaN when it never does."""
    error = np.log(history["parameter_rmse"].to_numpy())
    goal = error[0] + np.log(share)
    below = np.flatnonzero(error <= goal)
    if below.size == 0:
        return float("nan")
    i = below[0]
    seconds = history["seconds"].to_numpy()
    part = (error[i - 1] - goal) / (error[i - 1] - error[i])
    return float(seconds[i - 1] + part * (seconds[i] - seconds[i - 1]))


def row(sampler: str, lr: float, seed: int, record: records.Run, started: float) -> dict:
    history, summary = record.history, record.summary
    share = history["parameter_rmse"].iloc[-1] / history["parameter_rmse"].iloc[0]
    return {
        "sampler": sampler,
        "lr": lr,
        "seed": seed,
        "final_share": share,
        f"seconds_to_{GOAL}": seconds_to(history, GOAL),
        "image_rmse": history["image_rmse"].iloc[-1],
        "iterations": summary["iterations"],
        "paths": summary["paths"],
        "stage1_share": summary["seconds_by_phase"].get("stage1", 0) / summary["seconds_billed"],
        "seconds_before_first_iteration": started,
        "nonfinite": int(history["nonfinite"].iloc[-1]),
    }


def plot(best: dict[str, pandas.DataFrame], path: Path) -> None:
    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.add_subplot(xlabel="billed seconds", ylabel="parameter RMSE")
    for sampler, history in best.items():
        axes.plot(history["seconds"], history["parameter_rmse"], ".-", label=sampler)
    axes.axhline(GOAL * next(iter(best.values()))["parameter_rmse"].iloc[0], color="0.6", lw=0.8)
    axes.set_yscale("log")
    axes.legend()
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--samplers", nargs="+", default=["uniform", "relevant", "gradient", "ours", "balanced"]
    )
    parser.add_argument("--rates", nargs="+", type=float, default=[0.01, 0.02])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    parser.add_argument("--seconds", type=float, default=60)
    chosen = parser.parse_args()
    work = Path(tempfile.mkdtemp(prefix="isas-first-light-"))
    run(work / "warm", "budget.iterations=3", "evaluation.count=1")
    rows, histories = [], {}
    for seed in chosen.seeds:
        for lr in chosen.rates:
            for sampler in chosen.samplers:
                record, started = run(
                    work / f"{sampler}-{lr}-{seed}",
                    f"sampler={sampler}",
                    f"optimizer.lr={lr}",
                    f"seed={seed}",
                    f"budget.seconds={chosen.seconds}",
                )
                rows.append(row(sampler, lr, seed, record, started))
                histories[sampler, lr, seed] = record.history
                print(pandas.DataFrame(rows[-1:]).to_string(index=False, header=len(rows) == 1))
    table = pandas.DataFrame(rows)
    (HERE / "results").mkdir(exist_ok=True)
    table.to_csv(HERE / "results" / "first_light.csv", index=False, float_format="%.5g")
    mean = table.groupby(["sampler", "lr"])["final_share"].mean()
    rates = mean.groupby("sampler").idxmin()
    best = {s: histories[s, rates[s][1], chosen.seeds[0]] for s in chosen.samplers}
    plot(best, HERE / "results" / "first_light.png")
    print("\nbest rate of each:")
    for sampler, (_, lr) in rates.items():
        print(table[(table.sampler == sampler) & (table.lr == lr)].to_string(index=False))
    shutil.rmtree(work)


if __name__ == "__main__":
    main()
