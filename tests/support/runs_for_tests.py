"""Runs: made by the command, or as files tell of them, written by no renderer."""

from __future__ import annotations

import datetime
import os
import platform
import subprocess
import sys
from pathlib import Path

from isas_cli import records
from isas_cli.cli.app import main
from isas_cli.records import follow

QUIET = ["frames.views=0", "frames.snapshots=0", "report=false"]
ERRORS = [1.0, 0.5, 0.25, 0.1]  # of the start; billed time doubles from row to row


def ran(folder: Path, *settings: str) -> records.Run:
    """Of `isas run` with these settings, which ends well."""
    assert main(["run", *settings, f"hydra.run.dir={folder}"]) == 0
    return records.load(folder)


def resumed(folder: Path, *settings: str) -> records.Run:
    assert main(["run", f"resume={folder}", *settings]) == 0
    return records.load(folder)


def process(pid: int | None = None, **changed) -> dict:
    """A manifest's entry on the process that writes; this one unless said otherwise."""
    now = datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds")
    of_this = {"pid": pid or os.getpid(), "host": platform.node(), "started": now}
    return {**of_this, **changed}


def gone() -> int:
    """The number of a process that has ended."""
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    return ended.pid


def begin(folder: Path, manifest: dict | None = None, sampler: str = "ours") -> records.RunWriter:
    writer = records.RunWriter(folder)
    names = f"scene: {{name: pottery}}\nsampler: {{name: {sampler}}}\nloss: {{name: l2}}\n"
    writer.config(names + "seed: 3\nbudget: {seconds: 16, iterations: null, paths: null}\n")
    writer.manifest(process() if manifest is None else manifest)
    return writer


def row(number: int, **changed) -> dict:
    """The history's row of that number: 2 M paths a second, from error 0.2 or 0.4 downwards."""
    seconds = float(2**number) if number else 0.0
    error = ERRORS[number]
    known = {"image_rmse": 0.2 * error, "parameter_rmse": 0.4 * error, "nonfinite": 0}
    counted = {"iteration": 10 * number, "paths": int(2e6 * seconds)}
    return {"seconds": seconds, "loss": error**2, **known, **counted, **changed}


def run(folder: Path, rows: int = 4, manifest: dict | None = None, **summary):
    writer = begin(folder, manifest)
    for number in range(rows):
        writer.evaluation(row(number))
    if summary:
        writer.summary(summary)
    return writer


def followed(folder: Path) -> follow.Follower:
    follower = follow.Follower(folder)
    follower.update()
    return follower
