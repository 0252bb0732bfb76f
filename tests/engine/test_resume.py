"""Going on with a run: the same bits as without a stop, and one line where that cannot be."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from processes import begun, isas
from runs_for_tests import process, ran, resumed
from scenes_for_tests import ROUGHNESS, problem

import isas_cli
from isas_cli import records
from isas_cli.cli import app, landscape, one
from isas_cli.engine import experiment, race, resumption
from isas_cli.engine.recorder import Recorder
from isas_cli.records import manifest
from isas_cli.rendering import targets
from isas_cli.runtime.errors import InputError

TINY = [
    *("size=tiny", "threads=1", "estimator.batch=2048", "frames.views=1"),
    *("frames.spp=2", "frames.snapshots=2", "evaluation.pixels=512"),
]
SMALL = ["scene=pottery", *TINY]
DODOCO = [
    *("scene=dodoco", "size=tiny", "estimator.batch=512", "frames.views=0"),
    *("evaluation.pixels=64", "sampler=uniform", "effects=full"),
]
# The command with checkpoints every few iterations instead of every few seconds.
OFTEN = [
    *(sys.executable, "-c"),
    "import sys\n"
    "from isas_cli.cli import app\n"
    "from isas_cli.runtime import backend\n"
    "backend.start()\n"
    "from isas_cli.engine import recorder\n"
    "recorder._CHECKPOINT_SECONDS, recorder._CHECKPOINT_SHARE = 0.05, 1.0\n"
    "sys.exit(app.main(sys.argv[1:]))\n",
]


@pytest.mark.parametrize(
    "chosen, number",
    [
        pytest.param(["scene=pottery", "sampler=ours"], signal.SIGKILL, marks=pytest.mark.slow),
        # From one level of resolution to the next on the way.
        (["scene=lego", "sampler=progress"], signal.SIGKILL),
        pytest.param(
            ["scene=pottery", "sampler=multiresolution", "sampler.base=gradient"],
            signal.SIGINT,
            marks=pytest.mark.slow,
        ),
        pytest.param(
            ["scene=occlusion", "sampler=plateau", "sampler.base=differences"],
            signal.SIGKILL,
            marks=pytest.mark.slow,
        ),
        pytest.param(
            ["scene=kirby", "estimator=silhouettes", "sampler=uniform"],
            signal.SIGKILL,
            marks=pytest.mark.slow,
        ),
        pytest.param(["scene=smoke", "sampler=ours"], signal.SIGKILL, marks=pytest.mark.slow),
        pytest.param(
            ["scene=dodoco_a", "optimizer.filter=james_stein"],
            signal.SIGKILL,
            marks=pytest.mark.slow,
        ),
    ],
    ids=("ours", "levels", "multiresolution", "plateau", "silhouettes", "volume", "filter"),
)
def test_a_resumed_run_ends_bit_identical_to_one_that_was_not(
    tmp_path, chosen, number, fixed_order
):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    common = ["run", *chosen, *TINY, "budget.iterations=200", "report=false"]
    assert isas(tmp_path, *common, f"hydra.run.dir={whole}", by=OFTEN).returncode == 0
    broken, _ = begun(tmp_path, *common, f"hydra.run.dir={cut}", rows=10, below="cut", by=OFTEN)
    broken.send_signal(number)
    broken.communicate(timeout=120)
    assert broken.returncode == (130 if number == signal.SIGINT else -signal.SIGKILL)
    _, state = records.load_checkpoint(cut)
    assert 0 < state["iteration"] < 200, "stopped in the middle"
    rows = (cut / "history.csv").read_text()
    assert app.main(["run", f"resume={cut}", "budget.iterations=1"]) == 2
    assert (cut / "history.csv").read_text() == rows, "a smaller budget costs no row"
    again = isas(tmp_path, "run", f"resume={cut}", by=OFTEN)
    assert again.returncode == 0, again.stderr
    (a, of_whole), (b, of_cut) = records.load_checkpoint(whole), records.load_checkpoint(cut)
    assert a.keys() == b.keys() and any(name.startswith("second/") for name in a)
    for name in a:
        assert np.array_equal(a[name], b[name]), name
    counted = "iteration", "paths", "touched", "nonfinite", "steps", "all_steps"
    for name in (*counted, "level", "scales"):
        assert of_whole[name] == of_cut[name], name
    histories = [records.load(folder).history for folder in (whole, cut)]
    shared = [set(history["iteration"]) for history in histories]
    assert shared[0] <= shared[1] and len(shared[1] - shared[0]) <= 1, "the row of the stop"
    timed = ["seconds", "stage1_seconds"]
    both = [h[h["iteration"].isin(shared[0])].drop(columns=timed) for h in histories]
    assert both[0].reset_index(drop=True).equals(both[1].reset_index(drop=True))
    run = records.load(cut)
    assert run.summary["status"] == "done" and run.summary["iterations"] == 200
    assert run.manifest["resumed"][0]["iteration"] == state["iteration"]
    assert run.history["seconds"].is_monotonic_increasing


def written(folder: Path) -> Path:
    """Pages have tests of their own."""
    (folder / "report.html").touch()
    return folder / "report.html"


@pytest.fixture
def no_page(monkeypatch):
    monkeypatch.setattr("isas_cli.report.write", written)


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("finished") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("isas_cli.report.write", written)
        ran(folder, *DODOCO, "budget.iterations=4", "optimizer.schedule=exponential")
    return folder


def test_what_cannot_be_continued_is_one_line(finished, refused, tmp_path):
    assert "no such run folder" in refused(["run", f"resume={tmp_path / 'none'}"])
    assert "holds no run" in refused(["run", f"resume={tmp_path}"])
    assert "resume is empty" in refused(["run", "resume="])
    spent = refused(["run", f"resume={finished}"])
    assert "iterations=4" in spent and "spent" in spent and "budget.iterations=8" in spent
    assert "one value" in refused(["run", f"resume={finished}", "~budget.iterations"])
    assert "one value" in refused(["run", f"resume={finished}", "budget.iterations=8,9"])
    wrong = refused(["run", f"resume={finished}", "budget.seconds=abc"])
    assert wrong.startswith("isas: budget.seconds=abc: ") and "config.yaml" not in wrong
    changed = refused(["run", f"resume={finished}", "optimizer.lr=0.1"])
    assert "optimizer.lr=0.1" in changed and "budget.seconds" in changed
    assert "one folder" in refused(["run", f"resume={finished}", f"resume={finished}"])
    assert "above 0" in refused(["run", f"resume={finished}", "budget.iterations=-1"])


def test_a_recorded_configuration_of_no_run_is_one_line():
    deep: dict = {}
    for _ in range(500):
        deep = {"a": deep}
    for config in ({"budget": {"seconds": 10**400}}, {"scene": {"arguments": deep}}):
        run = SimpleNamespace(config=config, manifest={})
        with pytest.raises(InputError, match="config.yaml does not give a run: ") as error:
            resumption.configuration(Path("run"), run, {})
        assert "\n" not in str(error.value)


def test_a_larger_budget_goes_on_where_the_run_ended(finished, no_page):
    before = records.load(finished)
    spent = before.summary["seconds_billed"]
    after = resumed(finished, "budget.iterations=9")
    assert after.config["budget"]["iterations"] == 9, "a second continuation goes on from here"
    assert after.summary["iterations"] == 9 and after.summary["seconds_billed"] > spent
    assert after.history["iteration"].tolist()[: len(before.history)] == (
        before.history["iteration"].tolist()
    )
    assert after.summary["start"] == before.summary["start"]
    between = after.history["iteration"].between(5, 8)
    assert between.any(), "evaluated on the way, not only at the end"
    (warning,) = [text for text in after.summary["warnings"] if "iterations=4" in text]
    assert "the learning rate followed another schedule" in warning
    assert after.manifest["resumed"][0]["earlier_budget"] == "iterations=4"


def test_a_run_goes_on_by_the_plan_that_it_began_with(tmp_path, monkeypatch, capsys):
    """Also in a race. A probe might find another one now."""
    ran(tmp_path, *DODOCO, "scene.arguments.views=3", "report=false", "budget.iterations=2")
    content = json.loads((tmp_path / "manifest.json").read_text())
    content["plan"] |= {"views": [0, 2], "light_samples": [4, 4]}
    (tmp_path / "manifest.json").write_text(json.dumps(content))
    plans, reopen = [], Recorder.reopen
    monkeypatch.setattr(
        Recorder, "reopen", lambda self, *more: plans.append(self.loop.plan) or reopen(self, *more)
    )
    resumed(tmp_path, "budget.iterations=4")
    assert "views: 2 of 3" in capsys.readouterr().err
    entry = race.continued("again", tmp_path, {"budget.iterations": 6})
    assert race.run([entry], 1.0, lambda: None) == 0
    assert [(each.views, each.paths.lights) for each in plans] == [((0, 2), (4, 4))] * 2


def test_other_versions_than_a_run_began_with_are_told(finished, no_page, tmp_path, monkeypatch):
    monkeypatch.delenv("ISAS_ALLOW")
    folder = tmp_path / "copy"
    shutil.copytree(finished, folder)
    content = json.loads((folder / "manifest.json").read_text())
    begun = content | {"resumed": [], "guests": {"example": "0.1"}, "isas": "0.0.9"}
    (folder / "manifest.json").write_text(json.dumps(begun))
    warnings = resumed(folder, "budget.iterations=30").summary["warnings"]
    told = f"on with example – (before 0.1), isas {isas_cli.__version__} (before 0.0.9)"
    assert any(told in each for each in warnings)


def test_a_program_goes_on_with_a_run(finished, no_page, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(finished, folder)
    after = isas_cli.run(f"resume={folder}", "budget.iterations=40")
    assert after.folder == folder and after.summary["iterations"] == 40
    with pytest.raises(InputError, match="-m: a program makes one run at a time"):
        isas_cli.run("-m", *DODOCO)


def test_what_was_made_of_an_earlier_end_is_told_and_its_error_goes(finished, no_page, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(finished, folder)
    (folder / "error.txt").write_text("of an earlier attempt")
    (folder / "result").mkdir()
    (folder / "result/scene.xml").touch()
    notes = resumed(folder, "budget.iterations=20").summary["notes"]
    assert not (folder / "error.txt").exists()
    assert "made before this run went on, and not anew: result/scene.xml" in notes


def test_a_result_is_put_into_a_scene_that_has_changed_with_a_word(finished, tmp_path, capsys):
    folder = tmp_path / "copy"
    shutil.copytree(finished, folder)
    assert app.main(["export", str(folder)]) == 0
    assert "warning" not in capsys.readouterr().err
    content = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(content | {"scene_hash": "0" * 32}))
    assert app.main(["export", str(folder)]) == 0
    assert f"warning: {folder}: its scene has changed since the run" in capsys.readouterr().err


def test_a_run_goes_on_by_the_variant_that_it_took_by_itself(finished):
    """Also where a card works by now."""
    run = records.load(finished)
    assert run.config["variant"] == "auto"
    cfg, _ = resumption.configuration(finished, run, {})
    took = run.manifest["variant"]
    assert cfg.variant == (took if took.startswith("llvm") else "auto")
    other = dataclasses.replace(run, manifest=run.manifest | {"variant": "cuda_ad_rgb"})
    assert resumption.configuration(finished, other, {})[0].variant == "auto"


@pytest.mark.parametrize("found, taken", [("cuda_ad_rgb", "auto"), ("llvm_ad_rgb", "llvm_ad_rgb")])
def test_what_goes_by_the_result_alone_needs_no_card(finished, monkeypatch, found, taken):
    """`isas export`, `isas relight` and `isas landscape`."""
    run = records.load(finished)
    there = dataclasses.replace(run, config=run.config | {"variant": found})
    monkeypatch.setattr(records, "load", lambda folder: there)
    assert resumption.result(finished)[0].variant == taken

    def started(cfgs, typed):
        raise InputError(f"by {typed.variant}")

    monkeypatch.setattr(experiment, "started", started)
    monkeypatch.setattr(landscape, "_chosen", lambda *_: ["a"])
    with pytest.raises(InputError, match=f"by {taken}"):
        landscape.main(finished)


def test_a_folder_that_cannot_be_written_is_refused_before_anything_is_done(
    finished, refused, monkeypatch
):
    def readonly(dir):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(one, "tempfile", SimpleNamespace(TemporaryFile=readonly))
    told = refused(["run", f"resume={finished}", "budget.iterations=90"])
    assert f"cannot write to the output folder {finished}: Read-only file system; a run" in told


def test_a_larger_budget_warns_of_widths_of_blurs_too(tmp_path):
    settings = ["scene=shadows", "size=tiny", "estimator.batch=512", "estimator.spp=2"]
    ran(tmp_path, *settings, "frames.views=0", "report=false", "budget.iterations=2")
    warnings = resumed(tmp_path, "budget.iterations=4").summary["warnings"]
    (warning,) = [w for w in warnings if "iterations=2" in w]
    assert "the learning rate and the blurs' widths followed another schedule" in warning


def test_where_rates_fall_by_steps_a_larger_budget_changes_nothing_before(tmp_path):
    ran(tmp_path / "in two", *DODOCO, "report=false", "budget.iterations=4")
    in_two = resumed(tmp_path / "in two", "budget.iterations=9")
    at_once = ran(tmp_path / "at once", *DODOCO, "report=false", "budget.iterations=9")
    for run in (in_two, at_once):
        assert not [text for text in run.summary["warnings"] if "schedule" in text]
    ends = [run.summary["final"]["parameter_rmse"] for run in (in_two, at_once)]
    assert ends[0] == pytest.approx(ends[1], rel=1e-4)


def test_a_run_killed_while_its_pictures_were_made_is_completed(finished, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(finished, folder)
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps({**summary, "complete": False}))
    (folder / "report.html").unlink()
    after = resumed(folder)
    assert after.complete and (folder / "report.html").is_file()
    assert after.summary["iterations"] == summary["iterations"]
    (folder / "summary.json").unlink()
    assert resumed(folder).complete


def test_two_processes_cannot_write_one_record(finished):
    hold = (
        "import sys\n"
        "from pathlib import Path\n"
        "from isas_cli.records import RunWriter\n"
        "writer = RunWriter.reopen(Path(sys.argv[1]), 10**6)\n"
        "print('held', flush=True)\n"
        "input()\n"
    )
    command = [sys.executable, "-c", hold, str(finished)]
    text = (finished / "summary.json").read_text()
    other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert other.stdout.readline() == "held\n"
        for begin in (
            lambda: records.RunWriter(finished, overwrite=True),
            lambda: records.RunWriter.reopen(finished, 0),
        ):
            with pytest.raises(InputError, match="still being written"):
                begin()
        assert (finished / "history.csv").exists(), "nothing was removed"
    finally:
        other.communicate("\n")
        (finished / "summary.json").write_text(text)
    records.RunWriter.reopen(finished, 10**6)
    (finished / "summary.json").write_text(text)


def test_without_its_history_a_run_does_not_go_on(finished, refused, tmp_path_factory):
    """What it had found would be taken for its start."""
    folder = tmp_path_factory.mktemp("copy") / "run"
    shutil.copytree(finished, folder)
    path = folder / "history.csv"
    columns, *_ = path.read_text().splitlines(keepends=True)
    path.write_text(columns)
    told = refused(["run", f"resume={folder}", "budget.iterations=90"])
    assert f"{folder}: its history.csv is gone, or has no rows" in told
    path.unlink()
    assert refused(["run", f"resume={folder}", "budget.iterations=90"]) == told
    assert not path.exists()


def test_a_changed_scene_and_a_living_process_are_refused(finished, refused):
    path, ended = finished / "manifest.json", finished / "summary.json"
    text, summary = path.read_text(), ended.read_text()
    content = json.loads(text)
    try:
        path.write_text(json.dumps({**content, "resumed": [], "scene_hash": "0" * 32}))
        error = refused(["run", f"resume={finished}", "budget.iterations=50"])
        assert "scene has changed" in error and "new run" in error
        path.write_text(json.dumps({**content, "resumed": [], "start_hash": "0" * 32}))
        error = refused(["run", f"resume={finished}", "budget.iterations=50"])
        assert "its start has changed since" in error
        other = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
        alive = {**content, "resumed": [], **process(other.pid), "ticks": None}
        path.write_text(json.dumps(alive))
        assert "spent" in refused(["run", f"resume={finished}"]), "complete, in a notebook's kernel"
        ended.write_text(json.dumps(json.loads(summary) | {"complete": False}))
        assert "still being written" in refused(["run", f"resume={finished}"])
        ended.unlink()
        assert "still being written" in refused(["run", f"resume={finished}"])
        other.kill()
        other.wait()
        assert not manifest.alive(alive), "its process has gone"
    finally:
        path.write_text(text)
        ended.write_text(summary)


@pytest.mark.parametrize(
    "changed, told",
    [
        ({"variant": "another"}, "began with variant=another"),
        ({"scene_hash": "0" * 32}, "its scene has changed since"),
        ({"start_hash": "0" * 32}, "its start has changed since"),
        ({"parameter_rmse_is": "radiance"}, "its parameter_rmse is in 'radiance', and now"),
        ({"packages": {"mitsuba": "3.0.0"}}, "its target has changed since, or is Mitsuba "),
    ],
)
def test_what_does_not_go_on_is_refused_before_targets(
    finished, refused, tmp_path, monkeypatch, changed, told
):
    """They may take hours."""

    def slow(*arguments):
        raise AssertionError("targets are rendered")

    monkeypatch.setattr(targets, "render", slow)
    folder = tmp_path / "copy"
    shutil.copytree(finished, folder)
    content = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(content | changed))
    assert told in refused(["run", f"resume={folder}", "budget.iterations=90"])
    entry = race.continued("again", folder, {"budget.iterations": 90})
    with pytest.raises(InputError, match=told):
        race.run([entry], 1.0, lambda: None)


def test_what_a_checkpoint_held_is_let_go_once_it_is_taken_over(finished, tmp_path, monkeypatch):
    folder, prepare, made = tmp_path / "copy", resumption.prepare, []
    shutil.copytree(finished, folder)
    monkeypatch.setattr(resumption, "prepare", lambda *g: made.append(prepare(*g)) or made[0])
    assert experiment.resume(folder, {"budget.iterations": 90}) == 0
    assert made[0].arrays == {}


def test_what_another_process_did_meanwhile_is_kept(finished, tmp_path, monkeypatch):
    """While the scene was loaded and its kernels were made."""
    folder, prepare = tmp_path / "copy", resumption.prepare
    shutil.copytree(finished, folder)
    rows = (folder / "history.csv").read_text()

    def late(*given):
        earlier = prepare(*given)
        other = records.RunWriter.reopen(folder, 10**6)
        other.checkpoint(earlier.arrays, earlier.state | {"iteration": 80})
        other.release()
        return earlier

    monkeypatch.setattr(resumption, "prepare", late)
    with pytest.raises(InputError, match="another process went on with it meanwhile, .* to 80: "):
        experiment.resume(folder, {"budget.iterations": 90})
    assert (folder / "history.csv").read_text() == rows
    assert records.load_checkpoint(folder)[1]["iteration"] == 80


def test_a_disk_that_stands_still_puts_no_checkpoint_off(tmp_path):
    """Nor does one that is always slow, for hours."""
    clock = SimpleNamespace(seconds=0.0, unbilled_seconds={}, unbilled=lambda _: nullcontext())
    recorder = Recorder(
        None, None, SimpleNamespace(clock=clock, export=lambda: ({}, {})), tmp_path, None
    )
    spent, pauses = [0.1, 60.0, 0.1, 90.0, 90.0, 90.0], []

    def write(*unused):
        clock.seconds += spent[len(pauses)]

    recorder.writer = SimpleNamespace(checkpoint=write)
    for _ in spent:
        recorder._checkpoint()
        pauses.append(recorder._pause)
    assert pauses == pytest.approx([10, 10, 10, 10, 10, 600])


def test_starts_are_told_apart_by_what_they_hold():
    made = [problem({ROUGHNESS: start}).unknowns.start_hash for start in (0.5, 0.6, 0.5)]
    assert made[0] == made[2] != made[1]


def test_a_process_of_which_nothing_is_known_does_not_count():
    assert not manifest.alive({**manifest.process(), "host": "elsewhere", "pid": os.getppid()})


def test_a_run_that_had_failed_and_goes_on_says_so(finished, no_page, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(finished, folder)
    summary = json.loads((folder / "summary.json").read_text())
    failed = {**summary, "complete": False, "status": "numerical failure"}
    (folder / "summary.json").write_text(json.dumps(failed))
    after = resumed(folder)
    assert after.manifest["resumed"][-1]["failed"]
    assert any("had ended in a numerical failure" in each for each in after.summary["warnings"])
