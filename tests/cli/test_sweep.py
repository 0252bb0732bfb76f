"""Sweeps: what becomes of jobs that fail, are done already or were interrupted."""

import copy
import enum
import errno
import io
import json
import os
import pickle
import random
import re
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import flaky_scene
import joblib
import psutil
import pytest
import runs_for_tests
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf
from processes import HANGUP, begun, started, until

from isas_cli import records
from isas_cli.cli.sweeps import fingerprint, launchers, outcome, search, sweep, worker
from isas_cli.cli.sweeps.job import DONE, OTHER, UNFINISHED, Job, Report
from isas_cli.cli.sweeps.outcome import Outcome, exit_status
from isas_cli.config import presets, schema, searchpath
from isas_cli.config.compose import compose, translate
from isas_cli.runtime import errors, guests
from isas_cli.runtime.errors import InputError

TINY = [
    *("scene=dodoco", "size=tiny", "scene.builder=flaky_scene.build", "effects=full"),
    "sampler=uniform",  # compiles fastest
    *("budget.iterations=2", "evaluation.count=2", "target.spp=4"),
    *("frames.views=0", "frames.snapshots=0"),
]
JOBLIB = ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"]


def textures(*sizes: int) -> str:
    return f"scene.arguments.texture={','.join(map(str, sizes))}"


def table(err: str) -> dict[str, str]:
    """Job → status, from the table at the end."""
    rows = [re.split(r"\s{2,}", line.strip()) for line in err.splitlines()]
    return {row[0]: row[1] for row in rows if len(row) == 6 and row[0] != "job"}


def folders() -> dict[int, Path]:
    """The job's texture → its folder, of all jobs below the present folder."""
    found = Path("runs").rglob("config.yaml")
    return {OmegaConf.load(path).scene.arguments.texture: path.parent for path in found}


def summary(folder: Path) -> dict:
    return json.loads((folder / "summary.json").read_text())


def test_jobs_that_fail_are_recorded_and_done_again_and_finished_ones_skipped(isas):
    refused, raises, killed = flaky_scene.REFUSED, flaky_scene.RAISES, flaky_scene.KILLED
    sweep = [*TINY, "-m", textures(refused, raises, killed, 8)]
    status, out, err = isas("run", *sweep)
    assert status == 2  # the first failure's
    assert out.count("report: ") == 1
    jobs = {size: f"scene.arguments.texture={size}" for size in (refused, raises, killed, 8)}
    assert table(err) == dict(zip(jobs.values(), ["failed", "failed", "failed", "done"]))
    last = err.splitlines()[-3:]
    assert last[0] == f"isas: {jobs[refused]}: this scene is refused"
    assert last[1] == f"isas: {jobs[raises]}: RuntimeError: this scene is broken"
    assert last[2].startswith(f"isas: {jobs[killed]}: its process was killed by SIGKILL")
    assert "Traceback" not in err
    places = folders()
    for size, line in zip((refused, raises, killed), last):
        content = summary(places[size])
        assert content["status"] == "failed" and line.endswith(content["error"])
        assert content["overrides"][-1] == jobs[size]
        assert (content["scene"], content["sampler"], content["loss"]) == (
            "dodoco",
            "uniform",
            "l2",
        )
        assert content["seed"] == 1
    assert "RuntimeError: this scene is" in (places[raises] / "error.txt").read_text()
    assert not (places[refused] / "error.txt").exists()
    done = records.load(places[8])
    assert done.summary["status"] == "done"
    assert done.manifest["command"] == ["isas", "run", *sweep]
    assert [path.name for path in Path("runs").iterdir()] == ["dodoco"]

    before = (places[8] / "manifest.json").read_bytes()
    status, out, err = isas("run", *TINY, "-m", textures(raises, 8))
    assert (status, out) == (1, "")
    assert table(err) == {jobs[raises]: "failed", jobs[8]: "skipped"}
    assert f"{jobs[8]}: skipped: done in {places[8]}" in err.splitlines()
    assert (places[8] / "manifest.json").read_bytes() == before
    assert folders() == places


def test_a_job_that_is_queued_again_goes_on_with_what_it_began(tmp_path):
    """`overwrite=true` is of the first attempt: what that left is not begun anew."""
    cfg = OmegaConf.create({"overwrite": True})
    job = Job("a", [], tmp_path, cfg)
    assert job.anew and Job("b", [], tmp_path, OmegaConf.create({"overwrite": False})).anew is False
    (tmp_path / "manifest.json").touch()
    again = pickle.loads(pickle.dumps(job))  # as a launcher hands it on
    assert not again.anew
    assert Job("a", [], tmp_path, cfg).anew  # another command's


def test_what_is_done_is_skipped_with_a_word_on_files_that_changed_since(isas, monkeypatch):
    folder = Path("there")
    folder.mkdir()
    (folder / "my.xml").touch()
    monkeypatch.chdir(folder)
    job = Job("a", [], Path("run").absolute(), compose(["scene=file", "scene.path=my.xml"]))
    job.folder.mkdir()
    (job.folder / "config.yaml").write_text(OmegaConf.to_yaml(job.cfg))
    (job.folder / "summary.json").write_text('{"status": "done"}')
    told = {"schema": records.files.SCHEMA_VERSION, "folder": str(Path.cwd())}
    (job.folder / "manifest.json").write_text(json.dumps(told | {"started": "2999-01-01T00:00:00"}))
    assert job.found() == DONE and job.doubt() == ""
    (job.folder / "manifest.json").write_text(json.dumps(told | {"started": "1999-01-01T00:00:00"}))
    assert "newer than that is scene.path=my.xml" in job.doubt()
    monkeypatch.setattr(guests, "installed", lambda: {"mine": "0.1+b"})
    for then, doubt in (("0.1+a", "by another mine"), ("0.1+b", "newer than that")):
        manifest = told | {"started": "1999-01-01T00:00:00", "guests": {"mine": then}}
        (job.folder / "manifest.json").write_text(json.dumps(manifest))
        assert doubt in job.doubt()
    elsewhere = Path("elsewhere")
    elsewhere.mkdir()
    (elsewhere / "my.xml").touch()
    monkeypatch.chdir(elsewhere)
    assert job.found() == OTHER
    with pytest.raises(InputError, match="scene.path=my.xml is another file: give another hydra"):
        job.go(None)


def test_what_changed_since_in_a_set_of_photographs_is_told(tmp_path):
    """Pictures, masks and cameras, also beside the set or behind a link; not records of runs."""
    names = ("set/a.png", "set/sparse/0/images.txt", "masks/a.png", "there/b.png", "cameras.json")
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "set/images").symlink_to(tmp_path / "there")
    settings = [f"photos.path={tmp_path / 'set'}", f"photos.masks={tmp_path / 'masks'}"]
    settings.append("photos.cameras=../cameras.json")
    job = Job("a", [], tmp_path / "set/run", compose(translate(["scene=photos", *settings])))
    job.folder.mkdir()
    (job.folder / "config.yaml").touch()
    told = {"schema": records.files.SCHEMA_VERSION, "started": "2001-01-01T00:00:00"}
    (job.folder / "manifest.json").write_text(json.dumps(told))
    for name in names:
        os.utime(tmp_path / name, (0, 0))
    assert job.doubt() == ""
    for name in names:
        os.utime(tmp_path / name)
        assert f"/{name.removeprefix('there/')}: overwrite=true does it again" in job.doubt()
        os.utime(tmp_path / name, (0, 0))


def test_side_by_side_a_job_that_dies_ends_no_other(isas):
    killed = flaky_scene.KILLED
    status, _, err = isas("run", *TINY, "report=false", "-m", *JOBLIB, textures(killed, 8))
    assert status == 1
    assert list(table(err).values()) == ["failed", "done"]
    places = folders()
    assert summary(places[killed])["killed"] is True
    run = records.load(places[8])
    assert run.config["threads"] == max(1, joblib.cpu_count() // 2)
    assert run.manifest["command"][:2] == ["isas", "run"]
    assert "param" in (places[8] / "log.txt").read_text()


def test_side_by_side_a_folder_that_cannot_be_written_is_said(tmp_path, capfd):
    (tmp_path / "file").touch()
    job = Job("a", [], tmp_path / "file" / "run", compose(TINY))
    end = worker.supervise(job, ["isas"], None, True, lambda: False)
    assert (end.status, end.code) == ("failed", 2)
    assert end.error == f"{job.folder}: cannot be written: Not a directory"
    assert capfd.readouterr().err == ""


def test_ctrl_c_lets_jobs_side_by_side_finish_their_records(isas):
    settings = [o for o in TINY if not o.startswith(("budget", "scene.builder"))]
    sweep = ["run", *settings, "report=false", "budget.seconds=60", "-m", *JOBLIB, "seed=1,2,3"]
    process, (folder, *_) = begun(Path(), *sweep, rows=0)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    assert process.returncode == 130
    ends = table(err)
    assert ends["seed=3"] == "not begun" and set(ends.values()) == {"interrupted", "not begun"}
    assert records.load(folder).summary["status"] == "interrupted"


def test_interrupted_and_killed_jobs_go_on_where_they_were(isas):
    settings = [o for o in TINY if not o.startswith(("budget", "scene.builder"))]
    settings.append("report=false")
    sweep = ["run", *settings, "budget.seconds=3", "-m", "seed=1,2"]
    process, (folder,) = begun(Path(), *sweep, rows=0)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    assert process.returncode == 130
    assert table(err) == {"seed=1": "interrupted", "seed=2": "not begun"}
    assert err.splitlines()[-1] == "isas: interrupted"
    first = records.load(folder)
    assert first.summary["status"] == "interrupted"
    assert len(list(folder.parent.iterdir())) == 1  # nothing of the second job

    # So does one that ended by a full disk, or by a renderer of one's own.
    (folder / "summary.json").write_text(json.dumps(first.summary | {"status": "failed"}))
    assert Job("", [], folder, OmegaConf.load(folder / "config.yaml")).found() == UNFINISHED
    (folder / "summary.json").write_text(json.dumps(first.summary))

    with pytest.MonkeyPatch.context() as patched:  # a resumption that is refused costs nothing
        patched.setattr(worker, "run", lambda *unused: Report(2, "another machine"))
        status, _, err = isas("run", *settings, "budget.seconds=3", "-m", "seed=1")
    assert status == 2 and "another machine" in err
    assert records.load(folder).summary == first.summary

    process = started(Path(), *sweep)
    until(process, lambda: "resumed" in json.loads((folder / "manifest.json").read_text()))
    process.kill()  # and with it, at once, the job's own process
    process.wait()
    process.stdout.close()
    process.stderr.close()
    assert not (folder / "summary.json").exists()

    status, _, err = isas("run", *settings, "budget.seconds=3", "-m", "seed=1")
    assert status == 0, err
    last = records.load(folder)
    assert "resumed" in err and last.summary["status"] == "done"
    assert last.history["seconds"].iloc[-1] >= 3 > first.summary["seconds_billed"]
    assert last.history["iteration"].is_monotonic_increasing
    assert len(last.manifest["resumed"]) == 2


@pytest.mark.parametrize("number", [signal.SIGTERM, HANGUP])
def test_a_signal_to_all_processes_lets_jobs_finish_their_records(isas, number):
    """As `scancel` and `systemctl stop` send it: a job gets it, and what its parent passes on."""
    settings = [o for o in TINY if not o.startswith(("budget", "scene.builder"))]
    sweep = ["run", *settings, "budget.seconds=60", "-m", "seed=1"]
    process, (folder,) = begun(Path(), *sweep, rows=0)
    for each in (process, *psutil.Process(process.pid).children()):
        each.send_signal(number)
    _, err = process.communicate()
    assert process.returncode == 130 and [*table(err).values()] == ["interrupted"]
    run = records.load(folder)
    assert run.complete and run.summary["status"] == "interrupted"
    assert (folder / "report.html").is_file()


def test_what_another_sweep_s_process_writes_is_left_to_it(tmp_path, monkeypatch):
    """Both begun at once; the lock refuses the second."""
    job = Job("a", [], tmp_path / "run", compose(TINY))
    other = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)

    def refused(job, *unused):
        runs_for_tests.begin(job.folder, runs_for_tests.process(other.pid))
        return Report(2, "is still being written")

    monkeypatch.setattr(worker, "run", refused)
    end = worker.supervise(job, [], None, True, lambda: False)
    lives = job.written
    other.kill()
    other.wait()
    assert (end.status, end.error) == ("failed", "is still being written")
    assert lives and not job.written and not (job.folder / "summary.json").exists()


def test_a_sweep_goes_on_where_nothing_that_it_says_arrives(monkeypatch):
    class Full(io.StringIO):
        def write(self, text):
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(sys, "stderr", Full())
    outcome.say("a line")
    outcome.show([Outcome("a", Path("a"), "failed", 2, "why")])


def test_a_changed_setting_makes_another_folder(tmp_path):
    def name(*overrides: str) -> str:
        fingerprint.register()
        cfg = compose(["scene=dodoco", *overrides], hydra=True)
        return cfg.hydra.sweep.subdir

    assert name() == name("threads=2", "variant=llvm_ad_rgb", "overwrite=true", "loss=l2")
    assert name("optimizer.lr=0.03") == name("optimizer.lr=3e-2")
    group, _, last = name("seed=7").rpartition("/")
    assert (group, last) == ("dodoco/progress", name().rpartition("/")[2].replace("seed1", "seed7"))
    different = ["optimizer.lr=0.03", "budget.seconds=9", "frames.views=1", "size=tiny", "loss=l1"]
    assert len({name(), *(name(change) for change in different)}) == 1 + len(different)
    assert name("name=mine") == "dodoco/progress/mine-" + name().rpartition("/")[2]

    cfg = compose(["scene=dodoco"])
    (tmp_path / "config.yaml").write_text(OmegaConf.to_yaml(cfg, resolve=True))
    assert fingerprint.same(compose(["scene=dodoco", "threads=2", "name=x"]), tmp_path)
    assert not fingerprint.same(compose(["scene=dodoco", "seed=2"]), tmp_path)


@pytest.mark.parametrize(
    "typed, expected",
    [
        ("threads=1,2", ["'threads=1' and 'threads=2'", "seed1-", "name="]),
        ("seed=1,2 hydra.run.dir=x", ["hydra.run.dir", "hydra.sweep.dir=DIR"]),
        ("seed=1,2 --config-name=config", ["--config-name=config: not beside -m"]),
        ("size=tiny,tny", ["size=tny", "did you mean 'tiny'?"]),
        ("sampler=uniform,our", ["did you mean 'ours'?"]),
        ("hydra/launcher=foo", ["hydra/launcher=foo", "joblib", "submitit_slurm"]),
        ("hydra/launcher=joblib hydra.launcher.n_job=2", ["hydra.launcher.n_job"]),
    ],
)
def test_sweeps_that_cannot_begin_are_refused_in_one_line(refused, typed, expected):
    refused(["run", *TINY, "-m", *typed.split()], *expected)


@pytest.mark.parametrize("last, status", [(3, 3), (InputError("late"), 2)])
def test_what_hydra_itself_runs_ends_as_the_worst_of_its_jobs(isas, monkeypatch, last, status):
    ends = [0, last]

    def run(cfg, folder):
        end = ends.pop(0)
        if isinstance(end, Exception):
            raise end
        return end

    monkeypatch.setattr(sweep.one, "run", run)
    found, _, err = isas("run", *TINY, "hydra.mode=MULTIRUN", "--config-name=config", "seed=1,2")
    assert found == status and ends == [] and ("late" in err) is (status == 2)


def test_whoever_stops_reading_what_is_printed_is_no_full_disk(monkeypatch):
    def printing():
        raise BrokenPipeError

    monkeypatch.setattr(sweep.hydra, "main", lambda **settings: lambda run: printing)
    with pytest.raises(BrokenPipeError):
        sweep.by_hydra(["--cfg", "job"], ["scene=dodoco"])


@pytest.mark.parametrize(
    "typed, names",
    [
        ("glob(p*,exclude=[pl*])", ["preconditioned", "progress"]),
        ("sort(ours,gradient,reverse=true)", ["ours", "gradient"]),
        ('choice("ours","uniform")', ["ours", "uniform"]),
        ("uniform, ours", ["uniform", "ours"]),
    ],
)
def test_names_are_swept_in_every_way_that_hydra_has(typed, names):
    (found,) = sweep.parsed(translate([f"sampler={typed}"]))
    assert sweep.choices(found) == [f"sampler={name}" for name in names]


def test_what_is_called_as_a_preset_in_part_keeps_its_own_settings():
    typed = ["sampler=my-plateau", "sampler.spp=4"]
    assert presets.unpacked(typed, "sampler.base") == typed


@pytest.mark.parametrize(
    "typed", ["plateau,mitsuba", "choice(plateau,mitsuba)", "plateau, mitsuba"]
)
def test_presets_that_are_swept_keep_their_settings(typed):
    assert translate([f"sampler={typed}", "sampler.spp=4"])[1] == "estimator.spp=4"


@pytest.mark.parametrize(
    "choice, extra",
    [
        ("hydra/launcher=ray", "ray"),
        ("hydra/launcher=submitit_slurm", "slurm"),
        ("hydra/launcher=submitit_local", "slurm"),
        ("hydra/sweeper=optuna", "optuna"),
    ],
)
def test_extras_that_are_not_installed_are_named(refused, monkeypatch, choice, extra):
    monkeypatch.setattr("isas_cli.cli.sweeps.launchers._installed", lambda package: False)
    err = refused(["run", *TINY, "-m", choice])
    assert err == f"isas: {choice} is an extra: {errors.extra(extra)}\n"


def test_the_same_job_is_done_once_and_a_run_with_other_settings_stays(isas, monkeypatch):
    calls = []

    def attempt(job, command, threads, quiet, stop):
        calls.append(job)
        return Report(0)

    monkeypatch.setattr(worker, "run", attempt)
    other = Path("elsewhere/1/config.yaml")
    other.parent.mkdir(parents=True)
    other.write_text("seed: 5")
    (other.parent / "manifest.json").write_text("{}")
    arguments = ["hydra.sweep.dir=elsewhere", "hydra.sweep.subdir='${seed}'", "seed=1,1,2"]
    status, _, err = isas("run", *TINY, "-m", *arguments)
    assert status == 0 and [job.cfg.seed for job in calls] == [1, 2]
    assert [job.folder for job in calls] == [
        other.parent.absolute(),
        Path("elsewhere/2").absolute(),
    ]

    monkeypatch.setattr(worker, "run", lambda *unused: Report(2, "already holds a run"))
    status, _, err = isas("run", *TINY, "-m", *arguments)
    assert status == 2 and err.count("already holds a run") == 3
    assert not (other.parent / "summary.json").exists()
    assert other.read_text() == "seed: 5"


def test_a_numerical_failure_keeps_its_record_and_is_done_again(isas, monkeypatch):
    calls = []

    def attempt(job, command, threads, quiet, stop):
        calls.append(job)
        writer = records.RunWriter(job.folder, overwrite=True)
        writer.config(OmegaConf.to_yaml(job.cfg))
        writer.manifest({})
        writer.summary({"status": "numerical failure", "final": {"image_rmse": 0.5}})
        return Report(3, "the gradient is not finite")

    monkeypatch.setattr(worker, "run", attempt)
    for _ in range(2):
        status, _, err = isas("run", *TINY, "-m", "seed=1,2")
        assert status == 3 and err.splitlines()[-1] == "isas: seed=2: the gradient is not finite"
    assert len(calls) == 4
    content = summary(calls[0].folder)
    assert content["status"] == "numerical failure" and content["final"] == {"image_rmse": 0.5}
    assert content["error"] == "the gradient is not finite"


def test_no_job_begins_after_an_interruption_that_came_too_late(isas, monkeypatch):
    calls = []

    def attempt(job, command, threads, quiet, stop):
        calls.append(job)
        signal.raise_signal(signal.SIGINT)
        return Report(0)

    monkeypatch.setattr(worker, "run", attempt)
    status, _, err = isas("run", *TINY, "-m", "seed=1,2")
    assert (status, len(calls)) == (130, 1)
    assert table(err)["seed=2"] == "not begun"
    assert err.splitlines()[-1] == "isas: interrupted"


def test_while_many_jobs_are_composed_it_is_said_and_can_be_stopped(isas, monkeypatch):
    numbers, planned = [], sweep.planned

    def stopped(own, label, number):
        numbers.append(number)
        if number == 1:
            signal.raise_signal(signal.SIGINT)
        return planned(own, label, number)

    monkeypatch.setattr(sweep, "planned", stopped)
    monkeypatch.setattr(sweep, "_TOLD_SECONDS", -1.0)
    status, _, err = isas("run", *TINY, "-m", "seed=1,2,3")
    assert (status, numbers) == (130, [0, 1]) and not Path("runs").exists()
    lines = err.splitlines()
    assert [line for line in lines if "composed" in line] == [
        "0 of 3 jobs composed",
        "1 of 3 jobs composed",
    ]
    assert lines[-1] == "isas: interrupted"


def test_a_cluster_is_given_many_jobs_in_several_arrays(monkeypatch):
    """Where the second is refused, the first does not go on by itself."""
    arrays, asked, cancelled = [], {}, []

    class Executor:
        def __init__(self, *given, **named):
            pass

        def update_parameters(self, **named):
            asked.update(named)

        def map_array(self, do, jobs):
            if refuse and arrays:
                raise RuntimeError("too many")
            arrays.append(jobs)
            done = {"done": lambda: True, "result": lambda: None}
            cancel = lambda check: cancelled.append(check)
            return [SimpleNamespace(**done, cancel=cancel) for _ in jobs]

    monkeypatch.setitem(sys.modules, "submitit", SimpleNamespace(AutoExecutor=Executor))
    cluster, refuse = launchers.Submitit("slurm", "here", array_parallelism=64), False
    jobs = list(range(1500))
    assert len(list(cluster.launch(None, jobs, lambda: False))) == 1500
    assert [len(each) for each in arrays] == [750, 750] and sum(arrays, []) == jobs
    assert asked == {"slurm_array_parallelism": 32}
    arrays.clear()
    refuse = True
    with pytest.raises(InputError, match="submitit cannot launch the jobs: too many"):
        list(cluster.launch(None, jobs, lambda: False))
    assert len(cancelled) == 750


def test_a_job_whose_worker_is_lost_is_recorded_and_ends_no_other(isas, monkeypatch):
    calls = []

    def attempt(job, command, threads, quiet, stop):
        calls.append(job)
        if job.cfg.seed == 1:
            raise OSError("no more processes")
        return Report(0)

    monkeypatch.setattr(worker, "run", attempt)
    status, _, err = isas("run", *TINY, "-m", "seed=1,2")
    assert status == 1 and table(err) == {"seed=1": "failed", "seed=2": "done"}
    assert "its worker was lost: OSError: no more processes" in summary(calls[0].folder)["error"]


def test_a_job_that_slurm_tells_to_stop_waits_to_be_queued_again(monkeypatch):
    """What it returned would be submitit's success."""
    waited = []
    monkeypatch.setattr(launchers.time, "sleep", waited.append)
    for status, code, waits in (("done", 0, 0), ("interrupted", 130, 1), ("not begun", 130, 1)):
        end = Outcome("a", Path("a"), status, code)
        for preemptable in (False, True):
            waited.clear()
            do = launchers._Resumed(lambda job, stop, end=end: end, preemptable)
            assert do(None) is end and len(waited) == waits * preemptable
            assert all(600 >= seconds > 60 for seconds in waited), "more than SLURM's KillWait"


def test_a_job_that_was_stopped_before_its_worker_was_lost_is_interrupted(isas, monkeypatch):
    """As by `scancel`, which kills what has finished its record."""

    def attempt(job, command, threads, quiet, stop):
        runs_for_tests.begin(job.folder).summary({"status": "interrupted"})
        raise OSError("gone")

    monkeypatch.setattr(worker, "run", attempt)
    status, _, err = isas("run", *TINY, "-m", "seed=1")
    assert status == 130 and [*table(err).values()] == ["interrupted"] and "lost" not in err
    (path,) = Path("runs").rglob("summary.json")
    assert "error" not in summary(path.parent)


def test_every_launcher_and_sweeper_composes_and_is_built(monkeypatch):
    names = [path.stem for path in Path(schema.folder(), "hydra/launcher").glob("*.yaml")]
    assert {"joblib", "ray", "submitit_local", "submitit_slurm"} == set(names)
    launchers.prepare([])
    monkeypatch.setattr(launchers, "_installed", lambda package: True)
    for name in ("basic", *names):
        cfg = compose(["scene=dodoco", f"hydra/launcher={name}"], hydra=True)
        made = launchers.launcher(cfg.hydra)
        assert made.quiet == (name != "basic")
        assert made.threads(2) == {"basic": None, "joblib": max(1, joblib.cpu_count() // 2)}.get(
            name, 8 if name == "submitit_slurm" else 1
        )
    cfg = compose(["scene=dodoco", "hydra/sweeper=optuna"], hydra=True)
    assert cfg.hydra.sweeper.n_trials == 20


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Launchers and sweepers of one's own, with isas's in their defaults or by a plugin."""
    theirs = "_target_: hydra_plugins.theirs.Theirs\n"
    texts = {
        "launcher/cluster": "defaults: [submitit_slurm, _self_]\ntimeout_min: 7\n",
        "launcher/four": "defaults: [joblib, _self_]\nn_jobs: 4\n",
        "launcher/theirs": theirs,
        "sweeper/trials": "defaults: [optuna, _self_]\nn_trials: 4\n",
        "sweeper/theirs": theirs,
    }
    for name, text in texts.items():
        path = tmp_path / "own/hydra" / f"{name}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.setenv(searchpath.VARIABLE, str(tmp_path / "own"))


def test_a_launcher_is_told_by_its_settings(own, monkeypatch):
    monkeypatch.setattr(launchers, "_installed", lambda package: True)
    launchers.prepare([])

    def chosen(name: str) -> launchers.Launcher:
        cfg = compose(["scene=dodoco", f"hydra/launcher={name}"], hydra=True)
        return launchers.launcher(cfg.hydra)

    made = chosen("cluster")
    assert (made.cluster, made.parameters["timeout_min"]) == ("slurm", 7)
    assert chosen("four").n_jobs == 4


@pytest.mark.parametrize(
    "choice, told",
    {
        "hydra/launcher=cluster": "is an extra",
        "hydra/launcher=theirs": "none of isas's: take one, or have it in its defaults: basic",
        "hydra/sweeper=trials": "is an extra",
        "hydra/sweeper=theirs": "none of isas's: take basic or optuna",
    }.items(),
)
def test_what_isas_has_not_is_refused_under_any_name(own, refused, monkeypatch, choice, told):
    monkeypatch.setattr(launchers, "_installed", lambda package: False)
    refused(["run", *TINY, "-m", choice], choice, told)


class Optuna:
    """As much of the package as a search asks for, with one study, which a storage keeps."""

    def __init__(self):
        self.kept, self.samplers = [], SimpleNamespace(TPESampler=lambda seed: random.Random(seed))
        states = enum.Enum("TrialState", "RUNNING COMPLETE PRUNED FAIL WAITING")
        self.trial, self.logging = SimpleNamespace(TrialState=states), MagicMock()

    def create_study(self, storage, **more):
        if storage == "none":
            raise RuntimeError("no such\nstorage")
        return self

    @property
    def trials(self):
        return [copy.copy(trial) for trial in self.kept]

    def enqueue_trial(self, params):
        trial = SimpleNamespace(state=self.trial.TrialState.WAITING, params={}, value=None)
        trial.number, trial.system_attrs = len(self.kept), {"fixed_params": params}

        def suggest(name, low, high, log):
            trial.params[name] = params.get(name) or self.sampler.uniform(low, high)
            return trial.params[name]

        trial.suggest_float = suggest
        self.kept.append(trial)

    def ask(self):
        states = self.trial.TrialState
        if all(trial.state != states.WAITING for trial in self.kept):
            self.enqueue_trial({})
        trial = next(trial for trial in self.kept if trial.state == states.WAITING)
        trial.state = states.RUNNING
        return trial

    def tell(self, trial, value, state):
        trial.value, trial.state = value, state

    @property
    def best_trial(self):
        return min((t for t in self.kept if t.value is not None), key=lambda trial: trial.value)

    best_params = property(lambda self: self.best_trial.params)
    best_value = property(lambda self: self.best_trial.value)


def searched(launch, space: str = "optimizer.factor=interval(0.1,1)", **changed) -> None:
    settings = {"study_name": "a", "storage": "sqlite:///a.db", "direction": "minimize"}
    settings |= {"n_trials": 3, "n_jobs": 1, "sampler": {"seed": 1}, **changed}
    spaces = [OverridesParser.create().parse_override(space)]
    search.search(OmegaConf.create(settings), spaces, launch, lambda: False)


def test_a_search_goes_on_with_what_its_storage_keeps(tmp_path, monkeypatch, capfd):
    monkeypatch.setitem(sys.modules, "optuna", Optuna())
    tried, ends = [], ["done", "failed", None, "done", "done", "done"]

    def launch(jobs):
        ((setting,),) = jobs
        tried.append(setting)
        if not (status := ends.pop(0)):
            raise KeyboardInterrupt  # and nobody tells the study
        return [Outcome(setting, tmp_path / "runs" / "1", status, image=0.1 * len(tried))]

    with pytest.raises(KeyboardInterrupt):
        searched(launch)
    searched(launch)
    assert len(set(tried[:3])) == 3 and tried[3:] == tried[1:3], "in the folders that they began"
    searched(launch, n_trials=4)
    assert len(tried) == 6 and tried[5] not in tried[:5], "another seed"
    capfd.readouterr()
    searched(launch, n_trials=4)
    said = [
        "4 of 4 trials were done by earlier starts",
        f"best, by an earlier start: {tried[0]}: 0.1",
    ]
    assert capfd.readouterr().err.splitlines() == said and not ends
    assert (tmp_path / "runs" / "optimization_results.yaml").exists()


@pytest.mark.parametrize(
    "changed, told",
    [
        ({"n_jobs": -1}, "hydra.sweeper.n_jobs=-1: give a number, at least 1"),
        ({"n_trials": 0}, "hydra.sweeper.n_trials=0: give a number, at least 1"),
        ({"n_trials": "many"}, "hydra.sweeper.n_trials=many: give a number"),
        ({"storage": "none"}, "optuna: no such storage"),
    ],
)
def test_a_search_that_cannot_be_is_refused(monkeypatch, changed, told):
    monkeypatch.setitem(sys.modules, "optuna", Optuna())
    with pytest.raises(InputError, match=told):
        searched(lambda jobs: pytest.fail("was begun"), **changed)


def test_a_setting_of_one_unknown_can_be_searched():
    key = "jar.bsdf.base_color.data"
    typed = translate([f"scene.unknowns.{key}.lr=interval(0.005,0.1)"])
    (space,) = sweep.parsed(typed)
    for setting, rate in ((sweep._first(space), 0.005), (search.setting(space, 0.05), 0.05)):
        assert compose(["scene=pottery", setting]).scene.unknowns[key].lr == rate


def test_outcomes_count_as_what_a_search_minimises():
    done = Outcome("a", Path("a"), "done", image=0.25, parameter=0.5)
    photographs = Outcome("b", Path("b"), "skipped", image=0.25)
    failed = Outcome("c", Path("c"), "failed", 3, "not finite", image=0.25, parameter=0.5)
    interrupted = Outcome("d", Path("d"), "interrupted", 130)
    assert (done.value, photographs.value, failed.value) == (0.5, 0.25, None)
    assert exit_status([done, photographs]) == 0
    assert exit_status([done, interrupted, failed]) == 3
    assert exit_status([done, interrupted]) == 130


def test_a_job_that_never_began_does_not_block_the_corrected_one(tmp_path):
    """What it leaves is its settings and why it failed, and no run."""
    cfg = compose([*TINY, "optimizer.lr=0.5"])
    failed = Job("a", [], tmp_path, cfg)
    failed.record_failure(Report(2, "no such thing"), begun=False)
    corrected = Job("a", [], tmp_path, compose([*TINY, "optimizer.lr=0.1"]))
    assert corrected.found() == failed.found() == "failed"
    left = json.loads((tmp_path / "summary.json").read_text())
    assert not left["complete"] and left["process"]["pid"] == os.getpid()


def test_a_run_of_other_settings_is_told_with_what_a_sweep_takes(tmp_path):
    (tmp_path / "config.yaml").write_text("seed: 5")
    (tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(InputError, match="give another hydra.sweep.dir") as caught:
        Job("a", [], tmp_path, compose(TINY)).go(1)
    assert "hydra.run.dir" not in str(caught.value)
