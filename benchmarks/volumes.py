"""Volumes from images: samplers race at equal time, from coarse to fine and on the fine grid alone.

On smoke and lego every sampler from coarse to fine, some on the fine grid from the start, and, in a
race of their own after it, some with half the budget; at some factors on the scene's rates each
with the first seed, and at one beyond where the best was an end of them; then each at its best, by
the final image error, with three others, which alone are reported: what no image tells is in the
parameters' error. Contestants take turns. Writes results/volumes.csv (a row per scene and method),
volumes_rates.csv and volumes_<scene>.png (image error against billed time).

    make reproduce SCENES="smoke lego"
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import _contest
import pages
import pandas

from isas_cli import records

RESULTS = Path(__file__).parent / "results"
ERROR, BASE, FINE, HALF = "image_rmse", "uniform", ", fine", ", half"
# Levels and rates go by shares of the budget: whether a method needs half the time is seen by
# giving it half the time.
PROMISED = ("ours", "progress")
# Billed seconds, factors on the scene's rates, and settings: smoke's images are noisier than what
# runs leave of their error.
SCENES = {
    "smoke": (12.0, (0.1, 0.3, 1.0), ["evaluation.spp=16", "evaluation.count=12"]),
    "lego": (12.0, (1.0, 3.0, 10.0), []),
}
SAMPLERS = ("uniform", "relevant", "gradient", "ours", "multiresolution", "progress")
SETTINGS = ["estimator.batch=16384", "target.noise=0.01", "evaluation.count=24", "effects=full"]
SETTINGS += ["frames.views=1", "frames.snapshots=0", "report=false"]


def methods() -> dict[str, dict]:
    """Settings by name."""
    found = {name: {"sampler": name} for name in SAMPLERS}
    for name in (BASE, *PROMISED):
        found[name + FINE] = {"sampler": name, "scene.sizes.default.levels": 1}
    return found


def judged(scene: str, root: Path, seconds: float, seeds: list[int], factors, settings: list[str]):
    """See ``_contest.judged``: with all of the budget, and with half of it."""
    halved = {name + HALF: {"sampler": name} for name in PROMISED}
    races = [(root / "whole", methods(), seconds), (root / "half", halved, seconds / 2)]
    found = [
        _contest.judged(scene, own, settings, named, factors, seeds, time, measured, ERROR, 1)
        for own, named, time in races
    ]
    return [pandas.concat(each, ignore_index=True) for each in zip(*found)]


def measured(run: records.Run) -> dict:
    first, last = run.history.iloc[0], run.history.iloc[-1]
    found = {"start": first[ERROR], ERROR: last[ERROR], "parameter_rmse": last["parameter_rmse"]}
    found["stage1_share"] = last["stage1_seconds"] / last["seconds"]
    return found | {"iterations": int(last["iteration"])}


def table(found: pandas.DataFrame, seconds: float) -> pandas.DataFrame:
    """Medians; ``time_to_uniform``: share of the budget to the median final image error of
    `uniform`; ``time_to_fine``: to that of `uniform` on the fine grid alone."""
    columns = ["start", *_contest.ranged(ERROR, "parameter_rmse"), "iterations", "stage1_share"]
    rivals = {"time_to_uniform": BASE, "time_to_fine": BASE + FINE}
    return _contest.told(found, seconds, [*columns, *rivals], ERROR, rivals)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, help="budget of each run, instead of the scene's")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4])
    parser.add_argument("--scenes", nargs="+", default=[*SCENES])
    chosen = parser.parse_args()
    for scene in chosen.scenes:
        usual, factors, more = SCENES[scene]
        seconds, settings = chosen.seconds or usual, SETTINGS + more
        with tempfile.TemporaryDirectory(prefix="isas-volumes-") as root:
            asked = seconds, chosen.seeds, factors, settings
            first, found = judged(scene, Path(root), *asked)
            plot = RESULTS / f"volumes_{scene}.png"
            _contest.draw(found, plot, ERROR, "image error", dotted=(FINE, HALF))
            # After each scene: what is measured survives what follows.
            made = table(found, seconds)
            print(made.to_string(index=False), flush=True)
            _contest.write(RESULTS / "volumes.csv", made)
            _contest.write(RESULTS / "volumes_rates.csv", first)
            pages.write()


if __name__ == "__main__":
    main()
