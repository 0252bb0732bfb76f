"""How large `laplacian`'s steps are and how they fall, on scenes that do not judge the default.

`isas race` of ``WAYS`` with everything else as it is by default, 20 billed seconds each, on the
scenes of `_choosing.py`. Writes results/choosing.csv, a row for each scene, way and seed.

    .venv/bin/python benchmarks/choosing.py [SCENE …] [--seconds 20] [--seeds 1]
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import _contest
import pages
import pandas
from _choosing import SCENES

from isas_cli import records

RESULTS, HERE = Path(__file__).parent / "results", Path(__file__).parent.resolve()
MEASURES = ["parameter_rmse", "image_rmse"]
KEYS = ["filter", "rate", "half"]
# Filter, the share of the rate that each of its resolutions takes, steps to half of the rates.
WAYS = [("none", None, 40), ("gaussian", None, 40), ("laplacian", 0.25, 40)]
WAYS += [("laplacian", 0.5, half) for half in (20, 40, 80)]
SETTINGS = ["evaluation.count=10", *_contest.QUIET]


def measured(run: records.Run) -> dict:
    optimizer, last = run.config["optimizer"], run.history.iloc[-1]
    own = optimizer["filter"]["name"], optimizer["filter"].get("rate"), optimizer["half"]
    row = {"scene": run.config["scene"]["name"], **dict(zip(KEYS, own))}
    row |= {"seconds": run.config["budget"]["seconds"], "iterations": int(last["iteration"])}
    return row | {name: last[name] for name in MEASURES}


def raced(scene: str, seconds: float, seeds: list[int], folder: Path) -> pandas.DataFrame:
    ways = []
    for name, rate, half in WAYS:
        own = {"optimizer.filter": name} | ({"optimizer.filter.rate": rate} if rate else {})
        ways.append((name, own | {"optimizer.half": half}))
    settings = [*SETTINGS, f"scene.builder=_choosing.{scene}", f"scene.name={scene}"]
    found = _contest.race("jumpydumpy", folder, settings, ways, seeds, seconds, measured)
    return found[["scene", *KEYS, "seed", "seconds", "iterations", *MEASURES]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(SCENES)}")
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    chosen = parser.parse_args()
    path = RESULTS / "choosing.csv"
    os.environ |= {"ISAS_ALLOW": "_choosing", "PYTHONPATH": str(HERE)}
    for scene in chosen.scenes or SCENES:
        with tempfile.TemporaryDirectory(prefix="isas-choosing-") as folder:
            made = raced(scene, chosen.seconds, chosen.seeds, Path(folder))
        _contest.write(path, made)
        pages.write()
        print(made.to_string(index=False), flush=True)


if __name__ == "__main__":
    main()
