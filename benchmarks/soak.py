"""An hour of all kinds of problem: memory stays flat, and so does the time of a step.

Each kind runs in a process of its own for its part of the hour, with steps too small to change
anything, so that every step is the same work; the last kind is many small runs in one process. The
first quarter warms up. Writes results/soak.csv: memory at the end over that after a quarter (goal:
within 2 %), and the median time of a step in the last quarter over that in the second (within 5 %).
Ends with status 1 where a goal is missed.

    make soak
    .venv/bin/python benchmarks/soak.py --minutes 6
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pandas

HERE = Path(__file__).resolve()
RESULTS = HERE.parent / "results"
MEMORY, STEP = 0.02, 0.05
_STILL = ["optimizer.lr=1e-12", "target.spp=16", "frames.views=1", "frames.snapshots=0"]
_STILL += ["report=false", "evaluation.count=200", "evaluation.pixels=4096", "effects=full"]
# By what is unknown, and how its derivatives are had.
KINDS = {
    "texture": ["scene=pottery", "sampler=progress"],
    "texture, looks at every tenth step": ["scene=bowl", "sampler=ours", "sampler.refresh=10"],
    "numbers, derivative sampling": ["scene=trashcan", "estimator.derivative_sampling=true"],
    "texture and number": ["scene=multires", "sampler=multiresolution"],
    "long paths": ["scene=earth", "sampler=uniform"],
    "through glass": ["scene=caustic_failure", "sampler=relevant"],
    "a pose": ["scene=cup", "sampler=plateau", "estimator.batch=2048", "estimator.spp=4"],
    "many poses": ["scene=sort", "sampler=plateau", "estimator.batch=2048"],
    "Mitsuba's own loop": ["scene=pottery", "sampler=mitsuba"],
}
MANY = "many small runs in one process"
_SMALL = ["scene=pottery", "size=tiny", "estimator.batch=1024", "budget.iterations=20"]


def child(kind: str, seconds: float, folder: Path) -> None:
    """Prints a JSON object: (seconds, bytes) while it ran, and (iteration, billed seconds)."""
    import psutil

    import isas_cli

    process, begun, sizes = psutil.Process(), time.monotonic(), []

    def watch() -> None:
        while True:
            sizes.append((time.monotonic() - begun, process.memory_info().rss))
            time.sleep(0.5)

    threading.Thread(target=watch, daemon=True).start()
    if kind == MANY:
        steps, number = [], 0
        while time.monotonic() - begun < seconds:
            started, number = time.monotonic(), number + 1
            settings = [*_SMALL, *_STILL, f"hydra.run.dir={folder / str(number % 2)}"]
            isas_cli.run(*settings, "overwrite=true")
            # A run counts as a step here.
            steps.append((number, (steps[-1][1] if steps else 0) + time.monotonic() - started))
    else:
        settings = [*KINDS[kind], *_STILL, f"budget.seconds={seconds}", f"hydra.run.dir={folder}"]
        history = isas_cli.run(*settings).history
        steps = list(zip(history["iteration"].tolist(), history["seconds"].tolist()))
    print(json.dumps({"sizes": sizes, "steps": steps}))


def judged(kind: str, found: dict, seconds: float) -> dict:
    moments, sizes = np.array(found["sizes"]).T
    iterations, spent = np.array(found["steps"]).T
    whole = spent[-1]
    each = np.diff(spent) / np.maximum(np.diff(iterations), 1)
    middle = spent[1:] / whole

    def memory(share: float) -> float:
        at = moments[-1] * share
        return float(np.median(sizes[(moments > at - 10) & (moments <= at + 10)]))

    second, last = (
        np.median(each[(middle > low) & (middle <= low + 0.25)]) for low in (0.25, 0.75)
    )
    return {
        "kind": kind,
        "seconds": round(seconds),
        "steps": int(iterations[-1]),
        "MiB": memory(0.95) / 2**20,
        "memory": memory(0.95) / memory(0.25),
        "step": float(last / second),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.child:
        kind, seconds, folder = chosen.child
        child(kind, float(seconds), Path(folder))
        return 0
    rows, seconds = [], 60 * chosen.minutes / (len(KINDS) + 1)
    for kind in [*KINDS, MANY]:
        with tempfile.TemporaryDirectory(prefix="isas-soak-") as folder:
            command = [sys.executable, str(HERE), "--child", kind, str(seconds), f"{folder}/run"]
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
        rows.append(judged(kind, json.loads(done.stdout.splitlines()[-1]), seconds))
        # After each kind: what is measured survives what follows.
        table = pandas.DataFrame(rows)
        table.to_csv(RESULTS / "soak.csv", index=False, float_format="%.4g")
        print(table.tail(1).to_string(header=len(rows) == 1), flush=True)
    missed = table[(table["memory"] > 1 + MEMORY) | (abs(table["step"] - 1) > STEP)]
    print(f"beyond the goals: {', '.join(missed['kind']) or 'none'}")
    return 1 if len(missed) else 0


if __name__ == "__main__":
    sys.exit(main())
