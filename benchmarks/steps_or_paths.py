"""How to spend a budget: many steps of few paths, or few steps of many; and at which rate.

Everything as `isas run` has it by default but for batch and rate: 60 billed seconds,
`sampler=progress`, `effects=auto`. Contestants take turns; one seed. Writes
results/steps_or_paths.csv (a row per run) and steps_or_paths.png (final parameter error against
the batch, over that of the default's batch and rate). Scenes that are not named keep their rows.

    .venv/bin/python benchmarks/steps_or_paths.py pottery bowl
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import pages
import pandas
from _page_effects import DEFAULT

from isas_cli import records

RESULTS = Path(__file__).parent / "results"
BATCHES, RATES = (16384, 65536, 262144), (0.005, 0.01, 0.02)
SETTINGS = ["evaluation.count=24", "frames.views=0", "frames.snapshots=0", "report=false"]


def measured(scene: str, folder: Path) -> pandas.DataFrame:
    listed = ",".join(
        f"{{sampler:progress,estimator.batch:{batch},optimizer.lr:{rate}}}"
        for batch in BATCHES
        for rate in RATES
    )
    command = [sys.executable, "-m", "isas_cli", "race", f"scene={scene}", *SETTINGS, "seed=[1]"]
    command += [f"contestants=[{listed}]", f"hydra.run.dir={folder}"]
    subprocess.run(command, check=True)
    rows = []
    for path in sorted(folder.rglob("summary.json")):
        run = records.load(path.parent)
        last = run.history.iloc[-1]
        rows.append(
            {
                "scene": scene,
                "batch": run.config["estimator"]["batch"],
                "rate": run.config["optimizer"]["lr"],
                "seed": run.config["seed"],
                "iterations": int(last["iteration"]),
                "parameter_rmse": last["parameter_rmse"],
                "image_rmse": last["image_rmse"],
            }
        )
    return pandas.DataFrame(rows).sort_values(["batch", "rate"])


def draw(table: pandas.DataFrame) -> None:
    scenes = list(table["scene"].unique())
    figure, axes = plt.subplots(
        1, len(scenes), figsize=(3.2 * len(scenes), 3), sharey=True, layout="constrained"
    )
    for ax, scene in zip([axes] if len(scenes) == 1 else axes, scenes):
        own = table[table["scene"] == scene]
        usual = own[(own["batch"] == DEFAULT[0]) & (own["rate"] == DEFAULT[1])]["parameter_rmse"]
        for rate, line in own.groupby("rate"):
            share = line["parameter_rmse"] / usual.iloc[0]
            ax.plot(line["batch"], share, "o-", label=f"rate {rate:g}")
        ax.set(title=scene, xscale="log", xlabel="pixels a step")
        ax.set_xticks(BATCHES, [f"{batch // 1024} k" for batch in BATCHES], minor=False)
        ax.minorticks_off()
        ax.axhline(1, color="0.7", lw=0.8, zorder=0)
    ax.legend(fontsize=8)
    figure.supylabel("parameter error at the end, over the default's", fontsize=9)
    figure.savefig(RESULTS / "steps_or_paths.png", dpi=90)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="+")
    chosen = parser.parse_args()
    path = RESULTS / "steps_or_paths.csv"
    with tempfile.TemporaryDirectory(prefix="isas-steps-") as root:
        for scene in chosen.scenes:
            found = measured(scene, Path(root) / scene)
            if path.exists():
                earlier = pandas.read_csv(path)
                found = pandas.concat([earlier[earlier["scene"] != scene], found])
            # After each scene: what is measured survives what follows.
            found.to_csv(path, index=False, float_format="%.4g")
            draw(found)
            pages.write()
            print(found.to_string(), flush=True)


if __name__ == "__main__":
    main()
