"""The two strips of pictures in the README: a texture that is recovered, a mug that is turned.

Runs of as many iterations as their races have, with more paths in the pictures; nothing is timed.
Writes results/readme_pottery.png and results/readme_cup.png.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import _gallery

RESULTS = Path(__file__).parent / "results"
COMMON = ["evaluation.count=2", "frames.views=1", "frames.snapshots=0", "report=false"]
TITLES = {"start": "start", "result": "result", "target": "truth"}
CUP = ["sampler=plateau", "size=paper", "target.spp=512", "frames.spp=256", "optimizer.final=0.01"]
CUP += ["estimator.batch=2048", "sampler.spp=4", "optimizer.schedule=cosine", "~scene.method"]
# File → settings, what is shown, and how wide.
STRIPS = {
    "readme_pottery": (
        ["scene=pottery", "sampler=progress", "budget.iterations=600", "frames.spp=256"],
        TITLES | {"density": "where samples go"},
        2.4,
    ),
    "readme_cup": (["scene=cup", *CUP, "budget.iterations=400"], TITLES, 2.4),
}


def main() -> None:
    with tempfile.TemporaryDirectory(prefix="isas-pictures-") as root:
        for name, (settings, columns, side) in STRIPS.items():
            folder = Path(root) / name
            command = [sys.executable, "-m", "isas_cli", "run", *settings, *COMMON]
            subprocess.run([*command, f"hydra.run.dir={folder}"], check=True)
            _gallery.write(folder, RESULTS / f"{name}.png", columns, side)


if __name__ == "__main__":
    main()
