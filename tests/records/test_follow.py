"""How a run stands: told from its files, and shown in a terminal."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from disk import lock
from rich.console import Console
from runs_for_tests import begin, followed, gone, process, row, run

from isas_cli.cli import watch_view
from isas_cli.records import files, follow, manifest


def shown(renderable, width: int = 100, height: int = 40) -> str:
    """As a terminal without colours has it."""
    console = Console(width=width, height=height, force_terminal=True, color_system=None)
    with console.capture() as capture:
        console.print(renderable)
    return capture.get()


def test_a_process_is_told_from_another_that_has_its_number():
    assert follow.alive(process()) is True
    assert follow.alive(process(gone())) is False
    assert follow.alive(process(started="2001-01-01T00:00:00+00:00")) is False
    assert follow.alive(process(host="elsewhere")) is None
    assert follow.alive(process(gone(), pid_namespace="pid:[1]")) is None, "another container's"
    assert follow.alive(process(pid_namespace=follow.pid_namespace())) is True
    assert follow.alive({"started": "2001-01-01T00:00:00+00:00"}) is None
    assert follow.alive({**process(gone()), "resumed": [process()]}) is True
    assert follow.alive({**process(), "resumed": [process(), process(gone())]}) is False


@pytest.mark.skipif(sys.platform != "linux", reason="/proc")
def test_a_clock_that_is_set_makes_no_other_process(monkeypatch):
    entry = manifest.process()
    monkeypatch.setattr(psutil.Process, "create_time", lambda self: time.time() + 3600)
    assert follow.alive(entry) is True
    assert follow.alive(entry | {"ticks": entry["ticks"] + 1}) is False
    assert follow.alive(entry | {"ticks": None}) is False, "by the time of day, as there is no more"


def test_a_process_that_has_ended_but_was_not_waited_for_is_gone():
    ended = subprocess.Popen([sys.executable, "-c", ""])
    os.waitid(os.P_PID, ended.pid, os.WEXITED | os.WNOWAIT)  # it stays a zombie
    assert follow.alive(process(ended.pid)) is False
    ended.wait()


def test_runs_are_found_below_a_folder_but_not_within_a_run(tmp_path):
    for name in ("b/seed1", "a", "a/checkpoint/inner"):
        (tmp_path / name).mkdir(parents=True, exist_ok=True)
        (tmp_path / name / "manifest.json").write_text("{}")
    assert follow.find(tmp_path) == [tmp_path / "a", tmp_path / "b" / "seed1"]
    assert follow.find(tmp_path / "a") == [tmp_path / "a"]


def test_of_runs_that_are_known_no_manifest_is_read_again(tmp_path, monkeypatch):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "manifest.json").write_text("{}")
    read, measures = [], follow.measures
    monkeypatch.setattr(follow, "measures", lambda place: read.append(place) or measures(place))
    assert follow.find(tmp_path, {tmp_path / "a"}) == [tmp_path / "a", tmp_path / "b"]
    assert read == [tmp_path / "b"]


def test_a_folder_that_may_not_be_read_is_among_them_and_says_why(tmp_path, monkeypatch):
    run(tmp_path / "a", status="done")
    run(tmp_path / "b" / "seed1", status="done")
    lock(monkeypatch, tmp_path / "b")
    assert follow.find(tmp_path) == [tmp_path / "a", tmp_path / "b"]
    follower = followed(tmp_path / "b")
    assert follower.status() == follow.UNREADABLE
    assert follower.problem == f"{tmp_path / 'b'}: Permission denied"


def test_of_what_has_no_manifest_only_a_job_that_failed_is_found(tmp_path):
    for name, status in (("failed", "failed"), ("other", "done")):
        files.write_json(tmp_path / name / "summary.json", {"status": status})
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "summary.json").write_text("[1]")
    assert follow.find(tmp_path) == [tmp_path / "failed"]
    assert followed(tmp_path / "failed").status() == "failed"
    assert followed(tmp_path / "other").status() == follow.RUNNING


def test_a_follower_reads_only_what_has_changed(tmp_path, monkeypatch):
    follower = follow.Follower(tmp_path)
    assert follower.update() and follower.run is None and follower.status() == follow.RUNNING
    assert not follower.update()
    writer = begin(tmp_path)
    writer.evaluation(row(0))
    assert follower.update() and len(follower.run.history) == 1
    monkeypatch.setattr(follow, "load", lambda folder: pytest.fail("read again"))
    assert not follower.update()
    monkeypatch.undo()
    writer.evaluation(row(1))
    assert follower.update() and len(follower.run.history) == 2
    assert follower.status() == follow.RUNNING
    writer.summary({"status": "done"})
    assert follower.update() and follower.status() == "done"


def test_a_run_is_killed_only_where_its_process_went_without_a_summary(tmp_path):
    writer = run(tmp_path, manifest=process(gone()))
    follower = followed(tmp_path)
    assert follower.status() == follow.KILLED
    writer.summary({"status": "numerical failure"})  # between the update and the question
    assert follower.status() == "numerical failure"
    elsewhere = followed(run(tmp_path / "b", manifest=process(host="elsewhere")).folder)
    assert elsewhere.status() == follow.RUNNING


def test_a_standing_has_budget_speed_and_shares(tmp_path):
    standing = follow.Standing.of(followed(run(tmp_path, 3).folder).run)
    assert standing.labels == ("pottery", "ours", "l2", "seed 3")
    assert standing.spent == 4 / 16 and standing.rate == 2e6
    assert standing.share("image_rmse") == standing.share("parameter_rmse") == 0.25
    assert standing.warnings == []
    first = follow.Standing.of(followed(tmp_path).run, 1)
    assert first.spent == 0 and first.rate is None and first.last["iteration"] == 0
    empty = follow.Standing.of(followed(begin(tmp_path / "b").folder).run)
    assert empty.last == {} and empty.spent is empty.rate is empty.share("loss") is None


def test_a_standing_warns_of_errors_that_grow_and_of_numbers_that_are_none(tmp_path):
    writer = run(tmp_path, 1)
    writer.evaluation(row(1, parameter_rmse=0.6, nonfinite=1234))
    assert follow.Standing.of(followed(tmp_path).run).warnings == [
        "1,234 gradient entries were not finite so far",
        "parameter_rmse is 1.5 times what it was at the start",
    ]


def test_the_page_of_a_run_says_where_it_stands(tmp_path):
    run(tmp_path)
    text = shown(watch_view.page(followed(tmp_path), Console(width=100, height=40)))
    assert text.startswith(f"pottery  ours  l2  seed 3  {tmp_path}")
    assert "running" in text and "50 %" in text and "8.0/16 s billed" in text
    assert "2.00 M paths/s" in text and "iteration 30" in text
    errors = {line.split()[0]: line.split()[1:] for line in text.splitlines() if "_rmse" in line}
    assert errors == {
        "image_rmse": ["0.02", "0.2", "0.1"],
        "parameter_rmse": ["0.04", "0.4", "0.1"],
    }


def test_a_run_on_photographs_has_no_parameter_error(tmp_path):
    writer = begin(tmp_path)
    for number in range(3):
        writer.evaluation(row(number, parameter_rmse=None))
    text = shown(watch_view.page(followed(tmp_path), Console(width=100, height=40)))
    assert "parameter_rmse" not in text and "image_rmse" in text and "⠀" in text


def test_a_run_that_has_written_nothing_for_long_is_called_silent(tmp_path):
    run(tmp_path)
    for path in tmp_path.rglob("*"):
        os.utime(path, (0, path.stat().st_mtime - 600))
    text = shown(watch_view.page(followed(tmp_path), Console(width=100, height=40)))
    assert "silent for 10 min" in text and "running" not in text


def charted(folder: Path, **console) -> list[str]:
    page = watch_view.page(followed(folder), Console(force_terminal=True, **console))
    return [line for line in shown(page, 100).splitlines() if "|" in line]


def test_the_chart_is_logarithmic_from_the_start_to_the_last_error(tmp_path):
    run(tmp_path)
    lines = charted(tmp_path, width=96, height=40, color_system=None)
    *course, axis, ticks = lines
    labels = [float(line.split("|")[0]) for line in course]
    assert labels[0] == 1.0 and labels[-1] == pytest.approx(0.1)
    ratios = [a / b for a, b in zip(labels, labels[1:])]
    assert max(ratios) == pytest.approx(min(ratios), rel=0.03)  # three digits are shown
    assert "billed s" in axis and ticks.split("|")[1].split() == "0 1.5 3 4.5 6 7.5 9 10.5".split()
    drawn = [line.split("|")[1] for line in course]
    first = [min(i for i, c in enumerate(d) if c not in " ⠀") for d in drawn if d.strip(" ⠀")]
    assert first == sorted(first), "falls from left to right"


def test_there_is_no_chart_without_room_or_rows(tmp_path):
    writer = run(tmp_path, 1)
    assert not charted(tmp_path, width=96, height=40)
    writer.evaluation(row(1))
    assert charted(tmp_path, width=96, height=40)
    assert not charted(tmp_path, width=30, height=40) and not charted(tmp_path, width=96, height=15)


def test_the_table_shows_running_ones_first_and_no_more_than_fit(tmp_path):
    followers = {}
    for name in ("a", "b", "c", "d"):
        ended = {} if name == "c" else {"status": "done"}
        followers[name] = followed(run(tmp_path / name, 3, **ended).folder)
    console = Console(width=100, height=7, force_terminal=True)
    lines = shown(watch_view.table(followers, console)).splitlines()
    assert [line.split()[:2] for line in lines[1:4]] == [
        ["c", "running"],
        ["a", "done"],
        ["b", "done"],
    ]
    assert lines[1].split()[2:] == "4.0/16 s 20 0.05 ×0.25 0.1 ×0.25 2.00".split()
    assert lines[4] == "1 running, 3 ended; 1 of them not shown"
    assert len(shown(watch_view.table(followers, Console(height=50))).splitlines()) == 6


def test_measurements_are_no_runs_and_links_are_followed_once(tmp_path):
    for name, content in (("runs/a", {}), ("runs/measured", {"variance": {}})):
        (tmp_path / name).mkdir(parents=True)
        files.write_json(tmp_path / name / "manifest.json", content)
    assert follow.find(tmp_path) == [tmp_path / "runs/a"]
    (tmp_path / "chosen").mkdir()
    (tmp_path / "chosen/one").symlink_to(tmp_path / "runs/a")
    (tmp_path / "chosen/round").symlink_to(tmp_path / "chosen")
    assert follow.find(tmp_path / "chosen") == [tmp_path / "chosen/one"]


def test_a_run_without_its_pictures_says_how_to_make_them(tmp_path):
    writer = run(tmp_path, manifest=process(gone()))
    writer.summary({"status": "done", "complete": False})
    told = watch_view.ending(followed(tmp_path))
    assert any(f"isas run resume={tmp_path}" in line for line in told), told
