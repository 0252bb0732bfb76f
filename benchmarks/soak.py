"""An hour of all kinds of problem: memory stays flat, and so does the time of a step.

Each kind runs in a process of its own for its part of the hour, with steps too small to change
anything and blurs that stay as wide, so that every step is the same work; the last kind is many
small runs in one process. The first quarter warms up. Writes results/soak.csv: memory in the last
tenth of the loop over that after a quarter (goal: within 2 %), and the median time of a step in the
last quarter over that in the second (within 5 %), with its standard error. Machines drift by more
than that: a fixed piece of work, the control, is timed at every evaluation, and steps are counted
in controls. It is one large kernel, or for kinds whose steps wait for Python (``LAUNCHED``), many
small ones. ``control`` says how the control itself drifted. Ends with status 1 where a goal is
missed.

    make soak
    .venv/bin/python benchmarks/soak.py --minutes 6
    .venv/bin/python benchmarks/soak.py "a mesh" "a volume"     the other kinds keep their rows
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas
import scipy.stats

HERE = Path(__file__).resolve()
RESULTS = HERE.parent / "results"
MEMORY, STEP = 0.02, 0.05
_STILL = ["optimizer.factor=1e-12", "target.spp=16", "frames.views=1", "frames.snapshots=0"]
_STILL += ["report=false", "evaluation.count=60", "evaluation.pixels=4096", "effects=full"]
# By what is unknown, and how its derivatives are had.
KINDS = {
    "texture": ["scene=pottery", "sampler=progress"],
    "texture, looks at every tenth step": ["scene=bowl", "sampler=ours", "sampler.refresh=10"],
    "numbers, derivative sampling": ["scene=trashcan", "estimator.derivative_sampling=true"],
    "texture and number": ["scene=multires", "sampler=multiresolution"],
    "long paths": ["scene=earth", "sampler=uniform"],
    "through glass": ["scene=caustic_failure", "sampler=relevant"],
    "a pose": [
        *("scene=cup", "~scene.method", "sampler=plateau"),
        *("estimator.batch=2048", "estimator.spp=4"),
        'scene.unknowns={"cup.angle": {"start": 170, "blur": {"start": 60, "end": 60}}}',
    ],
    "many poses": [
        *("scene=sort", "~scene.method", "sampler=plateau", "estimator.batch=2048"),
        'scene.unknowns={"cubes.place": {"start": {"uniform": [-0.4, 0.4], "seed": 1}, '
        '"blur": {"start": 0.12, "end": 0.12, "reach": 0.3}}}',
    ],
    "a mesh": ["scene=kirby", "~scene.method", "estimator=silhouettes", "sampler=uniform"],
    "a volume": ["scene=smoke", "sampler=ours"],
    "Mitsuba's own loop": ["scene=pottery", "sampler=mitsuba"],
}
MANY = "many small runs in one process"
_SMALL = ["scene=pottery", "size=tiny", "estimator.batch=1024", "budget.iterations=20"]


# Of short kernels, many a step: what drifts is the time between them.
LAUNCHED = ("a pose", "many poses")


class Watch:
    """At every evaluation: iteration, billed seconds, bytes of memory, seconds of the control."""

    def __init__(self, launched: bool):
        import drjit as dr
        import mitsuba as mi
        import psutil

        self.process, self.rows = psutil.Process(), []

        def work(x):
            for _ in range(1 if launched else 200):
                x = dr.fma(x, dr.sin(x), 0.5)
            return x

        self.work, self.times = dr.freeze(work), 200 if launched else 1
        self.data = mi.Float(np.random.default_rng(1).random(1 << (10 if launched else 20)))
        for _ in range(5):
            self.control()

    def control(self) -> float:
        """Median of five, by as many cores as a step."""
        import drjit as dr

        taken = []
        for _ in range(5):
            dr.sync_thread()
            begun = time.perf_counter()
            for _ in range(self.times):
                dr.eval(self.work(self.data))
            dr.sync_thread()
            taken.append(time.perf_counter() - begun)
        return float(np.median(taken))

    def note(self, iteration: int, seconds: float) -> None:
        memory = self.process.memory_info().rss
        self.rows.append((iteration, seconds, memory, self.control()))


def child(kind: str, seconds: float, folder: Path) -> None:
    """Prints a JSON list of what was watched."""
    from isas_cli.runtime import backend

    backend.start()
    import isas_cli
    from isas_cli.engine.recorder import Recorder

    watch = Watch(kind in LAUNCHED)
    if kind == MANY:
        begun, spent, number = time.monotonic(), 0.0, 0
        while time.monotonic() - begun < seconds:
            started, number = time.monotonic(), number + 1
            settings = [*_SMALL, *_STILL, f"hydra.run.dir={folder / str(number % 2)}"]
            isas_cli.run(*settings, "overwrite=true")
            # A run counts as a step here.
            spent += time.monotonic() - started
            watch.note(number, spent)
    else:
        hooks = Recorder.hooks

        def watched(self, stop):
            found = hooks(self, stop)
            told = found.evaluated

            def evaluated(row: dict) -> None:
                told(row)
                watch.note(row["iteration"], row["seconds"])

            found.evaluated = evaluated
            return found

        Recorder.hooks = watched
        settings = [*KINDS[kind], *_STILL, f"budget.seconds={seconds}", f"hydra.run.dir={folder}"]
        isas_cli.run(*settings)
    print(json.dumps(watch.rows))


def judged(kind: str, found: list, seconds: float) -> dict:
    iterations, spent, sizes, controls = np.array(found).T
    share = spent / spent[-1]
    each = np.diff(spent) / np.maximum(np.diff(iterations), 1)
    control = (controls[1:] + controls[:-1]) / 2

    def within(values: np.ndarray, low: float, high: float) -> np.ndarray:
        at = share[-len(values) :]
        return values[(at > low) & (at <= high)]

    def grown(values: np.ndarray) -> float:
        late, early = within(values, 0.75, 1.0), within(values, 0.25, 0.5)
        return float(np.median(late) / np.median(early))

    late, early = np.median(within(sizes, 0.9, 1.0)), np.median(within(sizes, 0.2, 0.3))
    steps = each / control
    parts = within(steps, 0.75, 1.0), within(steps, 0.25, 0.5)
    error = scipy.stats.bootstrap(
        parts, lambda a, b, axis: np.median(a, axis) / np.median(b, axis), rng=1
    ).standard_error
    return {
        "kind": kind,
        "seconds": round(seconds),
        "steps": int(iterations[-1]),
        "MiB": float(late / 2**20),
        "memory": float(late / early),
        "step": grown(steps),
        "step_error": float(error),
        "control": grown(control),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", metavar="KIND")
    parser.add_argument("--minutes", type=float, default=60, help="of all kinds together")
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.child:
        kind, seconds, folder = chosen.child
        child(kind, float(seconds), Path(folder))
        return 0
    order, seconds = [*KINDS, MANY], 60 * chosen.minutes / (len(KINDS) + 1)
    if set(chosen.kinds) - set(order):
        parser.error(f"kinds: {', '.join(order)}")
    path = RESULTS / "soak.csv"
    rows = pandas.read_csv(path).to_dict("records") if chosen.kinds and path.exists() else []
    for kind in chosen.kinds or order:
        with tempfile.TemporaryDirectory(prefix="isas-soak-") as folder:
            command = [sys.executable, str(HERE), "--child", kind, str(seconds), f"{folder}/run"]
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
        new = judged(kind, json.loads(done.stdout.splitlines()[-1]), seconds)
        print(new, flush=True)
        # After each kind: what is measured survives what follows.
        rows = [row for row in rows if row["kind"] != kind] + [new]
        table = pandas.DataFrame(sorted(rows, key=lambda row: order.index(row["kind"])))
        table.to_csv(path, index=False, float_format="%.4g")
    missed = table[(table["memory"] > 1 + MEMORY) | (abs(table["step"] - 1) > STEP)]
    print(f"beyond the goals: {', '.join(missed['kind']) or 'none'}")
    return 1 if len(missed) else 0


if __name__ == "__main__":
    sys.exit(main())
