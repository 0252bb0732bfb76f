"""Pottery, 16 views of 512²: every sampler at every learning rate of a small grid, raced.

One `isas race`, so that all contestants share a process and its drift; a sampler is judged by its
best rate. Writes results/pottery_race_*: accuracy_time.csv and errors.png of the comparison (whose
page stays in the race's folder), and best.csv, one row per sampler.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas

from isas_cli.compare import read_accuracy

HERE = Path(__file__).parent
SCENE = ["scene=pottery", "scene.arguments.resolution=512", "frames.views=1", "frames.spp=16"]
LEVEL = 0.5  # of the start's parameter error


def best(comparison: Path) -> pandas.DataFrame:
    """The best rate of each sampler by its median final parameter error, and what it reached."""
    methods = read_accuracy(comparison / "methods.csv")
    methods["sampler"] = methods["method"].str.split().str[0]
    chosen = methods.loc[methods.groupby("sampler")["parameter_rmse"].idxmin()]
    accuracy = read_accuracy(comparison / "accuracy_time.csv")
    at = accuracy[(accuracy["measure"] == "parameter_rmse") & (accuracy["level"] == LEVEL)]
    times = at.set_index("method")[["seconds", "seconds_low", "seconds_high"]]
    columns = ["sampler", "method", "runs", "parameter_rmse_share", "parameter_rmse"]
    columns += ["parameter_rmse_low", "parameter_rmse_high", "image_rmse", "iterations"]
    columns += ["stage1_share", "nonfinite"]
    return chosen[columns].join(times.add_suffix(f"_to_{LEVEL}"), on="method")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--samplers", nargs="+", default=["uniform", "relevant", "gradient", "ours", "balanced"]
    )
    parser.add_argument("--rates", nargs="+", type=float, default=[0.01, 0.02])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--folder", type=Path, help="the race's folder (default: a new one)")
    chosen = parser.parse_args()
    folder = chosen.folder or Path(tempfile.mkdtemp(prefix="isas-pottery-race-")) / "race"
    contestants = ",".join(
        f"{{sampler:{sampler},optimizer.lr:{rate}}}"
        for rate in chosen.rates
        for sampler in chosen.samplers
    )
    command = [sys.executable, "-m", "isas_cli", "race", *SCENE, f"contestants=[{contestants}]"]
    command += [f"seed=[{','.join(map(str, chosen.seeds))}]", f"hydra.run.dir={folder}"]
    subprocess.run([*command, f"budget.seconds={chosen.seconds}"], check=True)
    results = HERE / "results"
    results.mkdir(exist_ok=True)
    accuracy = folder / "comparison" / "accuracy_time.csv"
    shutil.copy(accuracy, results / "pottery_race_accuracy_time.csv")
    errors = folder / "comparison" / "plots" / "pottery_errors.png"
    shutil.copy(errors, results / "pottery_race_errors.png")
    table = best(folder / "comparison")
    table.to_csv(results / "pottery_race_best.csv", index=False, float_format="%.4g")
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
