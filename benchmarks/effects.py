"""What leaving out effects saves in time and costs in accuracy: plans race at equal time.

On each scene, with `sampler=progress`: everything (`full`), the plan that is made (`auto`), and,
where paths may be shorter than the scene's own, `auto` with the shortest that meet every unknown
until the last third of the budget (`staged`) and everything with paths cut to each such depth
(`depth 2`, …). Each at the best of three factors on the rates with the first seeds, or one beyond
where the best was the last or the first, by the final parameter error, then with three others,
which alone are reported. Settings are those of `reproduce.py`, but for the estimator, which is the
one that runs have by default. Writes
results/effects.csv (a row per scene and plan), effects_rates.csv and, where paths may be shorter,
effects_<scene>.png (error against billed time).

    .venv/bin/python benchmarks/effects.py pottery bowl
"""

from __future__ import annotations

import argparse
import datetime
import importlib
import subprocess
import sys
import tempfile
from pathlib import Path

import _contest
import pages
import pandas
import reproduce
from reproduce import COMMON, MEASURE, RESULTS

from isas_cli import records

SCENES = [name for name, each in reproduce.SCENES.items() if not each.scene]
SETTINGS = [*COMMON, "frames.views=0", "report=false"]
SECONDS = 10.0  # billed: what pays for a probe
FACTORS = (0.5, 1.0, 2.0)  # of the scene's rates
FULL, AUTO, STAGED = "full", "auto", "staged"
LADDER = (2, 3, 4, 6, 8)


def plans(scene: str) -> dict[str, dict]:
    """Name → settings. Depths below the scene's own, which its module states."""
    found = {FULL: {"effects": "full"}, AUTO: {"effects": "auto"}}
    from isas_cli.config.compose import compose
    from isas_cli.runtime import backend

    backend.start()
    cfg = compose([f"scene={scene}", "size=tiny"]).scene
    module, _, build = cfg.builder.rpartition(".")
    scenery = getattr(importlib.import_module(module), build)(**cfg.arguments)
    depths = [d for d in LADDER if d < scenery["integrator"]["max_depth"]]
    # What is too short for an unknown is refused.
    while depths and not _reaches(scene, depths[0]):
        depths.pop(0)
    if depths:
        found[STAGED] = {"effects": "auto", "effects.max_depth": depths[0], "effects.finish": 0.33}
    return found | {f"depth {d}": {"effects": "full", "effects.max_depth": d} for d in depths}


def _reaches(scene: str, depth: int) -> bool:
    """Whether paths of so many edges reach every unknown."""
    command = [sys.executable, "-m", "isas_cli", "effects", f"scene={scene}", "size=tiny"]
    command += ["effects=full", f"effects.max_depth={depth}"]
    return subprocess.run(command, capture_output=True).returncode == 0


def measured(run: records.Run) -> dict:
    plan, last = run.manifest["plan"], run.history.iloc[-1]
    return {
        MEASURE: last[MEASURE],
        "image_rmse": last["image_rmse"],
        "iterations": int(last["iteration"]),
        "left_out": run.summary.get("left_out_rmse"),
        "depth": plan["max_depth"],
        "derivative": plan["derivative_depth"],
        "light_samples": " ".join(map(str, plan["light_samples"])),
        "directions": plan["directions"],
        "caustics": plan["caustics"],
        "probe": plan["probe_seconds"],
        "noise": run.config["target"]["noise"],
        "threads": run.manifest["threads"],
        "passes": run.config["sampler"]["passes"],
        "day": datetime.date.today().isoformat(),
    }


def table(found: pandas.DataFrame, seconds: float) -> pandas.DataFrame:
    """Medians and ranges; ``time_to_full``: share of the budget to the median final parameter error
    of `full`."""
    same = ["scene", "method", "factor", "depth", "derivative", "light_samples", "directions"]
    same += ["caustics", "probe", "noise", "threads", "passes", "day"]
    columns = [*_contest.ranged(MEASURE, "image_rmse"), "left_out", "iterations"]
    columns += _contest.ranged("time_to_full")
    return _contest.told(found, seconds, columns, MEASURE, {"time_to_full": FULL}, same)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(SCENES)}")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4])
    parser.add_argument("--choosing", type=int, default=1, help="how many seeds choose the rates")
    parser.add_argument("--folder", type=Path, help="where runs go (default: a new folder)")
    chosen = parser.parse_args()
    root = chosen.folder or Path(tempfile.mkdtemp(prefix="isas-effects-"))
    root.mkdir(parents=True, exist_ok=True)
    print(f"runs: {root}", flush=True)
    for scene in chosen.scenes or SCENES:
        named = plans(scene)
        settings = [*SETTINGS, *reproduce.SCENES[scene].settings]
        first, found = _contest.judged(
            *(scene, root / scene, settings, named, FACTORS, chosen.seeds, SECONDS),
            *(measured, MEASURE, 1, chosen.choosing),
        )
        made = table(found, SECONDS)
        print(made.to_string(index=False), flush=True)
        # After each scene: what is measured survives what follows.
        _contest.write(RESULTS / "effects.csv", made)
        _contest.write(RESULTS / "effects_rates.csv", first)
        others = tuple(each for each in named if each not in (FULL, AUTO))
        if others:  # the page shows no other scene's
            plot = RESULTS / f"effects_{scene}.png"
            _contest.draw(found, plot, MEASURE, "parameter error", dotted=others)
        pages.write()


if __name__ == "__main__":
    main()
