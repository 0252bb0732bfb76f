"""What a record costs: share of wall time that goes into writing, at the defaults of pottery.

Runs `isas run` without a tracker and with tensorboard, in turn, and takes the share from each
run's own account of its unbilled phases: writing (history, checkpoints, manifest, pictures' files
at the start), beside rendering the snapshots and the pictures at the end, which is not writing.
Nothing of it is billed, so the second figure is the iterations per billed second of the two sides.
Writes results/recording.csv.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pages
import pandas

from isas_cli import records

HERE = Path(__file__).parent
SIDES = ("none", "tensorboard")


def run(folder: Path, tracker: str, seconds: float) -> dict:
    command = [sys.executable, "-m", "isas_cli", "run", "scene=pottery", f"tracker={tracker}"]
    command += [f"hydra.run.dir={folder}", f"budget.seconds={seconds}"]
    begin = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    wall = time.perf_counter() - begin
    summary = records.load(folder).summary
    unbilled = summary["seconds_unbilled"]
    return {
        "tracker": tracker,
        "writing_share_of_wall": unbilled["writing"] / wall,
        "pictures_share_of_wall": unbilled["pictures"] / wall,
        "iterations_per_billed_second": summary["iterations"] / summary["seconds_billed"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=30)
    chosen = parser.parse_args()
    work = Path(tempfile.mkdtemp(prefix="isas-recording-"))
    run(work / "warm", "none", 1)
    rows = []
    for number in range(chosen.rounds):
        for tracker in SIDES:
            rows.append(run(work / f"{tracker}-{number}", tracker, chosen.seconds))
            print(pandas.DataFrame(rows[-1:]).to_string(index=False, header=len(rows) == 1))
    table = pandas.DataFrame(rows)
    table.to_csv(HERE / "results" / "recording.csv", index=False, float_format="%.4g")
    pages.write()
    speed = table.groupby("tracker")["iterations_per_billed_second"].median()
    writing = table.groupby("tracker")["writing_share_of_wall"].max()
    print(f"writing at most {writing['none']:.2%} of wall time, {writing['tensorboard']:.2%} with")
    print(
        f"tensorboard; speed with / without tensorboard {speed['tensorboard'] / speed['none']:.3f}"
    )


if __name__ == "__main__":
    main()
