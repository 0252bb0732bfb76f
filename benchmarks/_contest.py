"""Methods at their own best rates: a race at every factor with the first seeds, then each method at
its best with the others."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas
import yaml

from isas_cli import records
from isas_cli.runtime.errors import NumericalError

# No pictures, no report.
QUIET = ["frames.views=0", "frames.snapshots=0", "report=false"]


def race(
    scene: str,
    folder: Path,
    settings: list[str],
    contestants: list[tuple[str, dict]],
    seeds: list[int],
    seconds: float | None,
    row: Callable[[records.Run], dict],
) -> pandas.DataFrame:
    """`isas race` of ``contestants``, names with settings, ``seconds`` billed a run (None: the
    ``settings`` say when a run ends). A row a run, in their order: what it was, its folder, its
    history, and what ``row`` tells of it (``counted``)."""
    listed = [",".join(f"{k}:{v}" for k, v in own.items()) for _, own in contestants]
    command = [sys.executable, "-m", "isas_cli", "race", f"scene={scene}", *settings]
    command += [f"budget.seconds={seconds}"] if seconds else []
    command += [f"seed=[{','.join(map(str, seeds))}]"]
    command += ["contestants=[" + ",".join(f"{{{each}}}" for each in listed) + "]"]
    ended = subprocess.run([*command, f"hydra.run.dir={folder}"])
    if ended.returncode != NumericalError.status:  # one that failed so; the others went on
        ended.check_returncode()
    planned = yaml.safe_load((folder / "race.yaml").read_text(encoding="utf-8"))["entries"]
    rows = []
    entries = itertools.product(contestants, seeds)
    for ((name, own), seed), entry in zip(entries, planned, strict=True):
        run = counted(records.load(folder / entry["folder"]))
        what = {"scene": scene, "method": name, "factor": own.get("optimizer.factor"), "seed": seed}
        rows.append(what | {"folder": run.folder, "history": run.history} | row(run))
    return pandas.DataFrame(rows)


def counted(run: records.Run) -> records.Run:
    """``run``, with infinite errors at its end where it failed: what it had before is no result."""
    if run.summary["status"] == "done":
        return run
    history = run.history.copy()
    errors = [name for name in history if name.startswith(("loss", "image_", "parameter_"))]
    history.loc[history.index[-1], errors] = np.inf
    return replace(run, history=history)


def judged(
    scene: str,
    root: Path,
    settings: list[str],
    contestants: dict,
    factors: Iterable[float],
    seeds: list[int],
    seconds: float | None,
    row: Callable[[records.Run], dict],
    measure: str,
    beyond: int = 0,
    choosing: int = 1,
) -> tuple[pandas.DataFrame, pandas.DataFrame]:
    """The runs of ``contestants``, settings by name: with the first seeds, ``choosing`` of them, at
    each of the ``factors`` on their rates (and, ``beyond`` so many times at most, at one more for
    those that did best with the largest or the least); with the others, each at that with the least
    geometric mean of ``measure``. See ``race``."""
    judges, others = seeds[:choosing], seeds[choosing:]

    def raced(where: str, pairs: Iterable[tuple[str, float]], seeds: list[int]) -> pandas.DataFrame:
        each = [(name, contestants[name] | {"optimizer.factor": factor}) for name, factor in pairs]
        return race(scene, root / where, settings, each, seeds, seconds, row)

    first = raced("rates", itertools.product(contestants, sorted(factors)), judges)
    for number in range(beyond):
        if not (beside := further(first, measure)):
            break
        more = raced(f"beyond-{number}", beside, judges)
        first = pandas.concat([first, more], ignore_index=True)
    return first, raced("seeds", best(first, measure), others)


def best(
    runs: pandas.DataFrame, measure: str, by: str = "method", of: str = "factor"
) -> list[tuple[str, float]]:
    """Each of ``by`` with that ``of`` its own which has the least geometric mean of ``measure``."""
    # An error of 0 is one that its evaluation could not tell from less than the others.
    told = runs[measure].clip(lower=runs[measure][runs[measure] > 0].min())
    means = np.log(told).groupby([runs[by], runs[of]], sort=False).mean()
    return list(means.groupby(level=by, sort=False).idxmin())


def further(
    runs: pandas.DataFrame, measure: str, by: str = "method", of: str = "factor"
) -> list[tuple[str, float]]:
    """Those whose ``best`` lies at an end of what they have tried, each with the next beyond it."""
    found = []
    for name, value in best(runs, measure, by, of):
        tried = sorted(set(runs.loc[runs[by] == name, of]))
        ends = {a: a * a / b for a, b in (tried[:2], tried[:-3:-1])}
        found += [(name, ends[value])] if value in ends else []
    return found


def reached(history: pandas.DataFrame, goal: float, measure: str = "parameter_rmse") -> float:
    """Billed seconds from which on the error stays at or below ``goal``, linear between
    evaluations; infinite if it is not, or if the ``goal`` is that of what failed."""
    if np.isinf(goal):
        return float("inf")
    seconds, error = history["seconds"].to_numpy(), history[measure].to_numpy()
    above = np.flatnonzero(error > goal)
    if above.size == 0:
        return float(seconds[0])
    last = above[-1]
    if last + 1 == error.size:
        return float("inf")
    share = (error[last] - goal) / (error[last] - error[last + 1])
    return float(seconds[last] + share * (seconds[last + 1] - seconds[last]))


def ranged(*names: str) -> list[str]:
    """Of each the column of its median and those of its range."""
    return [name + end for name in names for end in ("", "_low", "_high")]


def told(
    found: pandas.DataFrame,
    seconds: float,
    columns: Iterable[str],
    measure: str = "parameter_rmse",
    rivals: dict[str, str] | None = None,
    same: Sequence[str] = ("scene", "method", "factor"),
    by: str = "method",
) -> pandas.DataFrame:
    """A row for each method of a race: what its first run has of the ``same``, and the median over
    its runs of each of the ``columns``, least or most where a name ends so (``ranged``: of three
    seeds, the range holds the median in 75 % of cases). ``rivals``: methods by the column that says
    after which share of the budget their median final ``measure`` is reached."""
    for column, rival in (rivals or {}).items():
        finals = found["history"].map(lambda history: history[measure].iloc[-1])
        goal = finals.groupby(found[by]).median()[rival]
        times = [reached(history, goal, measure) / seconds for history in found["history"]]
        found = found.assign(**{column: times})
    ends, rows = {"low": "min", "high": "max"}, []
    for _, own in found.groupby(by, sort=False):
        row = {name: own[name].iloc[0] for name in same}
        row |= {"seeds": len(own), "seconds": seconds}
        for column in columns:
            name, _, end = column.rpartition("_")
            row[column] = own[name].agg(ends[end]) if end in ends else own[column].dropna().median()
        rows.append(row)
    return pandas.DataFrame(rows)


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
