"""What leaving out effects saves in time and costs in accuracy: plans race at equal time.

On each scene, with `sampler=progress`: everything (`full`), the plan that is made (`auto`), four
light samples with all depths (`lights`), the same where only the shortest beginning of a path that
meets every unknown is differentiated (`derivative`), this with paths no longer than that until the
last third of the budget (`staged`), and each depth below the scene's own (`depth 2`, …). Each at
its own best rate with the first seed, then with the others, which alone are reported. With
`--plans` those alone and `full`; scenes and plans that are not named keep their rows. Settings and
budgets are those of `reproduce.py`. Writes results/effects.csv (a row per scene and plan),
effects_rates.csv and effects_<scene>.png (error against billed time); where all plans of several
scenes ran, effects_across.csv and effects_arrivals.png.

    .venv/bin/python benchmarks/effects.py pottery bowl
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pages
import pandas
import reproduce
from reproduce import COMMON, MEASURE, RESULTS, SCENES

from isas_cli import records

PLANS = {
    "full": {"effects": "full"},
    "auto": {"effects": "auto"},
    "lights": {"effects": "full", "effects.light_samples": "[4,4]"},
}
# What a plan leaves as it is.
PLAIN = {
    "effects.finish": 0.0,
    "effects.max_depth": None,
    "effects.derivative_depth": None,
    "effects.light_samples": None,
}
MAIN = ("full", "auto")
LADDER = (2, 3, 4, 6, 8)


def plans(scene: str) -> dict[str, dict]:
    """Name → settings. Depths below the scene's own, which its module states."""
    from isas_cli.runtime import backend

    backend.start()
    import importlib

    from isas_cli.config.compose import compose

    cfg = compose([f"scene={SCENES[scene].scene or scene}", "size=tiny"]).scene
    module, _, build = cfg.builder.rpartition(".")
    scenery = getattr(importlib.import_module(module), build)(**cfg.arguments)
    whole = scenery["integrator"]["max_depth"]
    depths = [d for d in LADDER if d < whole]
    # What is too short for an unknown is refused.
    while depths and not _reaches(scene, depths[0]):
        depths.pop(0)
    found = dict(PLANS)
    if depths:
        short = PLANS["lights"] | {"effects.derivative_depth": depths[0]}
        found["derivative"] = short
        found["staged"] = short | {"effects.max_depth": depths[0], "effects.finish": 0.33}
    return found | {f"depth {d}": {"effects": "full", "effects.max_depth": d} for d in depths}


def _reaches(scene: str, depth: int) -> bool:
    """Whether paths of so many edges reach every unknown."""
    command = [sys.executable, "-m", "isas_cli", "effects", f"scene={SCENES[scene].scene or scene}"]
    command += ["size=tiny", "effects=full", f"effects.max_depth={depth}"]
    return subprocess.run(command, capture_output=True).returncode == 0


def race(folder: Path, scene: str, contestants: list[dict], seeds: list[int], seconds: float):
    listed = [",".join(f"{k}:{v}" for k, v in each.items()) for each in contestants]
    command = [sys.executable, "-m", "isas_cli", "race", f"scene={SCENES[scene].scene or scene}"]
    command += [*COMMON, *SCENES[scene].settings, "report=false"]
    command += [f"budget.seconds={seconds}", f"seed=[{','.join(map(str, seeds))}]"]
    command += ["contestants=[" + ",".join(f"{{{each}}}" for each in listed) + "]"]
    subprocess.run([*command, f"hydra.run.dir={folder}"], check=True)


def runs(folder: Path, named: dict[str, dict]) -> pandas.DataFrame:
    """One row per run below ``folder``: its plan's name, rate, seed and history."""
    rows = []
    for path in sorted(folder.rglob("summary.json")):
        run = records.load(path.parent)
        own = run.config["effects"]
        told = {"effects": own["name"]} | {key: own[key.partition(".")[2]] for key in PLAIN}
        plain = PLAIN
        full = {name: plain | settings for name, settings in named.items()}
        (name,) = [n for n, settings in full.items() if _same(settings, told)]
        history = run.history
        rows.append(
            {
                "plan": name,
                "rate": run.config["optimizer"]["lr"],
                "seed": run.config["seed"],
                "folder": path.parent,
                "history": history,
                "final": history[MEASURE].iloc[-1],
                "image": history["image_rmse"].iloc[-1],
                "left_out": run.summary.get("left_out_rmse"),
                "depth": run.manifest["plan"]["max_depth"],
                "derivative": run.manifest["plan"]["derivative_depth"],
                "light_samples": " ".join(map(str, run.manifest["plan"]["light_samples"])),
                "probe": run.manifest["plan"]["probe_seconds"],
            }
        )
    return pandas.DataFrame(rows)


def _same(settings: dict, told: dict) -> bool:
    return all(
        str(settings[key]).replace(" ", "") == str(told[key]).replace(" ", "") for key in told
    )


def table(scene: str, found: pandas.DataFrame, seconds: float) -> pandas.DataFrame:
    rows = []
    goal = found[found["plan"] == "full"]["final"].median()
    for name, own in found.groupby("plan", sort=False):
        row = {"scene": scene, "plan": name, "rate": own["rate"].iloc[0], "seeds": len(own)}
        row |= {"seconds": seconds} | {
            key: own[key].iloc[0] for key in ("depth", "derivative", "light_samples", "probe")
        }
        row |= reproduce._spread("parameter_rmse", own["final"].tolist())
        row |= reproduce._spread("image_rmse", own["image"].tolist())
        row["left_out"] = own["left_out"].median() if own["left_out"].notna().any() else None
        row["iterations"] = np.median([h["iteration"].iloc[-1] for h in own["history"]])
        times = [reproduce.reached(h, goal) / seconds for h in own["history"]]
        row |= reproduce._spread("time_to_full", times)
        rows.append(row)
    return pandas.DataFrame(rows)


def draw(scene: str, found: pandas.DataFrame) -> None:
    figure, ax = plt.subplots(figsize=(6.5, 4), layout="constrained")
    for number, (name, own) in enumerate(found.groupby("plan", sort=False)):
        for history in own["history"]:
            label = name if history is own["history"].iloc[0] else None
            style = "-" if name in MAIN else ":"
            ax.plot(history["seconds"], history[MEASURE], style, color=f"C{number}", label=label)
    ax.set(title=scene, yscale="log", xlabel="billed seconds", ylabel="parameter error")
    ax.legend(fontsize=7)
    figure.savefig(RESULTS / f"effects_{scene}.png", dpi=80)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(SCENES)}")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4])
    parser.add_argument("--plans", nargs="+", help="these alone; `full` is among them")
    chosen = parser.parse_args()
    root = Path(tempfile.mkdtemp(prefix="isas-effects-"))
    print(f"runs: {root}", flush=True)
    judged: list[Path] = []  # below 10 s there is no probe
    for scene in chosen.scenes or SCENES:
        seconds, named = SCENES[scene].seconds, plans(scene)
        if chosen.plans:
            named = {name: named[name] for name in named if name in ("full", *chosen.plans)}
        rates = SCENES[scene].rates
        every = [{**p, "optimizer.lr": rate} for p in named.values() for rate in rates]
        race(root / scene / "rates", scene, every, chosen.seeds[:1], seconds)
        first = runs(root / scene / "rates", named)
        best = first.loc[first.groupby("plan", sort=False)["final"].idxmin()]
        pairs = [{**named[p], "optimizer.lr": r} for p, r in zip(best["plan"], best["rate"])]
        race(root / scene / "seeds", scene, pairs, chosen.seeds[1:], seconds)
        found = runs(root / scene / "seeds", named)
        judged += found[found["plan"].isin(MAIN)]["folder"].tolist() if seconds >= 10 else []
        told = first.drop(columns=["history", "folder"]).assign(scene=scene)
        _merged("effects_rates.csv", told, scene)
        print(_merged("effects.csv", table(scene, found, seconds), scene).to_string(), flush=True)
        draw(scene, found)
        # After each scene: what is measured survives what follows.
        pages.write()
    if len(judged) > 2 * len(chosen.seeds) and not chosen.plans:
        together(judged, root / "together")
        pages.write()


def together(folders: list[Path], output: Path) -> None:
    """Runs of `full` and `auto` on all scenes: effects_across.csv and effects_arrivals.png."""
    command = [sys.executable, "-m", "isas_cli", "compare", *map(str, folders)]
    command += ["--baseline", "progress effects=full", "--output", str(output)]
    subprocess.run(command, check=True)
    shutil.copy(output / "across.csv", RESULTS / "effects_across.csv")
    shutil.copy(output / "plots" / "all_arrivals.png", RESULTS / "effects_arrivals.png")


def _merged(name: str, rows: pandas.DataFrame, scene: str) -> pandas.DataFrame:
    """Write ``rows`` in place of the earlier ones of the scene and these plans. Returns them."""
    path = RESULTS / name
    if path.exists():
        earlier = pandas.read_csv(path)
        same = (earlier["scene"] == scene) & earlier["plan"].isin(rows["plan"])
        # What stays was measured against another `full`.
        earlier.loc[earlier["scene"] == scene, earlier.columns.str.startswith("time")] = np.nan
        whole = pandas.concat([rows, earlier[~same]]).sort_values("scene", kind="stable")
    else:
        whole = rows
    whole.to_csv(path, index=False, float_format="%.4g")
    return rows


if __name__ == "__main__":
    main()
