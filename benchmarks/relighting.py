"""A jar from photographs (`_photographed_jar.py`): colours, gloss and light unknown; then the views
held out, and the jar under another light.

The default configuration against `sampler=mitsuba`, 40 billed seconds each, three seeds, each side
at the best of three factors on its rates, found with a fourth. Scores as Stanford-ORB has them
(`isas relight`); of the views held out PSNR and SSIM in sRGB. Writes
results/relighting_rates.csv and results/relighting.csv, a row a run, and the page.

    .venv/bin/python benchmarks/relighting.py
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import pages
import pandas

import isas_cli
from isas_cli.cli.app import main as isas

HERE = Path(__file__).parent
RESULTS = HERE / "results"
SECONDS, SEEDS, FACTORS = 40, (1, 2, 3), (1.0, 3.0, 9.0)
WAYS = {"isas": [], "Mitsuba's loop": ["sampler=mitsuba"]}
QUIET = ["frames.views=0", "frames.snapshots=0", "report=false", "evaluation.count=4"]


def measured(folder: Path, way: str, factor: float, seed: int) -> dict:
    """One run, and its scores."""
    run = isas_cli.run(
        *("scene=photos", f"photos.path={folder}", f"photos.mesh={folder / 'jar.obj'}"),
        *("photos.test=5", "photos.roughness=true", "photos.sky=16", "photos.texture=256"),
        *(*QUIET, *WAYS[way], f"optimizer.factor={factor}", f"seed={seed}"),
        *(f"budget.seconds={SECONDS}", f"hydra.run.dir={folder / 'run'}", "overwrite=true"),
    )
    novel = str(folder / "transforms_novel.json")
    words = ["relight", str(folder / "run"), novel, "--light", str(folder / "forest.exr")]
    if isas(words):
        raise SystemExit("isas relight failed")
    scores = json.loads((folder / "run/relit/scores.json").read_text())["mean"]
    (roughness,) = (v for k, v in run.parameters().items() if k.endswith("roughness.value"))
    found = {"way": way, "factor": factor, "seed": seed, "roughness": float(roughness.ravel()[0])}
    found["image_rmse"] = run.history["image_rmse"].iloc[-1]
    held = run.summary["held_out"]["mean"]
    found |= {f"held_{name}": held[name] for name in ("psnr", "ssim", "flip")} | scores
    print(found, flush=True)
    return found


def main() -> None:
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        subprocess.run([sys.executable, HERE / "_photographed_jar.py", folder], check=True)
        rates = pandas.DataFrame(
            [measured(folder, way, factor, 0) for way in WAYS for factor in FACTORS]
        )
        # By the views that are learnt from: those held out are what is reported.
        best = rates.loc[rates.groupby("way", sort=False)["image_rmse"].idxmin()]
        factors = dict(zip(best["way"], best["factor"]))
        found = [measured(folder, way, factors[way], seed) for seed in SEEDS for way in WAYS]
    for name, rows in (("relighting_rates", rates), ("relighting", pandas.DataFrame(found))):
        rows.to_csv(RESULTS / f"{name}.csv", index=False, float_format="%.4g")
    pages.write()


if __name__ == "__main__":
    main()
