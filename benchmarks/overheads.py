"""What taking turns costs a contestant, and what a record costs a run, on pottery.

Turns: iterations per billed second. The same two contestants race in one process and run alone in
processes of their own, in turn. A ratio near 1 says that turns neither slow a contestant (cold
caches, kernels recorded anew) nor bill it for another's work. Writes results/race.csv.

Records: the share of wall time that goes into writing, at the defaults, without a tracker and with
tensorboard, in turn. From each run's own account of its unbilled phases: writing (history,
checkpoints, manifest, pictures' files at the start), beside rendering the snapshots and the
pictures at the end, which is not writing. Nothing of it is billed, so the other figure is the
iterations per billed second. Writes results/recording.csv.
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

RESULTS = Path(__file__).parent / "results"
CONTESTANTS, TRACKERS = ("uniform", "ours"), ("none", "tensorboard")
COMMON = ["effects=full", "frames.views=0", "frames.snapshots=0", "evaluation.count=5"]


def isas(command: str, folder: Path, seconds: float, *settings: str) -> float:
    """Seconds on the wall of a run or race of pottery."""
    words = [sys.executable, "-m", "isas_cli", command, "scene=pottery", *settings]
    words += [f"budget.seconds={seconds}", f"hydra.run.dir={folder}"]
    begun = time.perf_counter()
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    return time.perf_counter() - begun


def speed(folder: Path) -> float:
    summary = records.load(folder).summary
    return summary["iterations"] / summary["seconds_billed"]


def turns(work: Path, seconds: float) -> list[dict]:
    isas("race", work / "race", seconds, *COMMON, f"samplers=[{','.join(CONTESTANTS)}]")
    rows = []
    for name in CONTESTANTS:
        isas("run", work / name, seconds, *COMMON, f"sampler={name}")
        race, alone = speed(work / "race" / name / "seed1"), speed(work / name)
        rows.append({"contestant": name, "race": race, "alone": alone})
        rows[-1]["race_over_alone"] = race / alone
    return rows


def recording(work: Path, seconds: float) -> list[dict]:
    rows = []
    for tracker in TRACKERS:
        wall = isas("run", work / tracker, seconds, f"tracker={tracker}")
        unbilled = records.load(work / tracker).summary["seconds_unbilled"]
        row = {"tracker": tracker}
        row |= {f"{name}_share_of_wall": unbilled[name] / wall for name in ("writing", "pictures")}
        rows.append(row | {"iterations_per_billed_second": speed(work / tracker)})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=15, help="a run; with records twice that")
    chosen = parser.parse_args()
    work = Path(tempfile.mkdtemp(prefix="isas-overheads-"))
    for name, measure, seconds in (
        ("race", turns, chosen.seconds),
        ("recording", recording, 2 * chosen.seconds),
    ):
        measure(work / f"{name}-0", 1)  # fills the caches
        rows = []
        for number in range(1, chosen.rounds + 1):
            rows += measure(work / f"{name}-{number}", seconds)
        table = pandas.DataFrame(rows)
        print(table.to_string(index=False), flush=True)
        table.to_csv(RESULTS / f"{name}.csv", index=False, float_format="%.4g")
    pages.write()


if __name__ == "__main__":
    main()
