"""Unknowns and poses that are taken out of a scene by '~', as Hydra's users write it."""

import json

import pytest

from isas_cli.cli.app import main
from isas_cli.cli.sweeps import launch, race
from isas_cli.config import searchpath
from isas_cli.config.compose import compose, translate
from isas_cli.runtime.errors import InputError

LAMP, BOX, WALL = KEYS = ["lamp.place", "box.angle", "left.bsdf.base_color.value"]
NEW = {WALL: {"start": 0.3, "blur": {"start": 0.2, "end": 0.1}}}
GIVEN = f"scene.unknowns={json.dumps(NEW)}"


def scene(*words: str):
    return compose(translate(["scene=global_illumination", *words])).scene


@pytest.mark.parametrize(
    "word",
    [
        f"~scene.unknowns.{WALL}",
        f'~scene.unknowns["{WALL}"]',
        f"~scene.unknowns['{WALL}']",
        f"~scene.unknowns[{WALL}]",
        f"~scene.unknowns.{WALL}=null",
        f'scene.unknowns={{"{WALL}": null}}',
    ],
)
def test_one_is_dropped(word):
    found = scene(word)
    assert list(found.unknowns) == [LAMP, BOX] == list(found.poses)


def test_a_pose_goes_with_its_unknown():
    found = scene(f"~scene.unknowns.{LAMP}")
    assert list(found.unknowns) == [BOX, WALL] and list(found.poses) == [BOX]


def test_all_are_dropped_and_others_given():
    assert dict(scene("~scene.unknowns").unknowns) == {} == dict(scene("~scene.unknowns").poses)
    found = scene("~scene.unknowns", GIVEN)
    assert list(found.unknowns) == [WALL] and found.unknowns[WALL].start == 0.3
    assert found.unknowns[WALL].lr is None  # nothing is left of the scene's own


def test_what_a_scene_has_from_others_is_dropped(tmp_path, monkeypatch):
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene/mine.yaml").write_text("defaults: [global_illumination, _self_]\n")
    monkeypatch.setenv(searchpath.VARIABLE, str(tmp_path))
    found = compose(translate(["scene=mine", f"~scene.unknowns.{WALL}"])).scene
    assert list(found.unknowns) == [LAMP, BOX]
    assert dict(compose(translate(["scene=mine", "~scene.unknowns"])).scene.unknowns) == {}


def test_what_is_given_is_merged_into_what_is_there():
    found = scene(GIVEN)
    assert list(found.unknowns) == KEYS
    assert (found.unknowns[WALL].start, found.unknowns[WALL].lr) == (0.3, 0.24)


def test_the_order_counts():
    again = scene(f"~scene.unknowns.{BOX}", f'scene.unknowns={{"{BOX}": {{"start": 5.0}}}}')
    assert sorted(again.unknowns) == sorted(KEYS) and again.unknowns[BOX].blur is None
    assert sorted(again.poses) == sorted([LAMP, BOX])  # it has its pose still
    assert list(scene(GIVEN, "~scene.unknowns").unknowns) == []


@pytest.mark.parametrize(
    "word, told",
    {
        "~scene.unknowns.lamp.plac": "did you mean 'lamp.place'?",
        "~scene.poses.box.angel": "no such pose; did you mean 'box.angle'?",
        "~scene.unknown": "~scene.unknowns.KEY",
        "~estimator.batch": "a setting cannot be removed",
    }.items(),
)
def test_a_slip_is_answered(word, told):
    with pytest.raises(InputError) as error:
        scene(word)
    assert told in str(error.value) and "\n" not in str(error.value)


def test_what_was_dropped_is_not_there_any_more():
    with pytest.raises(InputError, match=f"valid: {LAMP}, {WALL}$"):
        scene(f"~scene.unknowns.{BOX}", f"~scene.unknowns.{BOX}")


def test_contestants_drop_them(tmp_path):
    contestants = [{"sampler": "plateau"}, {f"~scene.unknowns.{LAMP}": None}]
    own = {"contestants": json.dumps(contestants), "hydra.run.dir": str(tmp_path)}
    entries = race.planned(own, ["scene=global_illumination", "~scene.unknowns.box.angle"]).entries
    assert [list(entry.cfg.scene.unknowns) for entry in entries] == [[LAMP, WALL], [WALL]]


def test_printing_takes_it(capsys):
    assert main(["run", "scene=global_illumination", "~scene.unknowns", GIVEN, "--cfg", "job"]) == 0
    assert "start: 0.3" in capsys.readouterr().out


def test_every_job_of_a_sweep_takes_it(monkeypatch):
    planned = []
    monkeypatch.setattr(launch.Sweep, "launch", lambda self, jobs: planned.extend(jobs) or [])
    words = [
        "scene=global_illumination",
        "~scene.unknowns",
        GIVEN,
        "scene.unknowns={a.b:{start:1}}",
    ]
    assert main(["run", "-m", *words, "seed=1,2"]) == 0
    assert [list(job.cfg.scene.unknowns) for job in planned] == [[WALL, "a.b"]] * 2
    assert {job.cfg.estimator.name for job in planned} == {"plateau"}


@pytest.mark.parametrize("name", ["Würfel", "Leaf#2", "a&b", "100%", "it's", "%e4%", "grün%fc%"])
def test_names_may_hold_what_hydras_grammar_does_not(name):
    key = f"{name}.bsdf.reflectance.value"
    words = ["scene=file", "scene.path=own.xml"]
    given = json.dumps({key: {"start": 0.5}}, ensure_ascii=False)
    cfg = compose(translate([*words, f"scene.unknowns={given}"]))
    assert list(cfg.scene.unknowns) == [key] and cfg.scene.unknowns[key].start == 0.5
    cfg = compose(translate([*words, f"scene.unknowns={given}", f"~scene.unknowns.{key}"]))
    assert not cfg.scene.unknowns
