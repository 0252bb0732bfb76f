"""Whether taking turns costs a contestant anything: iterations per billed second, race and alone.

Pottery at its defaults; the same two contestants race in one process and run alone in processes of
their own, in turn. A ratio near 1 says that turns neither slow a contestant (cold caches, kernels
recorded anew) nor bill it for another's work. Writes results/race.csv.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import pages
import pandas

from isas_cli import records

HERE = Path(__file__).parent
CONTESTANTS = ("uniform", "ours")
COMMON = [
    "scene=pottery",
    "effects=full",
    "frames.views=0",
    "frames.snapshots=0",
    "evaluation.count=5",
]


def isas(*arguments: str) -> None:
    command = [sys.executable, "-m", "isas_cli", *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)


def speed(folder: Path) -> float:
    summary = records.load(folder).summary
    return summary["iterations"] / summary["seconds_billed"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=15)
    chosen = parser.parse_args()
    work = Path(tempfile.mkdtemp(prefix="isas-race-"))
    rows = []
    for number in range(chosen.rounds + 1):  # the first fills the caches and does not count
        budget = f"budget.seconds={chosen.seconds if number else 1}"
        race = work / f"race-{number}"
        names = ",".join(CONTESTANTS)
        isas("race", *COMMON, f"samplers=[{names}]", budget, f"hydra.run.dir={race}")
        for name in CONTESTANTS:
            alone = work / f"{name}-{number}"
            isas("run", *COMMON, f"sampler={name}", budget, f"hydra.run.dir={alone}")
            if number:
                both = speed(race / name / "seed1"), speed(alone)
                rows.append({"contestant": name, "race": both[0], "alone": both[1]})
                rows[-1]["race_over_alone"] = both[0] / both[1]
                print(pandas.DataFrame(rows[-1:]).to_string(index=False, header=len(rows) == 1))
    table = pandas.DataFrame(rows)
    table.to_csv(HERE / "results" / "race.csv", index=False, float_format="%.4g")
    pages.write()
    ratio = table.groupby("contestant")["race_over_alone"].agg(["median", "min", "max"])
    print(ratio.round(3).to_string())


if __name__ == "__main__":
    main()
