"""The variance of the loss gradient on dodoco with each sampler: the paper's figure 3.

`isas variance` with 1,024 estimates of 65,536 pixels each, the best pmf from 256 paths per pixel.
Writes results/variance_dodoco.csv, and the density maps as variance_dodoco_densities.png.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pages

HERE = Path(__file__).parent
CONTESTANTS = "[{sampler:ours},{sampler:joint},{sampler:progress}]"
MADE = {"variance.csv": ".csv", "densities_v00.png": "_densities.png"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=1024)
    parser.add_argument("--best", type=int, default=256)
    parser.add_argument("--folder", type=Path, help="where to measure (default: a new folder)")
    chosen = parser.parse_args()
    folder = chosen.folder or Path(tempfile.mkdtemp(prefix="isas-variance-")) / "dodoco"
    command = [sys.executable, "-m", "isas_cli", "variance", "scene=dodoco"]
    command += [f"contestants={CONTESTANTS}", f"repeats={chosen.repeats}", f"best={chosen.best}"]
    subprocess.run([*command, f"hydra.run.dir={folder}"], check=True)
    for name, ending in MADE.items():
        shutil.copy(folder / name, HERE / "results" / f"variance_dodoco{ending}")
    pages.write()


if __name__ == "__main__":
    main()
