"""Methods at their own best rates: a race at every factor with the first seed, then each method at
its best with the others."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import matplotlib.pyplot as plt
import pandas


def race(
    scene: str,
    folder: Path,
    settings: list[str],
    contestants: Iterable[dict],
    seeds: list[int],
    seconds: float,
) -> None:
    """`isas race` of ``contestants``, settings by name each, ``seconds`` billed a run."""
    listed = [",".join(f"{k}:{v}" for k, v in each.items()) for each in contestants]
    command = [sys.executable, "-m", "isas_cli", "race", f"scene={scene}", *settings]
    command += [f"budget.seconds={seconds}", f"seed=[{','.join(map(str, seeds))}]"]
    command += ["contestants=[" + ",".join(f"{{{each}}}" for each in listed) + "]"]
    subprocess.run([*command, f"hydra.run.dir={folder}"], check=True)


def judged(
    scene: str,
    root: Path,
    settings: list[str],
    contestants: dict,
    factors: Iterable[float],
    seeds: list[int],
    seconds: float,
    runs: Callable[[Path, str], pandas.DataFrame],
    measure: str,
    by: str = "method",
) -> tuple[pandas.DataFrame, pandas.DataFrame]:
    """The runs of ``contestants``, settings by what they have in the column ``by`` of ``runs``:
    with the first seed at each of the ``factors`` on their rates; with the others, each at that
    with the least ``measure``."""
    every = [m | {"optimizer.factor": f} for m in contestants.values() for f in factors]
    race(scene, root / "rates", settings, every, seeds[:1], seconds)
    first = runs(root / "rates", scene)
    best = first.loc[first.groupby(by, sort=False)[measure].idxmin()]
    pairs = [contestants[k] | {"optimizer.factor": f} for k, f in zip(best[by], best["factor"])]
    race(scene, root / "seeds", settings, pairs, seeds[1:], seconds)
    return first, runs(root / "seeds", scene)


def write(path: Path, rows: pandas.DataFrame) -> None:
    """Rows of some scenes; those of scenes that were not measured now stay."""
    if path.exists():
        before = pandas.read_csv(path)
        rows = pandas.concat([before[~before["scene"].isin(rows["scene"])], rows])
    rows.to_csv(path, index=False, float_format="%.4g")


def draw(
    found: pandas.DataFrame, path: Path, measure: str, label: str, dotted: str | None = None
) -> None:
    """Histories of ``measure`` against billed time, a line a run; dotted those whose method's name
    ends so."""
    figure, ax = plt.subplots(figsize=(6.5, 4), layout="constrained")
    for number, (name, own) in enumerate(found.groupby("method", sort=False)):
        for place, history in enumerate(own["history"]):
            style = ":" if dotted and name.endswith(dotted) else "-"
            shown = {"color": f"C{number}", "label": name if place == 0 else None}
            ax.plot(history["seconds"], history[measure], style, **shown)
    title = found["scene"].iloc[0]
    ax.set(yscale="log", xlabel="billed seconds", ylabel=label, title=title)
    ax.legend(fontsize=8)
    figure.savefig(path, dpi=90)
    plt.close(figure)
