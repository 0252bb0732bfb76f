"""Methods at their own best rates: a race at every factor with the first seeds, then each method at
its best with the others."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas
import yaml

from isas_cli import records


def race(
    scene: str,
    folder: Path,
    settings: list[str],
    contestants: list[tuple[str, dict]],
    seeds: list[int],
    seconds: float,
    row: Callable[[records.Run], dict],
) -> pandas.DataFrame:
    """`isas race` of ``contestants``, names with settings, ``seconds`` billed a run. A row a run,
    in their order: what it was, its folder, its history, and what ``row`` tells of it."""
    listed = [",".join(f"{k}:{v}" for k, v in own.items()) for _, own in contestants]
    command = [sys.executable, "-m", "isas_cli", "race", f"scene={scene}", *settings]
    command += [f"budget.seconds={seconds}", f"seed=[{','.join(map(str, seeds))}]"]
    command += ["contestants=[" + ",".join(f"{{{each}}}" for each in listed) + "]"]
    subprocess.run([*command, f"hydra.run.dir={folder}"], check=True)
    planned = yaml.safe_load((folder / "race.yaml").read_text(encoding="utf-8"))["entries"]
    rows = []
    entries = itertools.product(contestants, seeds)
    for ((name, own), seed), entry in zip(entries, planned, strict=True):
        run = records.load(folder / entry["folder"])
        told = {"scene": scene, "method": name, "factor": own["optimizer.factor"], "seed": seed}
        rows.append(told | {"folder": run.folder, "history": run.history} | row(run))
    return pandas.DataFrame(rows)


def judged(
    scene: str,
    root: Path,
    settings: list[str],
    contestants: dict,
    factors: Iterable[float],
    seeds: list[int],
    seconds: float,
    row: Callable[[records.Run], dict],
    measure: str,
    beyond: bool = False,
    choosing: int = 1,
) -> tuple[pandas.DataFrame, pandas.DataFrame]:
    """The runs of ``contestants``, settings by name: with the first seeds, ``choosing`` of them, at
    each of the ``factors`` on their rates (``beyond``: and at one more for those that did best with
    the largest or the least); with the others, each at that with the least geometric mean of
    ``measure``. See ``race``."""
    judges, others = seeds[:choosing], seeds[choosing:]

    def at(name: str, factor: float) -> tuple[str, dict]:
        return name, contestants[name] | {"optimizer.factor": factor}

    def least(runs: pandas.DataFrame) -> pandas.DataFrame:
        # An error of 0 is one that its evaluation could not tell from less than the others.
        told = runs[measure].clip(lower=runs[measure][runs[measure] > 0].min())
        of = runs.assign(logarithm=np.log(told)).groupby(["method", "factor"], sort=False)
        means = of["logarithm"].mean().reset_index()
        return means.loc[means.groupby("method", sort=False)["logarithm"].idxmin()]

    rising = sorted(factors)
    every = [at(name, factor) for name in contestants for factor in rising]
    first = race(scene, root / "rates", settings, every, judges, seconds, row)
    ends = {a: a * a / b for a, b in (rising[:2], rising[:-3:-1])} if beyond else {}
    best = zip(*(least(first)[column] for column in ("method", "factor")))
    if further := [at(name, ends[factor]) for name, factor in best if factor in ends]:
        more = race(scene, root / "beyond", settings, further, judges, seconds, row)
        first = pandas.concat([first, more], ignore_index=True)
    best = least(first)
    chosen = [at(*pair) for pair in zip(best["method"], best["factor"])]
    return first, race(scene, root / "seeds", settings, chosen, others, seconds, row)


def write(
    path: Path, rows: pandas.DataFrame, keys: Sequence[str] = ("scene",), form: str = "%.4g"
) -> None:
    """In the place of earlier rows of the same ``keys``; what was not measured now stays."""
    rows, keys = rows.drop(columns=["history", "folder"], errors="ignore"), list(keys)
    if path.exists():
        before = pandas.read_csv(path)
        own, others = (each[keys].apply(tuple, axis=1) for each in (rows, before))
        rows = pandas.concat([before[~others.isin(own)], rows])
    path.parent.mkdir(exist_ok=True)
    rows.to_csv(path, index=False, float_format=form)


def draw(
    found: pandas.DataFrame,
    path: Path,
    measure: str,
    label: str,
    dotted: str | tuple[str, ...] = (),
) -> None:
    """Histories of ``measure`` against billed time, a line a run; dotted those whose method's name
    ends so, or so."""
    figure, ax = plt.subplots(figsize=(6.5, 4), layout="constrained")
    for number, (name, own) in enumerate(found.groupby("method", sort=False)):
        for place, history in enumerate(own["history"]):
            style = ":" if name.endswith(dotted) else "-"
            shown = {"color": f"C{number}", "label": name if place == 0 else None}
            ax.plot(history["seconds"], history[measure], style, **shown)
    title = found["scene"].iloc[0]
    ax.set(yscale="log", xlabel="billed seconds", ylabel=label, title=title)
    ax.legend(fontsize=8)
    figure.savefig(path, dpi=90)
    plt.close(figure)
