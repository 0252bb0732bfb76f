"""The losses along the unknowns of PRDPT's tasks, hard and blurred, with the way that a run took.

As the paper's Fig. 2. Per task one run of `sampler=plateau` at a smaller batch, and then
`isas landscape`. Not of sort, which has 150 unknowns. Writes results/plateau_landscape_<task>.png.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from _plateau_table import asked
from PIL import Image

RESULTS = Path(__file__).parent / "results"
# Iterations of the run, and along which numbers.
TASKS = {
    "cup": (300, ["cup.angle"]),
    "shadows": (1000, ["ball.place/0", "ball.place/1"]),
    "occlusion": (300, ["red.depth"]),
    "global_illumination": (800, ["lamp.place/0", "lamp.place/1"]),
    "caustic": (1500, ["lamp.place/0", "lamp.place/1"]),
}


def isas(*arguments: str) -> None:
    subprocess.run([sys.executable, "-m", "isas_cli", *arguments], check=True)


def draw(task: str, folder: Path) -> None:
    iterations, along = TASKS[task]
    run = [f"scene={task}", "sampler=plateau", f"budget.iterations={iterations}"]
    run += ["~scene.method", "estimator.batch=16384", "evaluation.count=40", "frames.views=0"]
    isas("run", *run, "frames.snapshots=0", "report=false", f"hydra.run.dir={folder}")
    isas("landscape", str(folder), "--along", *along)
    plot = Image.open(folder / "plots" / "landscape.png").convert("RGB").quantize(64)
    plot.save(RESULTS / f"plateau_landscape_{task}.png", optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    chosen = asked(parser, TASKS)
    for task in chosen.tasks:
        with tempfile.TemporaryDirectory(prefix="isas-landscape-") as root:
            draw(task, Path(root) / task)


if __name__ == "__main__":
    main()
