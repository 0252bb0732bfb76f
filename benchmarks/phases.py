"""Where an iteration's time goes, on every scene: `isas run profile=true` at the defaults.

Writes results/phases.csv, one row per scene and phase.
"""

from __future__ import annotations

import argparse
import datetime
import subprocess
import sys
import tempfile
from pathlib import Path

import pages
import pandas

HERE = Path(__file__).parent
SCENES = ("pottery", "jumpydumpy", "dodoco")
COMMON = ["profile=true", "effects=full", "target.spp=16", "evaluation.count=2", "frames.views=0"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sampler", default="ours")
    parser.add_argument("--seconds", type=float, default=20.0)
    chosen = parser.parse_args()
    tables = []
    with tempfile.TemporaryDirectory(prefix="isas-phases-") as root:
        for scene in SCENES:
            folder = Path(root) / scene
            command = [sys.executable, "-m", "isas_cli", "run", f"scene={scene}", *COMMON]
            command += [f"sampler={chosen.sampler}", f"budget.seconds={chosen.seconds}"]
            subprocess.run([*command, f"hydra.run.dir={folder}"], check=True)
            tables.append(pandas.read_csv(folder / "profile.csv"))
            tables[-1].insert(0, "scene", scene)
    table = pandas.concat(tables).assign(day=datetime.date.today().isoformat())
    table.to_csv(HERE / "results" / "phases.csv", index=False, float_format="%.4g")
    pages.write()


if __name__ == "__main__":
    main()
