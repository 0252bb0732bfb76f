"""Watching: what is said of runs that other processes write, and when it is over."""

from __future__ import annotations

import json
import os
import pty
import shlex
import signal
import subprocess
import sys

import pytest
from runs_for_tests import begin, followed, gone, process, row, run

from isas_cli import records
from isas_cli.cli import watch
from isas_cli.records import files, follow
from isas_cli.runtime.errors import InputError

WATCH = "import sys\nfrom pathlib import Path\nfrom isas_cli.cli.watch import main\n"
WATCH += "sys.exit(main(Path(sys.argv[1])))\n"


@pytest.fixture
def script(monkeypatch):
    """What happens while the watch sleeps: one of the functions of the list each time."""
    steps: list = []

    def sleep(seconds: float) -> None:
        assert steps, "still watches after everything has happened"
        steps.pop(0)()

    monkeypatch.setattr(watch.time, "sleep", sleep)
    monkeypatch.setattr(watch, "_FIND_SECONDS", 0.0)
    return steps


def test_a_record_that_cannot_be_read_is_said_to_be(tmp_path):
    run(tmp_path)
    (tmp_path / "manifest.json").write_text(json.dumps({"schema": 99}))
    follower = followed(tmp_path)
    assert follower.status() == follow.UNREADABLE and "schema version 99" in follower.problem
    with pytest.raises(InputError, match="schema version 99"):
        watch.main(tmp_path)


def said_iterations(capsys) -> list[str]:
    lines = [line.split("  ") for line in capsys.readouterr().out.splitlines()]
    return [parts[1] for parts in lines if len(parts) > 1 and parts[1].startswith("it ")]


def test_new_rows_are_said_once_each_until_the_run_ends(tmp_path, script, capsys):
    made = []
    script += [
        lambda: made.append(begin(tmp_path)),
        lambda: made[0].evaluation(row(0)),
        lambda: [made[0].evaluation(row(number)) for number in (1, 2)],
        lambda: None,
        lambda: made[0].evaluation(row(3)),
        lambda: made[0].summary({"status": "done", "warnings": ["so and so"]}),
    ]
    assert watch.main(tmp_path) == 0 and not script
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{tmp_path}: no run has begun here yet; waiting"
    assert lines[1] == "pottery  ours  l2  seed 3"
    assert [line.split("  ")[1] for line in lines[2:6]] == ["it 0", "it 10", "it 20", "it 30"]
    assert lines[5] == (
        "8.0/16 s  it 30  image_rmse 0.02 ×0.1  parameter_rmse 0.04 ×0.1  loss 0.01  2.00 M paths/s"
    )
    assert lines[6:8] == ["done", "warning: so and so"] and lines[8].startswith("report: ")


def test_of_a_run_under_way_only_the_last_row_is_old(tmp_path, script, capsys):
    writer = run(tmp_path, 3)
    script += [lambda: writer.evaluation(row(3)), lambda: writer.summary({"status": "done"})]
    assert watch.main(tmp_path) == 0
    assert said_iterations(capsys) == ["it 20", "it 30"]


def test_a_run_that_is_resumed_from_an_earlier_checkpoint_is_followed_on(tmp_path, script, capsys):
    run(tmp_path, 4)
    made = []
    script += [
        lambda: made.append(records.RunWriter.reopen(tmp_path, 15)),
        lambda: made[0].evaluation(row(2)),
        lambda: made[0].evaluation(row(3)),
        lambda: made[0].summary({"status": "done"}),
    ]
    assert watch.main(tmp_path) == 0
    assert said_iterations(capsys) == ["it 30", "it 10", "it 20", "it 30"]


def test_a_killed_run_is_said_to_be_and_how_it_goes_on(tmp_path, script, capsys):
    folder = tmp_path / "with a space"
    writer = run(folder, 2, manifest=process(gone()))
    script += [lambda: None]  # only what stays killed is
    assert watch.main(folder) == 0 and not script
    assert capsys.readouterr().out.splitlines()[-1].endswith("before its first checkpoint")
    writer.checkpoint({}, {})
    script += [lambda: None]
    assert watch.main(folder) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("killed: ")
    assert shlex.split(last.split("go on with: ")[1]) == ["isas", "run", f"resume={folder}"]


def test_a_run_of_a_race_goes_on_with_all_of_it(tmp_path, capsys):
    """By itself it would have had more billed time than the others."""
    folder = tmp_path / "ours/seed1"
    run(folder, 2, status="interrupted")
    (tmp_path / "race.yaml").touch()
    assert watch.main(folder, True) == 0
    out = capsys.readouterr().out.replace("\n/", "/")
    assert f"go on with: isas race resume={tmp_path}\n" in out and "isas run" not in out


def test_a_run_taken_up_by_another_process_is_not_called_killed(tmp_path, script, capsys):
    writer = run(tmp_path, 2, manifest=process(gone()))
    script += [
        lambda: writer.manifest({**process(gone()), "resumed": [process()]}),
        lambda: writer.summary({"status": "done"}),
    ]
    assert watch.main(tmp_path) == 0 and not script
    out = capsys.readouterr().out
    assert "done" in out.splitlines() and "killed" not in out


@pytest.mark.parametrize(
    "summary, said",
    [
        ({"status": "failed", "error": "no space left"}, "failed: no space left"),
        ({"status": "numerical failure"}, "numerical failure"),
        ({"status": "interrupted"}, "interrupted; go on with: isas run resume="),
    ],
)
def test_how_a_run_ended_is_said(tmp_path, capsys, summary, said):
    run(tmp_path, 2, **summary)
    watch.main(tmp_path)
    assert capsys.readouterr().out.endswith("report.html, which is being written\n")
    (tmp_path / "report.html").write_text("a page")
    for once in (False, True):
        assert watch.main(tmp_path, once) == 0
        *_, last, report = capsys.readouterr().out.replace("\n/", "/").splitlines()
        assert last.startswith(said) and report == f"report: {tmp_path / 'report.html'}"


def test_jobs_that_failed_before_they_had_a_record_are_not_waited_for(tmp_path, capsys, script):
    files.write_json(tmp_path / "a/summary.json", {"status": "failed", "error": "no such scene"})
    (tmp_path / "a/config.yaml").write_text("scene: {name: pottery}\nseed: 3\n")
    assert watch.main(tmp_path) == watch.main(tmp_path / "a") == 0
    labels, end = "pottery  seed 3", "failed: no such scene"
    lines = [f"a: {labels}", f"a: {end}", labels, end]
    assert capsys.readouterr().out.splitlines() == lines
    assert watch.main(tmp_path, once=True) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"a: {end}"


def test_a_sweep_that_lives_may_begin_another_job(tmp_path):
    """As where the first of its jobs is refused."""
    for name, pid in (("lives", os.getpid()), ("gone", gone())):
        job = tmp_path / name / "a"
        said = {"status": "failed", "error": "no such scene", "process": process(pid)}
        files.write_json(job / "summary.json", said)
        (job / "config.yaml").write_text("scene: {name: pottery}\nseed: 3\n")
        watched = watch._Watched(tmp_path / name)
        watched.update()
        assert watched.over() == (name == "gone")


def test_once_shows_the_present_state_and_leaves(tmp_path, capsys, script):
    run(tmp_path / "r", 3)
    assert watch.main(tmp_path / "r", once=True) == 0
    out = capsys.readouterr().out
    assert "running" in out and "25 %" in out and "2.00 M paths/s" in out
    (tmp_path / "empty").mkdir()
    assert watch.main(tmp_path / "empty", once=True) == 0
    assert "no run has begun here yet" in " ".join(capsys.readouterr().out.split())


def test_several_runs_are_followed_until_all_have_ended(tmp_path, script, capsys):
    run(tmp_path / "ours" / "seed1", 2, process(gone()), status="done")
    one = run(tmp_path / "uniform" / "seed1", 2, process(host="elsewhere"))
    made = []
    script += [
        lambda: one.evaluation(row(2)),
        lambda: made.append(begin(tmp_path / "uniform" / "seed2", process(host="elsewhere"))),
        lambda: one.summary({"status": "failed", "error": "no space left", "warnings": ["x"]}),
        lambda: made[0].summary({"status": "done"}),
    ]
    assert watch.main(tmp_path) == 0 and not script
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("  ")[0] for line in lines] == [
        "ours/seed1: pottery",
        "ours/seed1: 2.0/16 s",
        "ours/seed1: done",
        "uniform/seed1: pottery",
        "uniform/seed1: 2.0/16 s",
        "uniform/seed1: 4.0/16 s",
        "uniform/seed2: pottery",
        "uniform/seed1: failed: no space left",
        "uniform/seed2: done",
    ]


def test_more_runs_may_come_as_long_as_the_process_of_one_lives(tmp_path, script, capsys):
    sweep = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    run(tmp_path / "a", 2, process(sweep.pid), status="done")
    script += [
        lambda: None,
        lambda: run(tmp_path / "b", 2, process(sweep.pid), status="done"),
        lambda: sweep.communicate(b"end\n"),
    ]
    assert watch.main(tmp_path) == 0 and not script
    assert capsys.readouterr().out.splitlines()[-1] == "b: done"


def test_of_several_runs_one_that_cannot_be_read_does_not_hide_the_others(tmp_path, capsys):
    run(tmp_path / "good", 2, process(gone()), status="done")
    run(tmp_path / "old", 2, process(gone()))
    (tmp_path / "old" / "manifest.json").write_text(json.dumps({"schema": 99}))
    assert watch.main(tmp_path, once=True) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "old unreadable" in out and "good done" in out
    assert "old: cannot be read:" in out and "schema version 99" in out


def test_a_folder_that_does_not_exist_is_refused(tmp_path, script):
    with pytest.raises(InputError, match="no such folder"):
        watch.main(tmp_path / "nothing")
    (tmp_path / "goes").mkdir()
    script += [lambda: (tmp_path / "goes").rmdir()]
    with pytest.raises(InputError, match="has gone"):
        watch.main(tmp_path / "goes")


def test_ctrl_c_leaves_quietly_and_the_run_alone(tmp_path):
    run(tmp_path)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    watching = subprocess.Popen(
        [sys.executable, "-c", WATCH, str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert watching.stdout.readline().startswith("pottery")
    watching.send_signal(signal.SIGINT)
    _, errors = watching.communicate(timeout=60)
    assert watching.returncode == 130 and errors == ""
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_a_terminal_has_one_view_that_is_redrawn_and_ends_by_itself(tmp_path):
    writer = run(tmp_path, 3)
    ours, theirs = pty.openpty()
    environment = {k: v for k, v in os.environ.items() if k != "NO_COLOR"}
    environment |= {"TERM": "xterm-256color", "COLUMNS": "100", "LINES": "40"}
    watching = subprocess.Popen(
        [sys.executable, "-c", WATCH, str(tmp_path)],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        env=environment,
    )
    os.close(theirs)
    seen = b""

    def until(what: bytes) -> None:
        nonlocal seen
        while what not in seen:
            seen += os.read(ours, 65536)  # OSError once the other side has gone

    until(b"4.0/16 s billed")
    writer.evaluation(row(3))
    until(b"8.0/16 s billed")
    writer.summary({"status": "done", "warnings": ["so and so"]})
    until(b"warning: so and so")
    assert watching.wait(timeout=60) == 0
    os.close(ours)
    text = seen.decode()
    assert "\x1b[?25l" in text and "\x1b[?25h" in text, "hides the cursor, and gives it back"
    assert "done" in text and "\x1b[36m" in text and "⠀" in text
