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
import subprocess
import sys
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
SETTINGS = ["evaluation.count=1", "frames.views=0", "frames.snapshots=0", "report=false"]
SETTINGS += ["target.spp=1024", "evaluation.spp=16"]
MEASURES = ["parameter_rmse", "image_rmse"]
RUN = ["scene", "iterations", "batch", "filter", "factor", "seed"]


def raced(
    scene: str, ways: list[tuple[str, float]], seeds: list[int], chosen: argparse.Namespace
) -> pandas.DataFrame:
    """A row for each of ``ways`` (filter, factor) and seeds."""
    contestants = ",".join(
        f"{{sampler:progress,optimizer.filter:{name},optimizer.factor:{factor}}}"
        for name, factor in ways
    )
    rows = []
    with tempfile.TemporaryDirectory(prefix="isas-filters-") as folder:
        command = [sys.executable, "-m", "isas_cli", "race", f"scene={scene}", *SETTINGS]
        sizes = {"views": 8, "resolution": 128, "texture": 128}
        command += [f"scene.arguments.{name}={size}" for name, size in sizes.items()]
        command += [f"contestants=[{contestants}]", f"seed=[{','.join(map(str, seeds))}]"]
        command += [f"estimator.batch={chosen.batch}", f"budget.iterations={chosen.iterations}"]
        command += [f"threads={chosen.threads}", f"hydra.run.dir={folder}/race"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        for path in sorted(Path(folder).rglob("summary.json")):
            run = records.load(path.parent)
            last, optimizer = run.history.iloc[-1], run.config["optimizer"]
            own = scene, int(last["iteration"]), run.config["estimator"]["batch"]
            own += optimizer["filter"]["name"], optimizer["factor"], run.config["seed"]
            rows.append({**dict(zip(RUN, own)), **{name: last[name] for name in MEASURES}})
    return pandas.DataFrame(rows)


def best(rows: pandas.DataFrame) -> dict[str, float]:
    """The factor of least parameter error, by filter."""
    least = rows.loc[rows.groupby("filter")["parameter_rmse"].idxmin()]
    return dict(zip(least["filter"], least["factor"]))


def chose(scene: str, chosen: argparse.Namespace) -> pandas.DataFrame:
    """Runs of the choosing seed, with no filter best at an end of its factors."""
    names = list(dict.fromkeys([BASE, *chosen.filters]))
    rows = raced(scene, [(n, f) for n in names for f in FACTORS], [CHOOSING], chosen)
    while True:
        more = []
        for name, factor in best(rows).items():
            tried = rows.loc[rows["filter"] == name, "factor"]
            if factor == tried.max():
                more.append((name, 2 * factor))
            elif factor == tried.min():
                more.append((name, factor / 2))
        if not more:
            return rows
        rows = pandas.concat([rows, raced(scene, more, [CHOOSING], chosen)], ignore_index=True)


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
        choosing = chose(scene, chosen)
        ways = list(best(choosing).items())
        judged = raced(scene, ways, chosen.seeds, chosen)
        rows = pandas.concat([choosing.assign(judged=0), judged.assign(judged=1)])
        found = against_none(rows)
        found = found.sort_values([*RUN[:4], "judged", "factor", "seed"], kind="stable")
        # After each scene: what is measured survives what follows.
        _contest.write(path, found, RUN[:4])
        pages.write()
        means = found[found["judged"] == 1].groupby(RUN[:5])
        print(means[[*MEASURES, *(f"{name}_ratio" for name in MEASURES)]].mean().to_string())


if __name__ == "__main__":
    main()
