"""How much sooner today's default is where that of an earlier commit ended, from two checkouts.

On scenes with an unknown texture, `isas run` as each version has it by default, with the same
targets, in turn, a process each. Writes results/sooner.csv, a row for each scene and seed: final
errors, and `share`, that of the budget at which today's parameter error was for good at or below
the earlier one's last, infinite where it never was. The goal of the median is 0.5. sooner.png: the
first seed's parameter errors against time, once the runs of all scenes are in runs/sooner.

    .venv/bin/python benchmarks/sooner.py [SCENE …] [--commit 4bc2580] [--seeds 1 2 3]

The earlier version is checked out and installed beside the runs, in runs/sooner.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
from pathlib import Path

import _contest
import matplotlib.pyplot as plt
import pages
import pandas
from matplotlib.ticker import NullFormatter
from reproduce import RESULTS
from steps_or_paths import TEXTURES

HERE, ROOT = Path(__file__).parent, Path("runs/sooner")
SETTINGS = ["evaluation.count=12", *_contest.QUIET]
MEASURES = ("parameter_rmse", "image_rmse")


def earlier(commit: str) -> Path:
    """A checkout of ``commit`` with an environment of its own."""
    folder = (ROOT / commit).resolve()
    if not (folder / ".venv/bin/isas").exists():
        if not folder.exists():
            subprocess.run(["git", "worktree", "add", "--detach", folder, commit], check=True)
        subprocess.run(["make", "setup"], cwd=folder, check=True)
    return folder


def run(where: Path, targets: Path, folder: Path, arguments: list[str]) -> pandas.DataFrame:
    """The history of a run, from the checkout ``where``."""
    command = [where / ".venv/bin/python", HERE.resolve() / "_given_targets.py"]
    command += [targets.resolve(), "run", *SETTINGS, *arguments]
    command += [f"hydra.run.dir={folder.resolve()}"]
    path = {**os.environ, "PYTHONPATH": str(where)}
    subprocess.run(command, check=True, cwd=where, env=path, stdout=subprocess.DEVNULL)
    return pandas.read_csv(folder / "history.csv")


def measured(scene: str, seed: int, old: Path, chosen: argparse.Namespace) -> dict:
    targets = ROOT / f"{scene}.npz"
    arguments = [f"scene={scene}", f"seed={seed}", f"budget.seconds={chosen.seconds}"]
    found = {}
    for side, where in (("now", HERE.parent.resolve()), ("then", old)):
        folder = ROOT / f"{scene}-{seed}-{side}"
        shutil.rmtree(folder, ignore_errors=True)
        found[side] = run(where, targets, folder, arguments)
    row = {"scene": scene, "seed": seed, "seconds": chosen.seconds, "commit": chosen.commit}
    for measure in MEASURES:
        goal = found["then"][measure].iloc[-1]
        row |= {f"{measure}_then": goal, measure: found["now"][measure].iloc[-1]}
        row[f"{measure}_share"] = _contest.reached(found["now"], goal, measure) / chosen.seconds
    return row | {f"iterations_{s}": int(h["iteration"].iloc[-1]) for s, h in found.items()}


def draw(path: Path, seed: int) -> None:
    """A small plot for each scene."""
    if not all((ROOT / f"{s}-{seed}-then" / "history.csv").exists() for s in TEXTURES):
        return
    figure, axes = plt.subplots(3, 3, figsize=(9, 6), layout="constrained", sharex=True)
    for ax, scene in zip(axes.flat, TEXTURES):
        for side, label, colour in (
            ("then", "every texel by itself", "0.6"),
            ("now", "all resolutions at once", "C3"),
        ):
            history = pandas.read_csv(ROOT / f"{scene}-{seed}-{side}" / "history.csv")
            ax.plot(history["seconds"], history["parameter_rmse"], color=colour, label=label)
        end = history["parameter_rmse"].iloc[-1]
        ax.set(title=scene, yscale="log", ylim=(0.8 * end, None))
        ax.yaxis.set_minor_formatter(NullFormatter())
    figure.supxlabel("billed seconds")
    figure.supylabel("error of the texture")
    axes.flat[0].legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=100)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE")
    parser.add_argument("--commit", default="4bc2580")
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    chosen = parser.parse_args()
    ROOT.mkdir(parents=True, exist_ok=True)
    old, path = earlier(chosen.commit), RESULTS / "sooner.csv"
    for seed in chosen.seeds:
        for scene in chosen.scenes or TEXTURES:
            row = pandas.DataFrame([measured(scene, seed, old, chosen)])
            _contest.write(path, row, ("scene", "seed"))
            print(row.to_string(index=False), flush=True)
    draw(RESULTS / "sooner.png", chosen.seeds[0])
    pages.write()
    known = pandas.read_csv(path)
    medians = known.groupby("scene")[[f"{name}_share" for name in MEASURES]].median()
    print(medians.to_string(), "median over scenes", medians.median().to_string(), sep="\n")


if __name__ == "__main__":
    main()
