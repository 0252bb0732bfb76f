"""What neighbouring texels do for each other in a step: `optimizer.filter`, at equal iterations.

Each filter as it is by default, at its own best of several factors on the rates, found with a seed
of its own: where the best is the largest or the smallest of them, one more is tried. Targets of
1024 paths a pixel, since what is left of an error would else be theirs; `sampler=progress`, eight
views and a texture of 128². Writes results/filters.csv: a row for each scene, filter and seed,
those that chose the factor (`judged` 0) and those that are judged, with the error over that of
`none` with the same seed. What is not run again keeps its rows. No time is measured.

    .venv/bin/python benchmarks/filters.py dodoco_a pottery --threads 1
    .venv/bin/python benchmarks/filters.py --iterations 400 --seeds 2 3 4
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
SCENES = ("dodoco_a", "pottery", "bowl", "jumpydumpy")
BASE = "none"
FILTERS = (BASE, "gaussian", "james_stein", "bilateral", "laplacian")
FACTORS = (0.5, 1.0, 2.0)
CHOOSING = 1  # the seed that chooses
_FURTHER = 9  # factors at most beyond these
SETTINGS = [*_contest.QUIET, "evaluation.count=1", "evaluation.spp=16", "target.spp=1024"]
SETTINGS += [f"scene.arguments.{name}" for name in ("views=8", "resolution=128", "texture=128")]
MEASURES = ["parameter_rmse", "image_rmse"]
RUN = ["scene", "iterations", "batch", "filter", "factor", "seed"]


def measured(run: records.Run) -> dict:
    last, batch = run.history.iloc[-1], run.config["estimator"]["batch"]
    found = {"iterations": int(last["iteration"]), "batch": batch}
    return found | {name: last[name] for name in MEASURES}


def raced(scene: str, chosen: argparse.Namespace) -> pandas.DataFrame:
    """A row a run, with no filter best at an end of its factors."""
    settings = [*SETTINGS, f"estimator.batch={chosen.batch}", f"threads={chosen.threads}"]
    settings.append(f"budget.iterations={chosen.iterations}")
    names = dict.fromkeys([BASE, *chosen.filters])
    contestants = {name: {"sampler": "progress", "optimizer.filter": name} for name in names}
    with tempfile.TemporaryDirectory(prefix="isas-filters-") as root:
        both = _contest.judged(
            *(scene, Path(root), settings, contestants, FACTORS, [CHOOSING, *chosen.seeds], None),
            *(measured, MEASURES[0], _FURTHER),
        )
    found = pandas.concat([each.assign(judged=number) for number, each in enumerate(both)])
    return found.rename(columns={"method": "filter"})[[*RUN, *MEASURES, "judged"]]


def against_none(rows: pandas.DataFrame) -> pandas.DataFrame:
    """With each error over that of ``BASE`` at its best factor, of the judged runs."""
    rows = rows.copy()
    plain = rows[(rows["filter"] == BASE) & (rows["judged"] == 1)]
    for name in MEASURES:
        of = plain.set_index("seed")[name]
        judged = rows[name] / rows["seed"].map(of)
        rows[f"{name}_ratio"] = judged.where(rows["judged"] == 1)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(SCENES)}")
    parser.add_argument("--filters", nargs="+", default=FILTERS, choices=FILTERS)
    parser.add_argument("--seeds", nargs="+", type=int, default=[2, 3], help="judged")
    parser.add_argument("--iterations", type=int, default=200)
    parser.add_argument("--batch", type=int, default=16384)
    parser.add_argument("--threads", type=int, default=0)
    chosen = parser.parse_args()
    path = RESULTS / "filters.csv"
    for scene in chosen.scenes or SCENES:
        found = against_none(raced(scene, chosen))
        found = found.sort_values([*RUN[:4], "judged", "factor", "seed"], kind="stable")
        # After each scene: what is measured survives what follows.
        _contest.write(path, found, RUN[:4])
        pages.write()
        means = found[found["judged"] == 1].groupby(RUN[:5])
        print(means[[*MEASURES, *(f"{name}_ratio" for name in MEASURES)]].mean().to_string())


if __name__ == "__main__":
    main()
