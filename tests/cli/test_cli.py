"""The command line: what is refused and how, and how a run ends."""

import errno
import signal
from pathlib import Path

import pytest
from processes import HANGUP, begun, started

from isas_cli import records
from isas_cli.cli.sweeps import race
from isas_cli.config.compose import compose, translate
from isas_cli.runtime.errors import InputError, IsasError

TINY = ["scene=pottery", "size=tiny", "effects=full", "budget.iterations=2", "target.spp=4"]
TINY += ["frames.spp=2", "estimator.batch=256"]


# What is typed after `isas run` → parts of the answer.
BAD_SETTINGS = {
    "": ["scene=NAME", "pottery"],
    "scene=potery": ["scene=potery", "did you mean 'pottery'?"],
    "scene=": ["valid: bowl, catcake"],
    "scene=[pottery,dodoco]": ["one name"],
    "pottery": ["'pottery'", "KEY=VALUE"],
    "scene=pottery sampler=our": ["did you mean 'ours'?"],
    "scene=pottery loss=l3": ["did you mean 'l2'?"],
    "scene=pottery size=tny": ["did you mean 'tiny'?", "default, paper"],
    "scene=pottery sead=3": ["sead", "did you mean 'seed'?"],
    "scene=pottery +sead=3": ["did you mean 'seed'?"],
    "scene=pottery ~seed": ["~seed", "cannot be removed"],
    "scene=cup ~scene.unknowns.cup.angel": ["no such unknown", "did you mean 'cup.angle'?"],
    "scene=pottery optimizer.lrr=3": ["did you mean 'optimizer.lr'?", "optimizer.schedule"],
    "scene=pottery optimiser.lr=3": ["did you mean 'optimizer'?"],
    "scene=pottery sampler.flor=0.1": ["did you mean 'sampler.floor'?"],
    "scene=pottery sampler=uniform sampler.refresh=3": ["sampler.refresh: no such setting"],
    "scene=pottery sampler=uniform +sampler.refresh=3": ["sampler.refresh: no such setting"],
    "scene=pottery sampler.name=x": ["sampler=NAME"],
    "scene=pottery seed=abc": ["seed=abc"],
    "scene=pottery seed=1,2": ["seed=1,2", "-m"],
    "scene=pottery seed=-1": ["seed=-1: at least 0"],
    "scene=pottery optimizer.lr=abc": ["optimizer.lr=abc", "Float"],
    "scene=pottery optimizer.lr=-1": ["optimizer.lr=-1.0", "above 0"],
    "scene=pottery optimizer.beta_1=1": ["optimizer.beta_1=1.0", "[0, 0.999999]"],
    "scene=pottery optimizer.final=0": ["optimizer.final=0.0"],
    "scene=pottery optimizer.schedule=cosin": ["did you mean 'cosine'?"],
    "scene=pottery sampler.floor=2": ["sampler.floor=2.0", "[0, 1]"],
    "scene=pottery sampler.floor=abc": ["sampler.floor", "abc"],
    "scene=pottery sampler.refresh=0.5": ["sampler.refresh", "0.5"],
    "scene=pottery sampler.stage1.denoise=foo": ["none, fast, balanced, high"],
    "scene=pottery sampler=joint sampler.stage1.probes=0": ["sampler.stage1.probes=0: at least 1"],
    "scene=pottery loss=relative_l2 loss.epsilon=0": ["loss.epsilon=0.0"],
    "scene=pottery target.spp=0": ["target.spp=0: at least 1"],
    "scene=pottery evaluation.spp=3": ["evaluation.spp=3", "even"],
    "scene=pottery evaluation.count=0": ["evaluation.count=0: at least 1"],
    "scene=pottery estimator.batch=0": ["estimator.batch=0: at least 1"],
    "scene=pottery estimator.batch=9999999999": ["estimator.batch=9999999999: at most"],
    "scene=pottery frames.views=-1": ["frames.views=-1: at least 0"],
    "scene=pottery threads=-1": ["threads=-1: at least 0"],
    "scene=pottery budget.seconds=0": ["budget.seconds=0.0", "above 0"],
    "scene=pottery budget.iterations=0": ["budget.iterations=0"],
    "scene=pottery budget.iterations=2.5": ["budget.iterations=2.5"],
    "scene=pottery budget.paths=0": ["budget.paths=0.0"],
    "scene=pottery overwrite=maybe": ["overwrite=maybe"],
    "scene=pottery variant=scalar_rgb": ["variant=scalar_rgb", "llvm_ad_rgb"],
    "scene=pottery variant=lvm_ad_rgb": ["did you mean 'llvm_ad_rgb'?"],
    "scene=pottery scene.arguments.views=0": ["scene.arguments.views=0", "at least 1"],
    "scene=pottery scene.arguments.texture=abc": ["scene.arguments.texture=abc", "whole number"],
    "scene=pottery scene.arguments.foo=1": ["scene.arguments.views"],
    "scene=pottery +scene.arguments.textur=1": ["no such argument", "did you mean 'texture'?"],
    "scene=file scene.path=a.xml +scene.arguments.x=1": ["scene.arguments.x=1", "no builder"],
    "scene=pottery scene.builder=foo.bar": ["scene.builder=foo.bar"],
    "scene=pottery scene.path=a.xml": ["scene.path=a.xml", "scene=file"],
    "scene=pottery scene.max_depth=-2": ["scene.max_depth=-2: at least -1"],
    "scene=pottery effects=ful": ["effects=ful", "did you mean 'full'?"],
    "scene=pottery effects.max_depth=0": ["effects.max_depth=0: at least 1"],
    "scene=pottery profile=true effects.finish=0.3": ["profile=true", "effects.finish"],
    "scene=pottery scene.masks=[a.png]": ["scene.masks", "scene.targets"],
    "scene=pottery scene.targets=a.png": ["scene.targets=a.png", "list"],
    "scene=pottery scene.targets=[a.png] target.spp=4": ["target"],
    'scene=pottery scene.unknowns={"jar":3}': ["scene.unknowns", "start"],
    'scene=pottery scene.unknowns={"jar":{"strt":3}}': ["did you mean 'start'?"],
    'scene=pottery scene.unknowns={"jar":{"start":3}': ["scene.unknowns", "JSON"],
    'scene=pottery scene.unknowns={"a":{"start":1},"a":{"lr":2}}': ["'a' is given twice"],
    "scene=pottery filter=none": ["filter: no such setting; say optimizer.filter=NAME"],
    "scene=pottery size=": ["size="],
    'scene=pottery scene.unknowns={"jar":{"lr":"x"}}': ["scene.unknowns['jar'].lr: ", "Float"],
    "scene=pottery scene.unknowns={}": ["scene.unknowns={}"],
    "scene=pottery name=a=b": ["name=a=b", "quotes"],
    "scene=pottery hydra.run.dir=": ["hydra.run.dir"],
    "scene=pottery hydra/launcher=joblib": ["hydra/launcher=joblib: is for several runs: add -m"],
    "scene=pottery hydra/sweeper=optuna": ["hydra/sweeper=optuna: is for several runs"],
    "scene=pottery hydra.sweep.dir=x": ["hydra.sweep.dir=x: is for several runs: add -m"],
    "scene=pottery hydra.job.chdir=true": ["hydra.job.chdir: has no effect"],
    "scene=pottery +hydra.job.env_set.A=1": ["hydra.job.env_set: has no effect"],
    "scene=photos photos.path=chessboard photos.sky=9 photos.environment=a.exr": ["photos.sky=9"],
    "scene=photos photos.path=chessboard photos.lenses=each": ["photos.lenses=each", "photos.lens"],
    "scene=photos photos.path=chessboard photos.mesh=a.obj photos.voxels=99": ["photos.voxels=99"],
    "scene=photos photos.path=chessboard photos.turn=9": ["photos.turn=9", "photos.environment"],
    "scene=file": ["scene.path"],
    "scene=file size=tiny scene.path=a.xml": ["size=tiny", "no sizes"],
    "--foo scene=pottery": ["--foo", "isas run --help"],
    "--cfg foo scene=pottery": ["--cfg", "job"],
    "--multi scene=pottery seed=1,2": ["--multi", "isas run --help"],
}


@pytest.mark.parametrize("typed", BAD_SETTINGS)
def test_bad_settings_are_refused_in_one_line(refused, typed):
    refused(["run", *typed.split()], *BAD_SETTINGS[typed])


@pytest.mark.parametrize("command", ["effects", "unknowns", "variance"])
def test_what_is_of_several_runs_is_refused_by_commands_that_make_none(refused, command):
    told = "hydra/launcher=joblib: is for several runs: leave it out"
    refused([command, "scene=pottery", "hydra/launcher=joblib"], told)


def test_a_home_folder_is_where_the_shell_leaves_it(isas, tmp_path, monkeypatch):
    """Behind `hydra.run.dir=` no shell puts it in."""
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    cfg = compose(translate(["scene=pottery", "hydra.run.dir=~/a"]), hydra=True)
    assert cfg.hydra.run.dir == f"{home}/a"
    assert race.folder_of("~/a") == home / "a"
    status, _, err = isas("report", "~/a")
    assert status == 2 and f"{home}/a" in err


def test_a_folder_may_refer_to_the_environment_and_the_time(monkeypatch):
    monkeypatch.setenv("OUT", "/out")
    assert race.folder_of("'${oc.env:OUT}/a b'") == Path("/out/a b")
    assert str(race.folder_of("${now:%Y}")).isdigit()
    with pytest.raises(InputError, match=r"hydra.run.dir=\$\{oc.env:NO_SUCH\}.*not found"):
        race.folder_of("${oc.env:NO_SUCH}")


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "resume=~nobody-such/a"],
        ["race", "resume=~nobody-such/a"],
        ["photos", "~nobody-such/a=b"],
        ["photos", "~nobody-such/a", "output=~nobody-such/b.png"],
        ["run", "scene=pottery", "hydra.searchpath=[~nobody-such/a]"],
    ],
)
def test_the_home_of_no_user_is_one_line(refused, arguments):
    refused(arguments)


def test_the_home_of_no_user_is_a_folder_as_a_shell_has_it():
    assert race.folder_of("~nobody-such/a") == Path("~nobody-such/a")
    (typed,) = translate(["scene.path=~nobody-such/a.xml,b.xml"])
    assert "~nobody-such/a.xml" in typed


@pytest.mark.skipif(bool(list(Path("/dev").glob("nvidia[0-9]*"))), reason="there may be a GPU")
def test_a_variant_that_cannot_run_here_is_refused(refused):
    refused(["run", "scene=pottery", "variant=cuda_ad_rgb"], "variant=cuda_ad_rgb", "auto")


@pytest.mark.parametrize(
    "arguments, expected",
    [
        (
            ["foo"],
            ["foo: no such command", "run, race, variance, effects, unknowns, photos, compare"],
        ),
        (["repor", "x"], ["did you mean 'report'?"]),
        (["report"], ["folder"]),
        (["report", "nowhere"], ["nowhere"]),
        (["--foo"], ["--foo"]),
    ],
)
def test_bad_commands_are_refused_in_one_line(refused, arguments, expected):
    refused(arguments, *expected)


def test_an_unusable_output_folder_is_refused(refused, tmp_path_factory):
    file = tmp_path_factory.mktemp("elsewhere") / "file"
    file.write_text("mine")
    refused(["run", *TINY, f"hydra.run.dir={file}/run"], f"{file}/run", "hydra.run.dir=DIR")
    refused(["run", *TINY, f"hydra.run.dir={file}"], str(file))
    assert file.read_text() == "mine"


def test_errors_found_late_leave_an_earlier_run_alone(refused, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    (folder / "manifest.json").write_text("{}")
    arguments = ["run", *TINY, "sampler=uniform", f"hydra.run.dir={folder}"]
    refused(arguments, "already holds a run", "overwrite=true")
    unknown = 'scene.unknowns={"jar.bsdf.base_colour": {"start": 0.5}}'
    refused([*arguments, "overwrite=true", unknown], "'jar.bsdf.base_colour'")
    assert (folder / "manifest.json").read_text() == "{}"


def test_a_run_leaves_its_record_where_it_was_asked_to(isas):
    status, out, err = isas("run", *TINY, "sampler=uniform", "hydra.run.dir=a dir, with=all")
    assert status == 0, err
    assert out == "report: a dir, with=all/report.html\n"
    run = records.load(Path("a dir, with=all"))
    assert run.summary["status"] == "done"
    assert run.history["iteration"].tolist()[-1] == 2
    assert run.manifest["command"][:3] == ["isas", "run", "scene=pottery"]
    assert [path.name for path in Path.cwd().iterdir()] == ["a dir, with=all"]
    assert "Traceback" not in err
    status, out, _ = isas("report", "a dir, with=all")
    assert (status, out) == (0, "a dir, with=all/report.html\n")


def test_a_sweep_with_an_unknown_name_runs_nothing(refused):
    refused(["run", *TINY, "-m", "sampler=uniform,our"], "did you mean 'ours'?")


def test_cfg_prints_the_configuration_and_runs_nothing(isas):
    status, out, _ = isas("run", *TINY, "--cfg", "job")
    assert status == 0
    assert "name: pottery" in out and "iterations: 2" in out
    assert list(Path.cwd().iterdir()) == []


def test_helps_and_lists(isas):
    for arguments, expected in (
        ([], "COMMAND"),
        (["run", "--help"], "isas run scene=pottery"),
        (["run", "scene=pottery", "-h"], "usage: isas run"),
        (["scenes"], "jar.bsdf.base_color.data"),
        (["scenes"], "caustic_failure"),
    ):
        status, out, err = isas(*arguments)
        assert (status, err) == (0, "") and expected in out


def test_what_fails_at_the_end_costs_no_result(isas, monkeypatch):
    def full(*unused):
        raise IsasError("x.png: cannot be written: No space left on device")

    import isas_cli.engine.pictures  # noqa: F401  (so that it can be patched)

    released = []
    monkeypatch.setattr("isas_cli.records.RunWriter.release", lambda self: released.append(self))
    monkeypatch.setattr("isas_cli.engine.pictures.Pictures.density", full)
    status, out, err = isas("run", *TINY, "sampler=gradient", "hydra.run.dir=r")
    assert (status, out) == (1, "")
    assert err.splitlines()[-1] == "isas: x.png: cannot be written: No space left on device"
    assert len(released) == 1, "a program may go on with it"
    assert records.load(Path("r")).summary["status"] == "done"
    arrays, state = records.load_checkpoint(Path("r"))
    assert arrays and state["iteration"] == 2


def test_a_terminal_that_is_gone_costs_nothing(isas, monkeypatch):
    def gone(*words, **how):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("isas_cli.engine.experiment.print", gone, raising=False)
    status, _, err = isas("run", *TINY, "sampler=uniform", "report=false", "hydra.run.dir=r")
    assert status == 0 and "defect" not in err


def test_a_defect_keeps_its_traceback(isas, monkeypatch):
    monkeypatch.setattr("isas_cli.cli.scenes.main", lambda: 1 / 0)
    status, _, err = isas("scenes")
    assert status == 1
    assert "ZeroDivisionError" in err and "defect" in err.splitlines()[-1]


def test_a_full_memory_is_no_defect(isas, monkeypatch):
    def full():
        raise RuntimeError("jit_malloc(): out of memory! Could not allocate 1 bytes")

    monkeypatch.setattr("isas_cli.cli.scenes.main", full)
    status, _, err = isas("scenes")
    assert status == 2 and err.startswith("isas: memory is full: lower estimator.batch")


def test_where_memory_is_full_a_run_with_a_record_goes_on_later(isas, monkeypatch):
    """What a new run may lower it keeps."""

    def full(*unused):
        raise RuntimeError("cuda_check(): API error 0002 (CUDA_ERROR_OUT_OF_MEMORY)")

    assert isas("run", *TINY, "report=false", "hydra.run.dir=r")[0] == 0
    told = "isas: memory is full: isas run {} goes on from the last checkpoint when there is room"
    with monkeypatch.context() as patch:
        patch.setattr("isas_cli.engine.loop.Loop.rehearse", full)
        status, _, err = isas("run", "resume=r", "budget.iterations=3")
        assert status == 2 and err.splitlines()[-1] == told.format("resume=r")
        _, _, err = isas("run", *TINY, "hydra.run.dir=a b")
        assert "memory is full: lower estimator.batch" in err and not Path("a b").exists()
    monkeypatch.setattr("isas_cli.engine.loop.Loop.run", full)
    status, out, err = isas("run", *TINY, "hydra.run.dir=a b")
    assert (status, out) == (2, "") and err.splitlines()[-1] == told.format("'resume=a b'")
    assert records.load_checkpoint(Path("a b"))


LONG = ["run", *TINY[:3], "sampler=uniform", "target.spp=4", "frames.spp=2", "hydra.run.dir=r"]


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow), HANGUP]
)
def test_an_interrupted_loop_finishes_its_record(tmp_path, number):
    process, _ = begun(tmp_path, *LONG, rows=0)
    process.send_signal(number)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "Traceback" not in err and "finishing the record" in err
    assert out == "report: r/report.html\n"
    run = records.load(tmp_path / "r")
    assert run.summary["status"] == "interrupted"
    assert run.summary["iterations"] == run.history["iteration"].iloc[-1]
    assert records.load_checkpoint(tmp_path / "r")[1]["iteration"] == run.summary["iterations"]


def test_an_interruption_before_the_loop_leaves_nothing(tmp_path):
    process = started(tmp_path, *LONG, "target.spp=1000000")
    while "targets" not in process.stderr.readline():
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert (out, err.splitlines()[-1]) == ("", "isas: interrupted")
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_a_closed_pipe_is_no_defect(tmp_path):
    process = started(tmp_path, "scenes")
    process.stdout.close()
    assert process.wait(timeout=60) in (0, 1)
    assert "defect" not in process.stderr.read()
