"""Several races of one command: each whole, by whatever launcher, as if it had been held here."""

import json
import re
import signal
import subprocess
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest
import yaml
from processes import begun

from isas_cli import records
from isas_cli.cli.sweeps import race, races, worker
from isas_cli.cli.sweeps.job import Report
from isas_cli.runtime.backend import Backend
from isas_cli.runtime.errors import InputError

TINY = ["size=tiny", "estimator.batch=256", "evaluation.pixels=64", "evaluation.count=20"]
TINY += ["frames.views=0", "frames.snapshots=0", "target.spp=4", "effects=full", "report=false"]
TINY += ["threads=1", "samplers=uniform,relevant", "hydra.run.dir=all"]

pytestmark = pytest.mark.usefixtures("no_plots")


def begin(*arguments: str) -> tuple[subprocess.Popen, Path]:
    """`isas race` in a process of its own, and the folder of a run that goes on."""
    process, (folder, *_) = begun(Path(), "race", *TINY, *arguments, rows=2)
    return process, folder


def table(err: str) -> dict[str, str]:
    """Race → status, from the table at the end."""
    rows = [re.split(r"\s{2,}", line.strip()) for line in err.splitlines()]
    return {row[0]: row[1] for row in rows if len(row) == 3 and row[0] != "job"}


def runs() -> dict[str, records.Run]:
    return {str(p.parent): records.load(p.parent) for p in Path().rglob("manifest.json")}


def test_each_seed_is_a_race_and_what_is_done_is_skipped(isas, refused):
    command = [*TINY, "scene=dodoco", "seed=1,2", "budget.iterations=2"]
    status, out, err = isas("race", *command)
    assert status == 0, err
    assert "races: 2 of 2 to be held, with 4 runs\n" in err
    assert table(err) == {"dodoco/seed1": "done", "dodoco/seed2": "done"}
    assert out.count("dodoco: errors") == 1
    assert out.endswith("report: all/comparison/report.html\n")
    names = ("relevant", "uniform")
    held = [f"all/dodoco/seed{n}/{name}/seed{n}" for n in (1, 2) for name in names]
    found = runs()
    assert sorted(found) == held
    for n in (1, 2):
        folder = Path(f"all/dodoco/seed{n}")
        planned = yaml.safe_load((folder / "race.yaml").read_text())["entries"]
        assert [each["folder"] for each in planned] == [f"uniform/seed{n}", f"relevant/seed{n}"]
        assert (folder / "comparison/report.html").is_file()
        typed = found[f"{folder}/uniform/seed{n}"].manifest["command"]
        assert typed[:2] == ["isas", "race"] and f"hydra.run.dir={folder}" in typed

    # One that was killed before its record was whole.
    (Path(held[3]) / "summary.json").unlink()
    status, _, err = isas("race", *command)
    assert status == 0 and "races: 1 of 2 to be held, with 2 runs\n" in err
    assert list(table(err).values()) == ["skipped", "resumed"]
    after = runs()
    same = [after[name].manifest == found[name].manifest for name in held]
    assert same == [True] * 3 + [False]
    assert len(after[held[3]].manifest["resumed"]) == 1

    other = ["race", *command[:-1], "budget.iterations=3"]
    refused(other, "all/dodoco/seed1 holds a race with other settings")
    status, out, err = isas("race", "resume=all")
    assert status == 0 and list(table(err).values()) == ["skipped"] * 2
    assert out.endswith("report: all/comparison/report.html\n")


def test_what_never_began_is_told_on_the_page_of_the_others(isas, tmp_path):
    import synthetic_runs

    for seed in (1, 2):
        synthetic_runs.power_law(tmp_path / str(seed), seed=seed)
    race.compared([tmp_path / name for name in ("1", "2", "gone")], tmp_path, 0)
    told = f"left out, as they never began: {tmp_path / 'gone'}"
    assert told in (tmp_path / "comparison/report.html").read_text()


def test_races_that_go_on_replace_nothing(isas, monkeypatch):
    """`overwrite=true` was for what lay there when they began."""
    listed = [{"folder": "a", "arguments": ["scene=dodoco", "overwrite=true", "slice=1"]}]
    Path("all").mkdir()
    Path("all/races.yaml").write_text(yaml.safe_dump({"home": ".", "races": listed}))
    seen = []
    monkeypatch.setattr(races, "_job", lambda root, each, *_: seen.append(each["arguments"]))
    monkeypatch.setattr(races, "_held", lambda *_: 0)
    assert races.resume(Path("all"), {"slice": "2"}, []) == 0
    assert seen == [["scene=dodoco", "slice=2"]]


def test_ctrl_c_leaves_what_resume_goes_on_with(isas, monkeypatch):
    process, folder = begin("scene=dodoco", "seed=1,2", "budget.iterations=4000")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate()
    assert process.returncode == 130 and err.endswith("isas: interrupted\n")
    assert table(err) == {"dodoco/seed1": "interrupted", "dodoco/seed2": "not begun"}
    assert "report: all/comparison/report.html" in out
    first = {name: run.summary for name, run in runs().items()}
    assert len(first) == 2 and {end["status"] for end in first.values()} == {"interrupted"}
    monkeypatch.chdir("all")  # files and folders are found from elsewhere
    more = max(end["iterations"] for end in first.values()) + 2
    status, _, err = isas("race", "resume=.", f"budget.iterations={more}")
    assert status == 0, err
    # For those that an interruption leaves without.
    changes = yaml.safe_load(Path("races.yaml").read_text())["changes"]
    assert changes == [f"budget.iterations={more}"]
    assert isas("race", "resume=.")[0] == 0
    monkeypatch.chdir("..")
    ends = runs()
    assert len(ends) == 4 and {run.summary["iterations"] for run in ends.values()} == {more}
    assert ["resumed" in ends[name].manifest for name in first] == [True, True]


def test_ray_holds_a_race_again_whose_worker_is_lost(isas):
    pytest.importorskip("ray", reason="pip install '.[ray]'")
    ray = ["hydra/launcher=ray", "hydra.launcher.ray.init.num_cpus=2"]
    process, folder = begin(*ray, "scene=dodoco", "seed=1,2", "budget.iterations=600")
    job = psutil.Process(json.loads((folder / "manifest.json").read_text())["pid"])
    lost = job.parent()
    assert lost.name().startswith("ray::")
    lost.kill()
    out, err = process.communicate()
    assert process.returncode == 0, err
    assert sorted(table(err).values()) == ["done", "resumed"]
    ends = runs()
    assert len(ends) == 4
    assert {(run.summary["status"], run.summary["iterations"]) for run in ends.values()} == {
        ("done", 600)
    }
    again = ends[str(folder)].manifest
    assert [again, *again.get("resumed", [])][-1]["pid"] != job.pid
    assert "dodoco: errors" in out


@pytest.fixture
def job(tmp_path, monkeypatch) -> races.Race:
    monkeypatch.chdir(tmp_path)
    return races.planned([*TINY, "scene=dodoco", "budget.iterations=2"], "a")


def test_races_that_begin_together_have_folders_of_their_own():
    assert len({race._folder({}, "dodoco") for _ in range(3)}) == 3


def test_a_race_that_cannot_be_written_does_not_go_on(tmp_path, monkeypatch):
    entry = SimpleNamespace(earlier=True)
    listed = [{"label": "a", "folder": "a", "settings": []}]
    (tmp_path / "race.yaml").write_text(yaml.safe_dump({"entries": listed}))
    (tmp_path / "a").mkdir()
    (tmp_path / "a/history.csv").touch()
    monkeypatch.setattr(race.race, "continued", lambda *_: entry)
    assert race.unfinished(tmp_path, {}) == [entry]

    def readonly(dir):
        raise OSError("Read-only file system")

    monkeypatch.setattr(race.one, "tempfile", SimpleNamespace(TemporaryFile=readonly))
    with pytest.raises(InputError, match="Read-only file system; a run goes on where it is"):
        race.unfinished(tmp_path, {})


def test_a_race_of_another_machine_begins_anew(job, monkeypatch):
    assert job.go(1) == Report(0)
    entry = job.plan.entries[0]
    manifest = json.loads((entry.folder / "manifest.json").read_text())
    manifest["machine"]["device"] = "another"
    (entry.folder / "manifest.json").write_text(json.dumps(manifest))
    assert job.found() == "done"
    before = runs()
    (page := job.folder / "comparison/report.html").unlink()
    assert job.found() == "unfinished"
    assert job.go(1) == Report(0, resumed=True)  # only its comparison was left
    assert page.exists() and {n: run.manifest for n, run in runs().items()} == {
        n: run.manifest for n, run in before.items()
    }
    (entry.folder / "summary.json").unlink()
    assert job.found() == "unfinished"
    assert job.go(1) == Report(0)
    assert not any("resumed" in run.manifest for run in runs().values())
    assert job.found() == "done"


@pytest.mark.parametrize("began, by", [("llvm_ad_rgb", "llvm_ad_rgb"), ("cuda_ad_rgb", "auto")])
def test_a_race_goes_on_by_what_it_began_on(job, monkeypatch, began, by):
    """Also where a card has come since, or is missing for now."""
    assert job.go(1) == Report(0)
    entry = job.plan.entries[0]
    manifest = json.loads((entry.folder / "manifest.json").read_text())
    (entry.folder / "manifest.json").write_text(json.dumps({**manifest, "variant": began}))
    (entry.folder / "summary.json").unlink()
    asked = []

    def start(variant, threads):
        asked.append(variant)
        return Backend("another_ad_rgb", None, None, 1, "another")

    monkeypatch.setattr(races.backend, "start", start)
    told = f"began with variant={began}, and this machine takes another_ad_rgb"
    with pytest.raises(InputError, match=told):
        job.go(1)
    assert asked == [by] and job.found() == "unfinished"
    assert (entry.folder / "history.csv").exists()


def test_other_settings_are_another_race_and_other_threads_are_not(job):
    job.plan.begin()

    def found(*changes: str) -> str:
        own, overrides = race.options_of([*TINY, "scene=dodoco", "budget.iterations=2", *changes])
        return races.Race("a", [], job.folder, job.cfg, race.planned(own, overrides), {}).found()

    assert found() == found("variant=llvm_ad_rgb") == "unfinished"
    assert found("optimizer.lr=0.5") == found("seed=2") == "other"


def test_one_whose_worker_is_lost_is_told_and_ends_no_other(isas, monkeypatch):
    def attempt(job, command, threads, quiet, stop):
        if job.label.endswith("seed1"):
            raise OSError("no more processes")
        return Report(3, "a contestant failed numerically, the others went on")

    monkeypatch.setattr(worker, "run", attempt)
    status, _, err = isas("race", *TINY, "scene=dodoco", "seed=1,2", "budget.seconds=90")
    assert status == 1 and set(table(err).values()) == {"failed"}
    assert "with 4 runs: 0:06:00 billed, plus targets" in err
    lost = "its worker was lost: OSError: no more processes"
    assert f"isas: dodoco/seed1: {lost}" in err.splitlines()
    assert Path("all/dodoco/seed1/error.txt").read_text() == f"{lost}\n"


@pytest.mark.parametrize(
    "typed, places",
    [
        ("scene=dodoco seed=[1,2]", []),
        ("scene=dodoco seed=[1,2] hydra/launcher=joblib", ["dodoco"]),
        ("scene=dodoco,cup seed=1,2", ["dodoco/seed1", "dodoco/seed2", "cup/seed1", "cup/seed2"]),
        ("scene=cup seed=[1,2],[3]", ["cup/seed_1_2", "cup/seed_3"]),
        ("seed=range(1,3) scene=cup size=tiny,paper", None),
    ],
)
def test_every_value_is_a_race_with_every_other(typed, places):
    found = races.expanded(*race.options_of([*typed.split(), "~scene.method"]))
    if places is None:
        places = [f"cup/size={size}/seed{n}" for size in ("tiny", "paper") for n in (1, 2)]
    assert [place for place, _ in found] == places
    for _, arguments in found:
        assert "~scene.method" in arguments and arguments[-1].startswith("seed=")


@pytest.mark.parametrize(
    "typed, words",
    [
        ("scene=dodoco,potery", "did you mean 'pottery'"),
        ("scene=dodoco seed=1,a", "whole numbers"),
        ("scene=dodoco,cup samplers=uniform,urs", "did you mean 'ours'"),
        ("scene=dodoco optimizer.lr=interval(0,1)", "hydra/sweeper=optuna"),
        ("scene=dodoco hydra/sweeper=optuna", "of Hydra's settings a race takes"),
        ("scene=dodoco seed=1,2 hydra.sweep.dir=x", "of Hydra's settings a race takes"),
        ("scene=dodoco hydra/launcher=rai", "hydra/launcher=rai: no such hydra/launcher"),
        ("scene=dodoco hydra/launcher=ray hydra.launcher.rai=1", "hydra.launcher.rai: no such"),
        ("scene=dodoco seed=1,2 hydra.run.dir=", "hydra.run.dir is empty"),
        ("scene=dodoco seed=1,2 slice=0", "above 0"),
        ("scene=dodoco seed=1,2 budget.seconds=-1", "budget"),
    ],
)
def test_what_cannot_be_held_is_one_line_and_leaves_nothing(refused, monkeypatch, typed, words):
    monkeypatch.setattr("isas_cli.cli.sweeps.launchers._installed", lambda package: True)
    samplers = [] if "samplers=" in typed else ["samplers=[uniform]"]
    refused(["race", *typed.split(), *samplers], words)


@pytest.mark.parametrize("text", ["", "races: [1]", "races: [{folder: x}]", "races: [{folder: 1"])
def test_a_damaged_list_of_races_is_refused(refused, text):
    Path("all").mkdir()
    Path("all/races.yaml").write_text(text)
    err = refused(["race", "resume=all"])
    assert err == "isas: all holds no race: races.yaml is missing or damaged\n"


def test_names_of_folders_are_as_long_as_disks_take():
    labels = [f"ours scene.unknowns={{{'x' * 300}: {end}}}" for end in (1, 2)]
    names = [race.slug(label) for label in labels]
    assert len({*names}) == 2 and all(len(name) <= 120 for name in names)
    assert race.slug("ours optimizer.lr=0.1") == "ours_optimizer.lr=0.1"
