"""Every sampler at its own best learning rate, raced at equal billed time, scene after scene.

A quarter of the default texture and batch, so that short budgets hold hundreds of steps. Two races
a scene: all samplers at every rate with the first seed, then each at its best rate, by the final
parameter error, with the other seeds, which alone are reported.

Writes results/sampler_race_<scene>_*: accuracy_time.csv and errors.png of the comparison at the
best rates, and rates.csv; and results/samplers.csv over all scenes: final errors, and when each
sampler reached the final error of uniform and of relevant.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas

from isas_cli import images, records

HERE = Path(__file__).parent
SAMPLERS = ["uniform", "relevant", "gradient", "ours", "balanced", "progress"]
SECONDS = {"pottery": 20, "jumpydumpy": 20, "dodoco": 10}
MEASURE = "parameter_rmse"
COMMON = ["scene.arguments.texture=128", "estimator.batch=16384", "target.spp=64"]
COMMON += ["frames.views=1", "frames.spp=2", "frames.snapshots=0", "evaluation.pixels=65536"]


def race(folder: Path, scene: str, contestants: list[tuple[str, float]], seeds: list[int]) -> None:
    listed = ",".join(f"{{sampler:{s},optimizer.lr:{rate}}}" for s, rate in contestants)
    command = [sys.executable, "-m", "isas_cli", "race", f"scene={scene}", *COMMON]
    command += [f"contestants=[{listed}]", f"seed=[{','.join(map(str, seeds))}]"]
    command += [f"hydra.run.dir={folder}", f"budget.seconds={SECONDS[scene]}"]
    subprocess.run(command, check=True)


def runs(folder: Path) -> pandas.DataFrame:
    """One row per finished run below ``folder``: what it was, and its history."""
    rows = []
    for path in sorted(folder.rglob("summary.json")):
        run = records.load(path.parent)
        history = run.history[["seconds", MEASURE, "image_rmse", "stage1_seconds", "iteration"]]
        rows.append(
            {
                "sampler": run.config["sampler"]["name"],
                "rate": float(run.config["optimizer"]["lr"]),
                "seed": int(run.config["seed"]),
                "folder": path.parent,
                "history": history,
                "final": float(history[MEASURE].iloc[-1]),
            }
        )
    return pandas.DataFrame(rows)


def worst_twentieth(folder: Path) -> float:
    """Share of a texture's squared error that its worst 5 % of texels hold, of those that the run
    has touched; NaN without a texture."""
    shares = []
    for path in sorted((folder / "frames").glob("truth_*.exr")):
        truth, start, result = (
            images.read(path.with_name(path.name.replace("truth_", f"{name}_", 1)))
            for name in ("truth", "start", "result")
        )
        touched = np.any(result != start, axis=-1)
        error = np.sort(np.mean((result - truth) ** 2, axis=-1)[touched])[::-1]
        shares.append(error[: error.size // 20].sum() / error.sum())
    return float(np.mean(shares)) if shares else float("nan")


def reached(history: pandas.DataFrame, goal: float) -> float:
    """Billed seconds from which on the error stays at or below ``goal``, linear between
    evaluations; infinite if it is not."""
    seconds, error = history["seconds"].to_numpy(), history[MEASURE].to_numpy()
    above = np.flatnonzero(error > goal)
    if above.size == 0:
        return float(seconds[0])
    last = above[-1]
    if last + 1 == error.size:
        return float("inf")
    share = (error[last] - goal) / (error[last] - error[last + 1])
    return float(seconds[last] + share * (seconds[last + 1] - seconds[last]))


def table(scene: str, found: pandas.DataFrame) -> pandas.DataFrame:
    """One row per sampler: medians over seeds, in brackets the seeds' range as low and high."""
    rows, budget = [], SECONDS[scene]
    finals = found.groupby("sampler")["final"].median()
    for sampler in SAMPLERS:
        own = found[found["sampler"] == sampler]
        if own.empty:
            continue
        start = np.median([h[MEASURE].iloc[0] for h in own["history"]])
        row = {"scene": scene, "sampler": sampler, "rate": own["rate"].iloc[0], "seeds": len(own)}
        row |= {"final": own["final"].median(), "low": own["final"].min()}
        row |= {"high": own["final"].max(), "share_of_start": own["final"].median() / start}
        row["image_rmse"] = np.median([h["image_rmse"].iloc[-1] for h in own["history"]])
        row["iterations"] = np.median([h["iteration"].iloc[-1] for h in own["history"]])
        row["stage1_share"] = np.median([h["stage1_seconds"].iloc[-1] for h in own["history"]])
        row["stage1_share"] /= budget
        row["worst_twentieth"] = np.median([worst_twentieth(path) for path in own["folder"]])
        for rival in ("uniform", "relevant"):
            times = [reached(h, finals[rival]) / budget for h in own["history"]]
            row[f"time_to_{rival}"] = np.median(times)
            row[f"time_to_{rival}_low"], row[f"time_to_{rival}_high"] = min(times), max(times)
        rows.append(row)
    return pandas.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=list(SECONDS), choices=list(SECONDS))
    parser.add_argument("--rates", nargs="+", type=float, default=[0.005, 0.01, 0.02])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4])
    parser.add_argument("--folder", type=Path, help="where the runs go (default: a new folder)")
    chosen = parser.parse_args()
    root = chosen.folder or Path(tempfile.mkdtemp(prefix="isas-sampler-race-"))
    results = HERE / "results"
    results.mkdir(exist_ok=True)
    tables = []
    for scene in chosen.scenes:
        grid, rest = root / scene / "rates", root / scene / "seeds"
        pairs = [(sampler, chosen.rates[0]) for sampler in SAMPLERS]
        if len(chosen.rates) > 1:
            every = [(sampler, rate) for rate in chosen.rates for sampler in SAMPLERS]
            race(grid, scene, every, chosen.seeds[:1])
            first = runs(grid)
            best = first.loc[first.groupby("sampler")["final"].idxmin()]
            pairs = list(zip(best["sampler"], best["rate"]))
            first.drop(columns=["folder", "history"]).to_csv(
                results / f"sampler_race_{scene}_rates.csv", index=False, float_format="%.4g"
            )
        race(rest, scene, pairs, chosen.seeds[1:])
        found = runs(rest)
        comparison = root / scene / "comparison"
        folders = [str(path) for path in found["folder"]]
        command = [sys.executable, "-m", "isas_cli", "compare", *folders, "--output", comparison]
        subprocess.run(command, check=True)
        for name in ("accuracy_time.csv", f"plots/{scene}_errors.png"):
            target = name.rpartition("/")[2].removeprefix(f"{scene}_")
            shutil.copy(comparison / name, results / f"sampler_race_{scene}_{target}")
        tables.append(table(scene, found))
        print(tables[-1].to_string(index=False), flush=True)
        # After each scene: what is measured survives what follows.
        pandas.concat(tables).to_csv(results / "samplers.csv", index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
