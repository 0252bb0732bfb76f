"""A race: the same results as alone, ordinary records, and one line for what makes no sense."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import yaml
from problems_for_tests import configured
from processes import begun
from scenes_for_tests import TEXTURE, dictionary, problem, without_targets

from isas_cli import records
from isas_cli.cli import app, compare
from isas_cli.cli.sweeps.race import _contestants, _values
from isas_cli.config.compose import compose
from isas_cli.engine import race
from isas_cli.engine import workshop as workshop_module
from isas_cli.engine.loop import Hooks, Loop
from isas_cli.engine.workshop import Workshop
from isas_cli.runtime.errors import InputError, NumericalError
from isas_cli.unknowns.parameters import as_numpy

SMALL = ["scene=dodoco", "size=tiny", "estimator.batch=512", "evaluation.pixels=64"]
SMALL += ["frames.views=1", "frames.spp=1", "frames.snapshots=0", "target.spp=16"]
SMALL += ["evaluation.count=4", "effects=full"]
SETTINGS = ["scene=dodoco", "estimator.batch=256", "evaluation.pixels=64", "budget.iterations=24"]


@pytest.fixture
def no_page(monkeypatch):
    """Comparisons have tests of their own."""
    monkeypatch.setattr(compare, "main", lambda *_: 0)


@pytest.fixture
def one_thread(fixed_order):
    count = dr.thread_count()
    dr.set_thread_count(1)
    yield
    dr.set_thread_count(count)


def raced(folder: Path, *arguments: str) -> int:
    return app.main(["race", *SMALL, *arguments, f"hydra.run.dir={folder}"])


def loops(workshop: Workshop, *chosen: tuple[str, int]) -> list[Loop]:
    """Rehearsed loops of these samplers and seeds."""
    made = []
    for sampler, seed in chosen:
        chosen = f"sampler={sampler}", f"seed={seed}"
        made.append(workshop.loop(*configured(*SETTINGS, *chosen)))
        made[-1].rehearse()
    return made


def test_contestants_in_turn_end_with_the_bits_that_each_has_alone(one_thread):
    """Nothing that is shared holds state of a run: kernels, samplers, estimators, evaluators."""
    contestants = [("ours", 1), ("ours", 2), ("uniform", 1)]
    p = problem({TEXTURE: 0.5}, constant_target=None)
    together = loops(Workshop(p), *contestants)
    rows: list[list[dict]] = [[] for _ in together]
    hooks = [Hooks(evaluated=each.append) for each in rows]
    for loop, hook in zip(together, hooks):
        loop.begin(hook)
    ended = [False] * len(together)
    while not all(ended):
        for i, loop in enumerate(together):
            ended[i] = ended[i] or loop.advance(hooks[i], 1e-9)  # one iteration a turn
    ends = [as_numpy(loop.stepper.values[TEXTURE]) for loop in together]
    p.unknowns.write(together[0].stepper.values)
    assert len({end.tobytes() for end in ends}) == len(ends), "all differ from each other"
    for number, (sampler, seed) in [*enumerate(contestants)][1:]:
        alone = problem({TEXTURE: 0.5}, constant_target=None)
        loop = loops(Workshop(alone), (sampler, seed))[0]
        own: list[dict] = []
        loop.run(Hooks(evaluated=own.append))
        assert np.array_equal(as_numpy(loop.stepper.values[TEXTURE]), ends[number]), sampler
        for name in ("iteration", "image_rmse", "parameter_rmse", "paths", "gradient_norm"):
            expected = [row[name] for row in own]
            assert np.array_equal(expected, [row[name] for row in rows[number]], equal_nan=True)
        alone.unknowns.write(loop.stepper.values)


def test_equal_settings_share_and_different_ones_do_not():
    p = problem({TEXTURE: 0.5})
    workshop = Workshop(p)

    def made(*changes: str) -> Loop:
        return workshop.loop(*configured(*SETTINGS, *changes))

    a, b = made("sampler=ours", "seed=1"), made("sampler=ours", "seed=2", "optimizer.lr=0.5")
    assert a.sampler is b.sampler and a.estimator is b.estimator
    assert a.stepper is not b.stepper and a.evaluator is not b.evaluator
    assert a.evaluator is made("sampler=uniform", "seed=1").evaluator
    assert made("sampler=ours", "sampler.floor=0.1").sampler is not a.sampler
    assert made("estimator.batch=128").estimator is not a.estimator
    assert made("loss=l1").estimator is not a.estimator
    a.problem.warnings.append("of its estimator alone")
    assert not made("loss=l1").problem.warnings and not p.warnings


def test_a_race_goes_on_by_what_its_records_began_with(monkeypatch):
    """One that was killed before its record was whole says auto still."""
    settings = (("of none", None), ("of a record", SimpleNamespace()))
    entries = [SimpleNamespace(cfg=None, typed=typed, earlier=e) for typed, e in settings]

    def started(cfgs, typed):
        raise InputError(f"by that {typed}")

    monkeypatch.setattr(race, "started", started)
    with pytest.raises(InputError, match="by that of a record"):
        race.run(entries, 1.0, lambda: None)


def test_where_memory_is_full_a_race_says_how_it_goes_on(monkeypatch, tmp_path, no_page, capsys):
    def full(*unused):
        raise RuntimeError("jit_malloc(): out of memory!")

    monkeypatch.setattr(Loop, "advance", full)
    settings = "samplers=[uniform]", "report=false", "budget.iterations=2"
    assert raced(tmp_path / "r", *settings) == 2
    told = capsys.readouterr().err.splitlines()[-1]
    assert told.startswith(f"isas: memory is full: isas race resume={tmp_path / 'r'} goes on")


def test_a_turn_is_about_a_slice_long_and_the_order_rotates(monkeypatch, tmp_path, no_page):
    turns: list[tuple[str, float]] = []
    original = Loop.advance

    def advance(self, hooks, seconds):
        before = self.clock.seconds
        result = original(self, hooks, seconds)
        turns.append((type(self.sampler.settings).__name__, self.clock.seconds - before))
        return result

    monkeypatch.setattr(Loop, "advance", advance)
    both = "samplers=[uniform,gradient]", "report=false"
    assert raced(tmp_path / "r", *both, "budget.iterations=12", "slice=1e-6") == 0
    names = [name for name, _ in turns]
    assert names[:6] == ["Uniform", "Gradient", "Gradient", "Uniform", "Uniform", "Gradient"]
    assert all(names.count(name) == 12 for name in set(names)), "one iteration a turn"
    turns.clear()
    assert raced(tmp_path / "s", *both, "budget.iterations=400", "slice=0.03") == 0
    ends = {name: number for number, (name, _) in enumerate(turns)}  # the last may be shorter
    full = [seconds for number, (name, seconds) in enumerate(turns) if number != ends[name]]
    assert len(full) > 2 and all(seconds >= 0.03 for seconds in full)
    iterations = 400 * 2 / len(turns)
    assert iterations > 1.5, "several iterations a turn"


def test_a_race_leaves_ordinary_runs(tmp_path, monkeypatch, capsys, no_plots):
    def written(folder: Path) -> Path:
        """Pages have tests of their own."""
        (folder / "report.html").touch()
        return folder / "report.html"

    monkeypatch.setattr("isas_cli.report.write", written)
    folder = tmp_path / "a race"
    contestants = "contestants=[{sampler:uniform,optimizer.lr:0.05},{sampler:ours}]"
    arguments = contestants, "seed=[3,4]", "budget.iterations=5"
    assert raced(folder, *arguments) == 0
    out = capsys.readouterr().out.strip().splitlines()[-1]
    page = Path(out.removeprefix("report: "))
    assert page.is_file() and folder in page.parents
    planned = yaml.safe_load((folder / "race.yaml").read_text())["entries"]
    assert [p["folder"] for p in planned] == [
        *("uniform_optimizer.lr=0.05/seed3", "uniform_optimizer.lr=0.05/seed4"),
        *("ours/seed3", "ours/seed4"),
    ]
    for plan in planned:
        run = records.load(folder / plan["folder"])
        assert run.summary["status"] == "done" and run.summary["iterations"] == 5
        assert run.config["optimizer"]["lr"] == (0.05 if "uniform" in plan["label"] else 0.02)
        assert run.manifest["command"][:2] == ["isas", "race"]
        assert (run.folder / "report.html").is_file()
        assert (run.folder / "checkpoint" / "state.npz").is_file()
    hashes = {records.load(folder / p["folder"]).manifest["target_hash"] for p in planned}
    assert len(hashes) == 1
    assert raced(folder, *arguments) == 2
    assert "already holds a run" in capsys.readouterr().err


def test_one_that_fails_is_recorded_and_the_others_go_on(tmp_path, monkeypatch, capsys, no_page):
    original = Loop._check

    def check(self, nonfinite, touched):
        if type(self.sampler.settings).__name__ == "Relevant" and self.position.iteration > 2:
            raise NumericalError("made up")
        original(self, nonfinite, touched)

    monkeypatch.setattr(Loop, "_check", check)
    both = "samplers=[relevant,uniform]", "report=false"
    assert raced(tmp_path, *both, "budget.iterations=6") == 3
    assert "relevant seed 1: made up" in capsys.readouterr().err
    failed, other = tmp_path / "relevant/seed1", tmp_path / "uniform/seed1"
    assert records.load(failed).summary["status"] == "numerical failure"
    assert records.load(other).summary["status"] == "done"
    # Stopped while its pictures were made, or given more time: it does not go on.
    monkeypatch.setattr(Loop, "_check", original)
    for changes, budget in (([], 6), (["budget.iterations=8"], 8)):
        summary = records.load(failed).summary
        (failed / "summary.json").write_text(json.dumps({**summary, "complete": False}))
        assert app.main(["race", f"resume={tmp_path}", *changes]) == 3
        after = records.load(failed)
        assert after.complete and after.summary["status"] == "numerical failure"
        assert after.summary["iterations"] == summary["iterations"]
        assert after.config["budget"]["iterations"] == budget
    assert records.load(other).summary["iterations"] == 8


def test_an_interrupted_race_goes_on(tmp_path, capsys, no_page):
    folder = tmp_path / "race"
    command = ["race", *SMALL, "samplers=[uniform,gradient]", "report=false", "slice=0.05"]
    command += ["budget.iterations=4000", "evaluation.count=60", f"hydra.run.dir={folder}"]
    process, found = begun(tmp_path, *command, rows=3, runs=2)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=100)
    assert process.returncode == 130, errors
    runs = [folder / name / "seed1" for name in ("uniform", "gradient")]
    assert set(runs) == set(found)
    ends = [records.load(each).summary for each in runs]
    assert [end["status"] for end in ends] == ["interrupted"] * 2
    assert all(0 < end["iterations"] < 4000 for end in ends)
    more = max(end["iterations"] for end in ends) + 5
    assert app.main(["race", f"resume={folder}", f"budget.iterations={more}"]) == 0
    for each in runs:
        run = records.load(each)
        assert run.summary["status"] == "done" and run.summary["iterations"] == more
        assert run.manifest["resumed"][0]["command"][1:3] == ["race", f"resume={folder}"]
    # Killed between its manifest and its first checkpoint: it has no step yet, and begins.
    for name in ("history.csv", "summary.json", "checkpoint/state.npz"):
        (runs[0] / name).unlink()
    assert app.main(["race", f"resume={folder}", f"budget.iterations={more}"]) == 0
    assert records.load(runs[0]).summary["iterations"] == more
    capsys.readouterr()
    assert app.main(["race", f"resume={folder}"]) == 2
    assert "spent" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments, words",
    [
        ([], "samplers=[A,B]"),
        (["samplers=[uniform,urs]"], "did you mean 'ours'"),
        (["samplers=[ours,ours]"], "given twice"),
        (["samplers=[ours]", "seed=[1,1]"], "given twice"),
        (["samplers=[ours]", "seed=[a]"], "whole numbers"),
        (["samplers=[ours]", "sampler=uniform"], "samplers=[A,B]"),
        (["samplers=[ours]", "name=mine"], "a race names its runs itself"),
        (["samplers=[ours]", "slice=0"], "above 0"),
        (["samplers=[ours]", "optimizer.lt=1"], "did you mean 'optimizer.lr'"),
        (["contestants=[ours]"], "a list of differences"),
        (["contestants=[{sampler:ours,budget.seconds:3}]"], "share it"),
        (["contestants=[{+budget.iterations:9},{sampler:ours}]"], "share it"),
        (["contestants=[{sampler.floor:2}]"], "sampler.floor=2"),
        (["contestants=[{sampler:ours}]", "samplers=[uniform]"], "exclude each other"),
        (["contestants=[{optimizer.lr:0}]"], "above 0"),
        (["contestants=[{"], "cannot be read"),
        (["-m", "samplers=[ours]"], "no such flag"),
        (["resume=nowhere"], "holds no race"),
        (["samplers=[uniform,plateau]", "estimator=plateau"], "differ in the name alone"),
        (["samplers=[ours]", "hydra.run.dir="], "hydra.run.dir is empty"),
    ],
)
def test_bad_races_are_one_line_and_leave_nothing(arguments, words, refused):
    scene = [] if arguments and arguments[0].startswith("resume") else ["scene=dodoco"]
    refused(["race", *scene, *arguments], words)


def test_contestants_are_read_as_hydra_writes_or_as_json():
    expected = [{"sampler": "uniform", "optimizer.lr": 0.02}, {"sampler": "ours"}]
    assert _contestants("[{sampler:uniform,optimizer.lr:0.02},{sampler:ours}]") == expected
    assert _contestants(str(expected).replace("'", '"')) == expected
    assert _values("seed", "3") == [3] and _values("seed", "[1, 2]") == [1, 2]


def test_contestants_of_other_scenes_race_in_one_process(tmp_path, no_page):
    """Scenes with other materials: each pass must leave nothing behind that stops the other's."""
    contestants = "contestants=[{size:tiny},{scene:jumpydumpy}]"
    contestants = contestants.replace("}", ",sampler:relevant}")
    assert raced(tmp_path, contestants, "budget.iterations=3", "report=false") == 0
    planned = yaml.safe_load((tmp_path / "race.yaml").read_text())["entries"]
    runs = [records.load(tmp_path / plan["folder"]) for plan in planned]
    assert {run.summary["scene"] for run in runs} == {"dodoco", "jumpydumpy"}
    assert len({run.manifest["target_hash"] for run in runs}) == 2


def test_entries_share_a_problem_when_scene_and_target_are_equal(tmp_path):
    def entry(*changes: str) -> race.Entry:
        return race.Entry("x", compose([*SMALL, *changes]), tmp_path)

    assert entry("seed=1").problem_key == entry("seed=2", "sampler=uniform").problem_key
    assert entry("target.spp=5").problem_key != entry().problem_key
    assert entry("size=default").problem_key != entry().problem_key


def test_what_choices_are_told_of_a_problem_is_not_the_others_(monkeypatch):
    p = problem({TEXTURE: 0.5})
    (choices,) = configured(*SETTINGS)[:1]
    original = type(choices.estimator).check

    def check(self, problem, *more):
        problem.warnings.append("of its estimator alone")
        original(self, problem, *more)

    monkeypatch.setattr(type(choices.estimator), "check", check)
    choices.check_on(p)
    assert not p.warnings


def test_methods_with_other_priors_have_plans_of_their_own(monkeypatch):
    asked = []
    original = workshop_module.plan_of
    monkeypatch.setattr(
        workshop_module, "plan_of", lambda *given: asked.append(given[1].prior) or original(*given)
    )
    made = Workshop(problem({TEXTURE: 0.5}))
    for prior in ("none", "smoothness", "none"):
        made.loop(*configured(*SETTINGS, "sampler=uniform", f"prior={prior}"))
    assert len(asked) == 2 and asked[0] != asked[1]


def test_what_a_sampler_warns_of_is_said_of_its_own_runs():
    """Of surfaces beside media, which have no derivative in forward mode."""
    scene = dictionary(depth=2)
    scene["integrator"] = {"type": "prbvolpath", "max_depth": 2}
    p = without_targets(scene, {TEXTURE: 0.5})
    p.set_targets(dr.zeros(mi.Float, 3 * p.views.total), None, "test")
    made = Workshop(p)
    words = ["scene=pottery", "size=tiny", "effects=full", "estimator=two_path", "prior=none"]
    told = {}
    for name in ("progress", "uniform", "progress"):
        loop = made.loop(*configured(*words, f"sampler={name}"))
        told[name] = [each for each in loop.problem.warnings if "drawn uniformly" in each]
    assert len(told["progress"]) == 1 and told["uniform"] == [] == p.warnings
