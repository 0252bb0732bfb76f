"""Going on with a run: the same bits as without a stop, and one line where that cannot be."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from isas_cli import app, manifest, records

SMALL = [
    *("scene=pottery", "size=tiny", "threads=1", "estimator.batch=2048", "frames.views=1"),
    *("frames.spp=2", "frames.snapshots=2", "evaluation.pixels=512"),
]
# The command with checkpoints every few iterations instead of every few seconds.
PROGRAM = (
    "import sys\n"
    "from isas_cli import app, backend\n"
    "backend.start()\n"
    "from isas_cli import recorder\n"
    "recorder._CHECKPOINT_SECONDS, recorder._CHECKPOINT_SHARE = 0.05, 1.0\n"
    "sys.exit(app.main(sys.argv[1:]))\n"
)


def start(*arguments: str) -> subprocess.Popen:
    command = [sys.executable, "-c", PROGRAM, *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(process: subprocess.Popen) -> str:
    _, errors = process.communicate(timeout=120)
    return errors


def stop_after(folder: Path, rows: int, process: subprocess.Popen, number: int) -> None:
    """Send the signal once the history has so many rows."""
    until = time.monotonic() + 100
    history = folder / "history.csv"
    while not history.exists() or len(history.read_text().splitlines()) <= rows:
        assert time.monotonic() < until and process.poll() is None, finish(process)
        time.sleep(0.01)
    process.send_signal(number)
    finish(process)


@pytest.mark.parametrize("sampler, number", [("ours", signal.SIGKILL), ("balanced", signal.SIGINT)])
def test_a_resumed_run_ends_bit_identical_to_one_that_was_not(tmp_path, sampler, number):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    common = ["run", *SMALL, f"sampler={sampler}", "budget.iterations=300"]
    first = start(*common, f"hydra.run.dir={whole}")
    finish(first)
    assert first.returncode == 0
    broken = start(*common, f"hydra.run.dir={cut}")
    stop_after(cut, 12, broken, number)
    assert broken.returncode == (130 if number == signal.SIGINT else -signal.SIGKILL)
    _, state = records.load_checkpoint(cut)
    assert 0 < state["iteration"] < 300, "stopped in the middle"
    again = start("run", f"resume={cut}")
    errors = finish(again)
    assert again.returncode == 0, errors
    (a, of_whole), (b, of_cut) = records.load_checkpoint(whole), records.load_checkpoint(cut)
    assert a.keys() == b.keys() and any(name.startswith("second/") for name in a)
    for name in a:
        assert np.array_equal(a[name], b[name]), name
    for name in ("iteration", "paths", "evaluations", "touched", "nonfinite", "steps", "scale"):
        assert of_whole[name] == of_cut[name], name
    histories = [records.load(folder).history for folder in (whole, cut)]
    shared = [set(history["iteration"]) for history in histories]
    assert shared[0] <= shared[1] and len(shared[1] - shared[0]) <= 1, "the row of the stop"
    timed = ["seconds", "stage1_seconds"]
    both = [h[h["iteration"].isin(shared[0])].drop(columns=timed) for h in histories]
    assert both[0].reset_index(drop=True).equals(both[1].reset_index(drop=True))
    run = records.load(cut)
    assert run.summary["status"] == "done" and run.summary["iterations"] == 300
    assert run.manifest["resumed"][0]["iteration"] == state["iteration"]
    assert run.history["seconds"].is_monotonic_increasing


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("finished") / "run"
    settings = ["scene=dodoco", "size=tiny", "estimator.batch=512", "frames.views=0"]
    settings += ["evaluation.pixels=64", "budget.iterations=4", f"hydra.run.dir={folder}"]
    assert app.main(["run", *settings]) == 0
    return folder


def refused(capsys, *arguments: str) -> str:
    capsys.readouterr()
    assert app.main(["run", *arguments]) == 2
    error = capsys.readouterr().err.strip()
    assert "\n" not in error and error.startswith("isas: ")
    return error


def test_what_cannot_be_continued_is_one_line(finished, capsys, tmp_path):
    assert "no such run folder" in refused(capsys, f"resume={tmp_path / 'none'}")
    assert "holds no run" in refused(capsys, f"resume={tmp_path}")
    assert "resume is empty" in refused(capsys, "resume=")
    spent = refused(capsys, f"resume={finished}")
    assert "iterations=4" in spent and "spent" in spent and "larger" in spent
    changed = refused(capsys, f"resume={finished}", "optimizer.lr=0.1")
    assert "optimizer.lr=0.1" in changed and "budget.seconds" in changed
    assert "one folder" in refused(capsys, f"resume={finished}", f"resume={finished}")
    assert "above 0" in refused(capsys, f"resume={finished}", "budget.iterations=-1")


def test_a_larger_budget_goes_on_where_the_run_ended(finished, capsys):
    before = records.load(finished)
    spent = before.summary["seconds_billed"]
    assert app.main(["run", f"resume={finished}", "budget.iterations=9"]) == 0
    after = records.load(finished)
    assert after.config["budget"]["iterations"] == 9, "a second continuation goes on from here"
    assert after.summary["iterations"] == 9 and after.summary["seconds_billed"] > spent
    assert after.history["iteration"].tolist()[: len(before.history)] == (
        before.history["iteration"].tolist()
    )
    assert after.summary["start"] == before.summary["start"]


def test_a_changed_scene_and_a_living_process_are_refused(finished, capsys):
    path = finished / "manifest.json"
    text = path.read_text()
    content = json.loads(text)
    try:
        path.write_text(json.dumps({**content, "resumed": [], "scene_hash": "0" * 32}))
        error = refused(capsys, f"resume={finished}", "budget.iterations=50")
        assert "scene has changed" in error and "new run" in error
        other = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
        alive = {**content, "resumed": [], **manifest.process(), "pid": other.pid}
        path.write_text(json.dumps(alive))
        assert "still being written" in refused(capsys, f"resume={finished}")
        other.kill()
        other.wait()
        assert "spent" in refused(capsys, f"resume={finished}"), "its process has gone"
    finally:
        path.write_text(text)


def test_a_process_number_that_went_to_another_does_not_count():
    """The process with that number began after the run that noted it."""
    noted = {**manifest.process(), "pid": os.getppid(), "started": "2001-01-01T00:00:00+00:00"}
    assert not manifest.alive(noted)
    assert manifest.alive({**noted, **manifest.process(), "pid": os.getppid()})
    assert not manifest.alive({**manifest.process(), "host": "elsewhere", "pid": os.getppid()})
