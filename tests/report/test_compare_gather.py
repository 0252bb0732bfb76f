"""Which runs are compared, what their methods are called, and what is said of the others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import synthetic_runs as synthetic
from disk import lock

from isas_cli.records.files import OWN_UNIT, SCHEMA_VERSION
from isas_cli.report.compare import content, labels
from isas_cli.report.compare.gather import Method, by_scene, gather
from isas_cli.runtime.errors import InputError

SECONDS, ERROR = [0, 1, 2], [1.0, 0.5, 0.25]


def run(folder: Path, **more) -> Path:
    return synthetic.write(folder, SECONDS, ERROR, ERROR, **more)


def found(*folders: Path, baseline: str | None = None) -> list[tuple[str, str, list[int]]]:
    """Scene, label and seeds of all methods, in order."""
    methods, _, _ = gather(list(folders), baseline)
    return [(m.scene, m.label, [r.config["seed"] for r in m.runs]) for m in methods]


def warnings(*folders: Path) -> list[str]:
    return gather(list(folders), None)[2]


def test_runs_that_differ_in_their_seed_are_one_method_wherever_they_lie(tmp_path):
    run(tmp_path / "race" / "ours" / "seed2", seed=2)
    run(tmp_path / "ours-1", seed=1)
    run(tmp_path / "uniform", sampler="uniform", seed=7)
    assert found(tmp_path) == [("pottery", "uniform", [7]), ("pottery", "ours", [1, 2])]


@pytest.mark.parametrize(
    "key",
    ["name", "overwrite", "threads", "variant", "tracker", "frames.views", "evaluation.count"]
    + ["scene.description", "scene.sizes"],
)
def test_what_does_not_change_the_method_does_not_divide_it(tmp_path, key):
    run(tmp_path / "1", seed=1, settings={key: "one"})
    run(tmp_path / "2", seed=2, settings={key: "two"})
    assert found(tmp_path) == [("pottery", "ours", [1, 2])]


@pytest.mark.parametrize(
    "key, value, label",
    [
        ("optimizer.lr", 0.01, "optimizer.lr=0.01"),
        ("budget.seconds", 30, "budget.seconds=30"),
        ("estimator.batch", 1024, "estimator.batch=1024"),
        ("scene.unknowns.lr", 0.5, f"scene.unknowns.{synthetic.KEY}.lr=0.5"),
        ("scene.unknowns.blur", {"end": 1}, f"scene.unknowns.{synthetic.KEY}.blur.end=1"),
        ("scene.unknowns.range", [0, 2], f"scene.unknowns.{synthetic.KEY}.range=[0, 2]"),
        ("sampler.floor", None, "sampler.floor=null"),
    ],
)
def test_any_other_difference_makes_another_method_and_its_label_says_how(
    tmp_path, key, value, label
):
    run(tmp_path / "1")
    run(tmp_path / "2", settings={key: value})
    assert f"ours {label}" in [label for _, label, _ in found(tmp_path)]
    assert len(found(tmp_path)) == 2


def test_a_number_is_the_same_however_it_is_written(tmp_path):
    run(tmp_path / "1", seed=1, settings={"budget.seconds": 60})
    run(tmp_path / "2", seed=2, settings={"budget.seconds": 60.0})
    assert found(tmp_path) == [("pottery", "ours", [1, 2])]


@pytest.mark.parametrize(
    "settings, expected",
    [
        ([{"sampler.name": "ours", "a.b": "1"}], ["ours"]),
        ([{"sampler": "ours"}, {"sampler": "uniform"}], ["ours", "uniform"]),
        (
            [
                {"sampler.name": "uniform", "optimizer.lr": "0.02"},
                {"sampler.name": "ours", "sampler.floor": "0.1", "optimizer.lr": "0.01"},
                {"sampler.name": "ours", "sampler.floor": "0.2", "optimizer.lr": "0.01"},
            ],
            [
                "uniform optimizer.lr=0.02",
                "ours optimizer.lr=0.01 sampler.floor=0.1",
                "ours optimizer.lr=0.01 sampler.floor=0.2",
            ],
        ),
        (
            [
                {"sampler.name": "ours", "loss.name": "l1", "loss._target_": "L1"},
                {"sampler.name": "ours", "loss.name": "l2", "loss._target_": "L2"},
                {"sampler.name": "ours", "loss.name": "l2", "loss._target_": "L2", "x.y": "3"},
            ],
            ["ours loss=l1 x.y=unset", "ours loss=l2 x.y=unset", "ours loss=l2 x.y=3"],
        ),
        (
            [
                {"sampler.name": "uniform", "sampler._target_": "a.Uniform"},
                {"sampler.name": "ours", "sampler._target_": "a.Ours"},
                {"sampler.name": "ours", "sampler._target_": "mine.Ours"},
            ],
            ["uniform", "ours sampler._target_=a.Ours", "ours sampler._target_=mine.Ours"],
        ),
    ],
)
def test_labels_are_short_and_tell_all_methods_apart(settings, expected):
    assert labels.methods(settings) == expected


@pytest.mark.parametrize(
    "change, names",
    [
        (
            {"settings": {"size": "default", "scene.arguments.views": 16}},
            ["pottery size=default", "pottery size=tiny"],
        ),
        (
            {"settings": {"target.seed": 1}},
            ["pottery target.seed=0", "pottery target.seed=1"],
        ),
        ({"settings": {}}, ["pottery target_hash=other", "pottery target_hash=tttttttt"]),
    ],
)
def test_runs_of_other_scenes_or_targets_are_kept_apart(tmp_path, change, names):
    run(tmp_path / "1", sampler="uniform")
    run(tmp_path / "2", manifest={"target_hash": "other"}, **change)
    assert sorted({scene for scene, _, _ in found(tmp_path)}) == names
    assert any("compared apart" in line for line in warnings(tmp_path))


@pytest.mark.parametrize("key", ["exposure", "refine", "lens", "roughness"])
def test_runs_of_other_models_of_the_same_photographs_are_kept_apart(tmp_path, key):
    """No hash of the scene covers what is unknown in it; where its files lie, it does."""
    run(tmp_path / "1", settings={f"scene.photos.{key}": "one", "scene.photos.path": "a"})
    run(tmp_path / "2", settings={f"scene.photos.{key}": "two", "scene.photos.path": "b"})
    assert len({scene for scene, _, _ in found(tmp_path)}) == 2
    run(tmp_path / "3", settings={f"scene.photos.{key}": "one", "scene.photos.path": "c"}, seed=2)
    assert [seeds for *_, seeds in found(tmp_path)] == [[1, 2], [1]]


def test_runs_of_other_poses_are_kept_apart(tmp_path):
    run(tmp_path / "1", settings={"scene.poses.turn.period": 360})
    run(tmp_path / "2", settings={"scene.poses.turn.period": 90})
    assert len({scene for scene, _, _ in found(tmp_path)}) == 2


def test_runs_that_start_elsewhere_are_kept_apart(tmp_path):
    run(tmp_path / "1", sampler="uniform")
    run(tmp_path / "2", settings={"scene.unknowns.start": 0.9})
    key = f"scene.unknowns.{synthetic.KEY}.start"
    assert {s for s, _, _ in found(tmp_path)} == {f"pottery {key}=0.5", f"pottery {key}=0.9"}


def test_the_same_content_is_the_same_scene_however_it_was_configured(tmp_path):
    run(tmp_path / "1", seed=1, settings={"scene.path": "a.xml"})
    run(tmp_path / "2", seed=2, settings={"scene.path": "copy/a.xml"})
    assert found(tmp_path) == [("pottery", "ours", [1, 2])]


def test_of_two_runs_with_one_seed_the_later_is_used_and_the_other_named(tmp_path):
    run(tmp_path / "a", manifest={"started": "2026-01-02T00:00:00+00:00"})
    run(tmp_path / "b", manifest={"started": "2026-01-01T00:00:00+00:00"})
    run(
        tmp_path / "c",
        manifest={"started": "2026-01-03T00:00:00+00:00"},
        status="interrupted",
    )
    (method,), _, lines = gather([tmp_path], None)
    assert [r.folder.name for r in method.runs] == ["a"]
    for name in "bc":
        assert any(line.startswith(f"left out: {tmp_path / name}:") for line in lines)


def unreadable(folder: Path) -> None:
    (run(folder) / "history.csv").write_text("iteration,seconds\n1,x\n")


def older(folder: Path) -> None:
    path = run(folder) / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "schema": 99}))


def without_columns(folder: Path) -> None:
    (run(folder) / "history.csv").write_text(
        "iteration,seconds,paths,nonfinite\n0,0,0,0\n1,1,1,0\n"
    )


def without_its_start(folder: Path) -> None:
    path = run(folder) / "history.csv"
    columns, _, *rows = path.read_text().splitlines(keepends=True)
    path.write_text("".join([columns, *rows]))


def failed_before_its_record(folder: Path) -> None:
    run(folder, status="failed", summary={"error": "no such scene"})
    (folder / "manifest.json").unlink()


@pytest.mark.parametrize(
    "spoil, reason",
    [
        (unreadable, "history.csv: cannot be read"),
        (older, "schema version 99"),
        (without_columns, "no column image_rmse, parameter_rmse"),
        (without_its_start, "history.csv does not begin at the start"),
        (failed_before_its_record, "failed: no such scene"),
        (lambda f: run(f, status="failed", summary={"error": "bo\nom"}), "failed: bo om"),
        (lambda f: synthetic.write(f, [0], [1.0]), "1 evaluations: two are needed"),
        (lambda f: synthetic.write(f, [0, 2, 1], ERROR), "seconds in history.csv do not grow"),
        (lambda f: synthetic.write(f, SECONDS, [0.0] * 3), "no error above 0 at its start"),
        (lambda f: (run(f) / "config.yaml").unlink(), "no config.yaml"),
        (lambda f: (run(f) / "manifest.json").unlink(), "no manifest.json"),
    ],
)
def test_a_run_that_cannot_be_used_is_left_out_with_one_line(tmp_path, spoil, reason):
    run(tmp_path / "good", seed=1)
    spoil(tmp_path / "bad")
    (method,), _, lines = gather([tmp_path], None)
    assert [r.folder.name for r in method.runs] == ["good"]
    (line,) = lines
    assert line.startswith("left out: ") and str(tmp_path / "bad") in line and reason in line
    assert "\n" not in line
    with pytest.raises(InputError, match="no run that can be compared"):
        gather([tmp_path / "bad"], None)


@pytest.mark.parametrize("status", ["interrupted", "numerical failure", None])
def test_a_run_that_ended_early_is_used_as_far_as_it_got(tmp_path, status):
    run(tmp_path / "1", status=status)
    (method,), _, (line,) = gather([tmp_path], None)
    assert len(method.runs[0].history) == 3
    assert str(tmp_path / "1") in line and "used up to 2 s" in line
    assert (status or "killed") in line


def test_the_runs_own_warnings_are_told_once_for_all_seeds(tmp_path):
    for seed in (1, 2):
        run(tmp_path / str(seed), seed=seed, summary={"warnings": ["l1 is biased"]})
    assert warnings(tmp_path) == ["pottery, ours, seed 1, 2: l1 is biased"]


def test_notes_without_which_figures_mislead_are_told(tmp_path):
    notes = ["optimizer.lr=0.1 has no effect: …", "ends at 0, which is no perfect fit", "a note"]
    run(tmp_path / "1", summary={"notes": notes})
    assert warnings(tmp_path) == [f"pottery, ours, seed 1: {note}" for note in notes[:2]]


def test_different_machines_are_warned_of(tmp_path):
    run(tmp_path / "1", seed=1)
    run(tmp_path / "2", seed=2, manifest={"threads": 64})
    (line,) = warnings(tmp_path)
    assert "different machines" in line and "64 threads" in line


def test_a_run_that_went_on_elsewhere_is_warned_of(tmp_path):
    run(tmp_path / "1", seed=1)
    run(tmp_path / "2", seed=2, manifest={"resumed": [{"device": "two", "threads": 2}]})
    (line,) = warnings(tmp_path)
    assert "different machines" in line and "one, 2 threads then two, 2 threads" in line


def test_unlike_evaluations_are_warned_of(tmp_path):
    for seed, spp in enumerate((4, 64), 1):
        run(tmp_path / str(seed), seed=seed, settings={"evaluation.spp": spp})
    assert any("evaluated otherwise (evaluation.…" in line for line in warnings(tmp_path))


def test_a_folder_named_twice_counts_once(tmp_path):
    run(tmp_path / "a" / "1")
    folders = (tmp_path, tmp_path / "a", tmp_path / "a" / "1")
    assert found(*folders) == [("pottery", "ours", [1])]
    assert warnings(*folders) == []


def test_measurements_of_variance_beside_runs_are_passed_over_in_silence(tmp_path):
    run(tmp_path / "uniform", sampler="uniform", seed=7)
    (tmp_path / "variance").mkdir()
    manifest = {"schema": SCHEMA_VERSION, "variance": {"repeats": 8}}
    (tmp_path / "variance" / "manifest.json").write_text(json.dumps(manifest))
    assert found(tmp_path) == [("pottery", "uniform", [7])]
    assert warnings(tmp_path) == warnings(tmp_path / "uniform")
    with pytest.raises(InputError, match="holds no run"):
        gather([tmp_path / "variance"], None)


@pytest.mark.parametrize("name, reason", [("none", "no such folder"), ("empty", "holds no run")])
def test_a_folder_without_runs_is_refused_even_beside_good_ones(tmp_path, name, reason):
    (tmp_path / "empty").mkdir()
    run(tmp_path / "1")
    with pytest.raises(InputError, match=reason) as error:
        gather([tmp_path / "1", tmp_path / name], None)
    assert "\n" not in str(error.value)


def test_folders_that_may_not_be_read_are_named(tmp_path, monkeypatch):
    run(tmp_path / "a", seed=1)
    run(tmp_path / "b" / "1", seed=2)
    lock(monkeypatch, tmp_path / "b")
    assert found(tmp_path) == [("pottery", "ours", [1])]
    assert warnings(tmp_path) == [f"left out: {tmp_path / 'b'}: Permission denied"]
    with pytest.raises(InputError, match="holds no run.*; left out: .*/b: Permission denied"):
        gather([tmp_path / "b"], None)


def chosen(folder: Path, wanted: str | None) -> dict[str, str]:
    methods, baseline, _ = gather([folder], wanted)
    for scene, group in by_scene(methods).items():
        assert group[0].label == baseline[scene], "the baseline comes first"
    return baseline


def test_the_baseline_is_uniform_where_there_is_one_else_the_first(tmp_path):
    run(tmp_path / "a" / "1", sampler="balanced")
    run(tmp_path / "a" / "2", sampler="uniform", settings={"optimizer.lr": 0.1})
    run(tmp_path / "b" / "1", sampler="gradient", settings={"scene.name": "dodoco"})
    run(tmp_path / "b" / "2", sampler="balanced", settings={"scene.name": "dodoco"})
    assert chosen(tmp_path, None) == {"pottery": "uniform optimizer.lr=0.1", "dodoco": "balanced"}
    assert chosen(tmp_path, "gradient")["dodoco"] == "gradient"
    assert any("no method gradient" in line for line in gather([tmp_path], "gradient")[2])
    with pytest.raises(InputError, match="did you mean 'gradient'"):
        chosen(tmp_path, "gradiant")


def test_a_baseline_must_be_one_method(tmp_path):
    run(tmp_path / "1", settings={"optimizer.lr": 0.1})
    run(tmp_path / "2", settings={"optimizer.lr": 0.2})
    with pytest.raises(InputError, match="several: ours optimizer.lr=0.1, ours optimizer.lr=0.2"):
        chosen(tmp_path, "ours")
    assert chosen(tmp_path, "ours optimizer.lr=0.2") == {"pottery": "ours optimizer.lr=0.2"}


def test_a_method_knows_its_sampler():
    assert Method("pottery", "ours optimizer.lr=0.1", []).sampler == "ours"


def test_what_parameter_rmse_is_stands_in_its_label(tmp_path):
    """Records of earlier versions do not say; where runs differ, a line says so."""
    for number, words in enumerate((None, "degrees", "relative to the start")):
        said = {} if words is None else {"parameter_rmse_is": words}
        run(tmp_path / str(number), seed=number, manifest=said)
        methods, _, _ = gather([tmp_path / str(number)], None)
        assert content.label("parameter_rmse", methods) == (f"parameter RMSE ({words or OWN_UNIT})")
        assert content.label("image_rmse", methods) == "image RMSE (linear radiance)"
    (line,) = warnings(tmp_path)
    assert "parameter_rmse is not the same in all runs (degrees; parameter's unit; rel" in line


def test_no_limit_is_the_limit_that_there_is_then(tmp_path):
    run(tmp_path / "1", seed=1, settings={"budget.seconds": None})
    run(tmp_path / "2", seed=2, settings={"budget.seconds": 60})
    assert found(tmp_path) == [("pottery", "ours", [1, 2])]


def test_ends_at_unequal_time_are_warned_of(tmp_path):
    run(tmp_path / "1")
    synthetic.write(tmp_path / "2", [0, 1, 3], ERROR, ERROR, sampler="uniform")
    (line,) = warnings(tmp_path)
    assert "unequal time (ours 2 s, uniform 3 s)" in line
    limits = {"budget.seconds": None, "budget.iterations": 5}
    run(tmp_path / "other" / "1", settings=limits)
    other = tmp_path / "other" / "2"
    synthetic.write(other, [0, 1, 3], ERROR, ERROR, sampler="uniform", settings=limits)
    assert not warnings(tmp_path / "other")


def test_runs_that_stop_at_their_targets_noise_do_so_at_unequal_time(tmp_path):
    stops = {"budget.converged": True}
    run(tmp_path / "1", settings=stops)
    synthetic.write(tmp_path / "2", [0, 1, 3], ERROR, ERROR, sampler="uniform", settings=stops)
    (line,) = warnings(tmp_path)
    assert "unequal time (ours 2 s, uniform 3 s), as they stopped at their targets' noise" in line
    both = tmp_path / "both"  # with those that use up their budget
    run(both / "1", settings=stops)
    synthetic.write(both / "2", [0, 1, 3], ERROR, ERROR, sampler="uniform")
    assert not warnings(both)


def test_errors_over_windows_are_other_errors(tmp_path):
    run(tmp_path / "1", settings={"loss": {"name": "structure", "side": 7}})
    run(tmp_path / "2", settings={"loss": {"name": "l2"}})
    assert any("evaluated otherwise" in line for line in warnings(tmp_path))


def test_another_mitsuba_is_warned_of(tmp_path):
    for seed, version in enumerate(("3.8.0", "3.9.1"), 1):
        run(tmp_path / str(seed), seed=seed, manifest={"packages": {"mitsuba": version}})
    (line,) = warnings(tmp_path)
    assert "Mitsuba 3.8.0" in line and "Mitsuba 3.9.1" in line
    for seed in (1, 2):
        guests = {"guests": {"example": f"0.{seed}"}}
        run(tmp_path / "guests" / str(seed), seed=seed, manifest=guests)
    (line,) = warnings(tmp_path / "guests")
    assert "example 0.1" in line and "example 0.2" in line
    for seed in (1, 2):
        run(tmp_path / "isas" / str(seed), seed=seed, manifest={"isas": f"0.{seed}.0"})
    (line,) = warnings(tmp_path / "isas")
    assert "isas 0.1.0" in line and "isas 0.2.0" in line


@pytest.mark.parametrize("package", ["isas-example", "called-otherwise"])
def test_changed_code_of_a_guest_is_another_method(tmp_path, package):
    own = {"sampler._target_": "isas_example.dark.Dark"}
    for seed in (1, 2):
        for sampler, settings in (("uniform", {}), ("dark", own)):
            guests = {"guests": {package: f"0.{seed}"}}
            told = {"sampler": sampler, "seed": seed, "settings": settings, "manifest": guests}
            run(tmp_path / sampler / str(seed), **told)
    labels = [f"dark sampler._target_=isas_example.dark.Dark@0.{seed}" for seed in (1, 2)]
    assert found(tmp_path) == [
        ("pottery", "uniform", [1, 2]),
        *(("pottery", label, [seed]) for seed, label in enumerate(labels, 1)),
    ]


def test_starts_are_known_by_what_they_hold(tmp_path):
    """And not by the names of their files."""
    for seed, (name, held) in enumerate((("a.exr", "1"), ("b.exr", "1"), ("a.exr", "2"))):
        start = {"scene.unknowns.start": name}
        run(tmp_path / str(seed), seed=seed, settings=start, manifest={"start_hash": held * 32})
    assert [seeds for _, _, seeds in found(tmp_path)] == [[0, 1], [2]]


def test_linked_runs_are_compared_and_names_of_files_stay_short(tmp_path):
    run(tmp_path / "runs" / "a", seed=1)
    (tmp_path / "chosen").mkdir()
    (tmp_path / "chosen" / "one").symlink_to(tmp_path / "runs" / "a")
    assert found(tmp_path / "chosen") == [("pottery", "ours", [1])]
    files = [f"photos/day{day}/" + "x" * 80 for day in (1, 2)]
    names = labels.scenes("file", [{"scene.targets": each} for each in files])
    assert len(set(names)) == 2 and all(len(each) < 90 for each in names)
    stems = [labels.stem(f"file {each * 3}") for each in files]
    assert len(set(stems)) == 2 and all(len(each) <= 120 for each in stems)
