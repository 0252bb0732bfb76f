"""How to spend a budget: many steps of few paths, or few steps of many; at which rate, falling how.

Everything as `isas run` has it by default (`sampler=progress`, `effects=auto`), but for the budget,
targets of 64 paths a pixel, and what a way sets. On all scenes with an unknown texture; contestants
take turns. Writes results/steps_or_paths.csv (a row per run) and steps_or_paths.png (final
parameter error over that of the default with the same seed, the seeds' geometric mean, a dot per
scene). What is not raced again keeps its rows.

    .venv/bin/python benchmarks/steps_or_paths.py pottery bowl
    .venv/bin/python benchmarks/steps_or_paths.py --ways 0 1 --seeds 2 3
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import _contest
import matplotlib.pyplot as plt
import pages
import pandas
from _page_effects import DEFAULT, SET, by_scene, named
from effects import SCENES
from matplotlib.ticker import NullFormatter

from isas_cli import records

RESULTS = Path(__file__).parent / "results"
SHOWN = (0.5, 2.0)  # of the default's error
# Of the others a number is all that is unknown.
TEXTURES = [scene for scene in SCENES if scene not in ("trashcan", "dodoco")]
# As the columns of `SET`. The first is what others are compared with.
SHARES = (*DEFAULT[:2], "exponential", *DEFAULT[3:])
WAYS = [DEFAULT, SHARES]
WAYS += [
    tuple({**dict(zip(SET, SHARES)), key: value}.values())
    for key, value in (
        ("factor", 0.5),
        ("factor", 2.0),
        ("final", 0.1),
        ("schedule", "cosine"),
        ("batch", DEFAULT[0] // 4),
        ("beta_2", 0.99),
        ("factor", 0.25),
        ("batch", DEFAULT[0] * 4),
    )
]
WAYS += [(*DEFAULT[:4], 20.0, DEFAULT[5])]
SETTINGS = ["evaluation.count=1", *_contest.QUIET, "target.spp=64"]
MEASURES = ["parameter_rmse", "image_rmse"]


def measured(run: records.Run) -> dict:
    last = run.history.iloc[-1]
    found = {"seconds": run.config["budget"]["seconds"], "iterations": int(last["iteration"])}
    found |= {key: run.config["optimizer"][key] for key in SET[1:]}
    found["batch"] = run.config["estimator"]["batch"]
    found["directions"] = run.manifest["plan"]["directions"]
    return found | {name: last[name] for name in MEASURES}


def draw(table: pandas.DataFrame) -> None:
    table = by_scene(table)
    if table.empty:  # nothing to compare with
        return
    budgets = sorted(table["seconds"].unique())
    colours = dict(zip(TEXTURES, plt.get_cmap("tab20").colors))
    plt.rcParams.update({"lines.linewidth": 0.8, "lines.markersize": 3})
    figure, axes = plt.subplots(
        1, len(budgets), figsize=(6 * len(budgets), 3.4), sharey=True, layout="constrained"
    )
    for ax, seconds in zip([axes] if len(budgets) == 1 else axes, budgets):
        for scene, own in table[table["seconds"] == seconds].groupby("scene", sort=False):
            places = [WAYS.index(way) for way in own[SET].itertuples(index=False, name=None)]
            line = zip(*sorted(zip(places, own["share"].clip(*SHOWN))))
            ax.plot(*line, "o", label=scene, color=colours[scene])
        ax.axhline(1, color="0.7", lw=0.8, zorder=0)
        ax.set(title=f"{seconds:g} s", yscale="log")
        labels = [named(way).replace(", ", "\n") for way in WAYS]
        ax.set_xticks(range(len(WAYS)), labels, fontsize=6, rotation=45)
        ax.set_yticks(SHOWN + (1,), [f"{share:g}" for share in SHOWN + (1,)])
        ax.yaxis.set_minor_formatter(NullFormatter())
    known = {}
    for other in figure.axes:
        known |= {label: line for line, label in zip(*other.get_legend_handles_labels())}
    ax.legend(known.values(), known.keys(), fontsize=6, loc="upper left", bbox_to_anchor=(1, 1))
    figure.supylabel("parameter error at the end, over the default's", fontsize=9)
    figure.savefig(RESULTS / "steps_or_paths.png", dpi=90)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(TEXTURES)}")
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--ways", nargs="+", type=int, default=range(len(WAYS)), metavar="N")
    chosen = parser.parse_args()
    path, keys = RESULTS / "steps_or_paths.csv", [f"optimizer.{name}" for name in SET[1:]]
    ways = [dict(zip(["estimator.batch", *keys], WAYS[number])) for number in chosen.ways]
    contestants = [("progress", {"sampler": "progress"} | way) for way in ways]
    run = ["scene", "seconds", *SET, "seed"]
    with tempfile.TemporaryDirectory(prefix="isas-steps-") as root:
        for scene in chosen.scenes or TEXTURES:
            where = scene, Path(root) / scene, SETTINGS, contestants
            found = _contest.race(*where, chosen.seeds, chosen.seconds, measured)
            found = found[[*run, "directions", "iterations", *MEASURES]]
            if path.exists():
                found = pandas.concat([pandas.read_csv(path), found])
                found = found.drop_duplicates(run, keep="last").sort_values(run, kind="stable")
            # After each scene: what is measured survives what follows.
            found.to_csv(path, index=False, float_format="%.4g")
            draw(found)
            pages.write()
            print(found.to_string(), flush=True)


if __name__ == "__main__":
    main()
