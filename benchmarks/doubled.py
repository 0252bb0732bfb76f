"""Whether cleaner targets would end nearer: the default `target.noise` against half its variance.

On all scenes with an unknown texture, everything else as `isas run` has it by default, but for the
end after so many iterations: more than a minute holds on two cores, and no times count, so that
this may run beside other work. Half the variance is what doubling independent paths gives. Writes
results/doubled.csv, a row a scene: final parameter errors, and `quotient`, the cleaner one's over
the default's. The goal is that no scene gains more than 3 %.

    .venv/bin/python benchmarks/doubled.py [SCENE …] [--iterations N] [--seeds N]
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path

import _contest
import numpy as np
import pages
import pandas
from reproduce import RESULTS
from steps_or_paths import TEXTURES

from isas_cli.config.schema import TargetConfig

SETTINGS = ["evaluation.count=1", *_contest.QUIET]
NOISES = TargetConfig().wanted, round(TargetConfig().wanted / math.sqrt(2), 5)


def measured(scene: str, folder: Path, iterations: int, seeds: int) -> dict:
    contestants = [(noise, {"sampler": "progress", "target.noise": noise}) for noise in NOISES]
    settings = [*SETTINGS, f"budget.iterations={iterations}"]
    found = _contest.race(
        *(scene, folder, settings, contestants, list(range(1, seeds + 1)), None),
        lambda run: {"logarithm": np.log(run.history["parameter_rmse"].iloc[-1])},
    )
    means = found.groupby("method")["logarithm"].mean()
    plain, clean = (float(np.exp(means[noise])) for noise in NOISES)
    row = {"scene": scene, "iterations": iterations, "seeds": seeds, "noise": NOISES[0]}
    return row | {"parameter_rmse": plain, "cleaner": clean, "quotient": clean / plain}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE")
    parser.add_argument("--iterations", type=int, default=1500)
    parser.add_argument("--seeds", type=int, default=1)
    chosen = parser.parse_args()
    path = RESULTS / "doubled.csv"
    for scene in chosen.scenes or TEXTURES:
        with tempfile.TemporaryDirectory() as folder:
            row = measured(scene, Path(folder), chosen.iterations, chosen.seeds)
        _contest.write(path, pandas.DataFrame([row]))
        print(pandas.read_csv(path).to_string(index=False), flush=True)
        pages.write()


if __name__ == "__main__":
    main()
