"""What a scene takes by itself, and the words that count instead."""

import pytest
from omegaconf import OmegaConf

from isas_cli.cli.app import main
from isas_cli.cli.sweeps import race
from isas_cli.config import method, schema, searchpath
from isas_cli.config.compose import compose, instantiate, options, translate
from isas_cli.runtime.budget import Budget
from isas_cli.runtime.errors import InputError

GROUPS = {"sampler", "estimator", "optimizer", "target", "budget"}
# Another renderer is one only with more words: tests/scene/test_outside.py.
OWN = [n for n in options("scene") if method.said(n, "method") and n != "external"]
# What path replay does not differentiate.
MOVING = ["caustic", "cup", "dodoco_b", "global_illumination", "kirby", "object_joint_shape"]
MOVING += ["occlusion", "shadowplay", "shadows", "shadows_prdpt", "sort"]


def composed(*words: str):
    cfg = compose(translate(words))
    schema.typed(cfg)
    return cfg


def test_the_scenes_that_path_replay_cannot_solve_take_something_else():
    assert OWN == MOVING


@pytest.mark.parametrize("scene", OWN)
def test_all_of_it_is_in_the_configuration_and_fits(scene):
    cfg, own = composed(f"scene={scene}", "name=x"), method.said(scene, "method")
    assert set(own) <= GROUPS
    assert cfg.sampler.name == own.sampler
    for group in GROUPS & set(own) - {"sampler"}:
        assert own[group].items() <= cfg[group].items()
    instantiate(cfg.estimator, "estimator").fits(instantiate(cfg.sampler, "sampler"))
    words = method.taken(cfg)
    # Typed, they are the same configuration.
    typed = composed(f"scene={scene}", "name=x", "~scene.method", *words)
    assert {**typed, "scene": 0} == {**cfg, "scene": 0}
    assert method.taken(typed) == [] and typed.scene.unknowns == cfg.scene.unknowns


def settings(cfg) -> tuple:
    return cfg.sampler.name, cfg.estimator.name, cfg.estimator.batch, cfg.optimizer.schedule


@pytest.mark.parametrize(
    "words, found",
    {
        "": ("uniform", "plateau", 2048, "cosine"),
        "sampler=plateau": ("plateau", "plateau", 2048, "cosine"),
        "sampler=differences": ("differences", "plateau", 2048, "cosine"),
        "sampler=plateau sampler.base=differences": ("differences", "plateau", 2048, "cosine"),
        "estimator=plateau": ("uniform", "plateau", 2048, "cosine"),
        "estimator.batch=16": ("uniform", "plateau", 16, "cosine"),
        "optimizer.schedule=constant": ("uniform", "plateau", 2048, "constant"),
        # Another estimator has no use for what is set for this one.
        "sampler=mitsuba": ("mitsuba", "mitsuba", 65536, None),
        "estimator=mitsuba": ("uniform", "mitsuba", 65536, None),
        "estimator.gradient=renderer": ("uniform", "plateau", 65536, None),
        "sampler=plateau sampler.gradient=renderer": ("plateau", "plateau", 65536, None),
        "sampler=uniform estimator=finite_differences": (
            *("uniform", "finite_differences", 65536, None),
        ),
        "sampler=ours estimator=two_path": ("ours", "two_path", 65536, None),
        "~scene.method": ("progress", "two_path", 65536, None),
    }.items(),
)
def test_a_word_counts_instead(words, found):
    assert settings(composed("scene=cup", *words.split())) == found


def test_a_budget_counts_instead_of_the_scenes():
    own = {"seconds": None, "iterations": 400, "paths": None, "converged": False}
    assert composed("scene=cup").budget == own
    assert composed("scene=cup", "budget.converged=true").budget == own | {"converged": True}
    assert composed("scene=cup", "budget.seconds=9").budget.iterations is None
    assert composed("scene=cup", "sampler=mitsuba").budget.iterations == 400
    assert composed("scene=cup", "~scene.method").budget.iterations is None


def test_targets_of_ones_own_are_not_rendered():
    assert composed("scene=caustic").target.spp == 2048
    assert composed("scene=caustic", "target.noise=0.1").target.spp is None
    found = composed("scene=caustic", "scene.targets=[a.exr]")
    assert found.target.spp == schema.TargetConfig().spp


def test_a_race_is_of_equal_time(tmp_path):
    own = {"samplers": "[plateau,mitsuba]", "hydra.run.dir": str(tmp_path)}
    entries = race.planned(own, ["scene=cup"]).entries
    assert [entry.cfg.estimator.name for entry in entries] == ["plateau", "mitsuba"]
    assert [entry.cfg.estimator.batch for entry in entries] == [2048, 65536]
    assert {entry.budget for entry in entries} == {Budget(seconds=60)}
    entries = race.planned(own, ["scene=cup", "budget.iterations=3"]).entries
    assert {entry.budget for entry in entries} == {Budget(iterations=3)}


def test_what_is_told_is_what_holds():
    assert method.taken(composed("scene=pottery")) == []
    told = method.taken(composed("scene=cup", "estimator.batch=16", "budget.paths=1e6"))
    assert told == [
        *("sampler=uniform", "estimator=plateau", "estimator.spp=4"),
        *("optimizer.schedule=cosine", "optimizer.final=0.01"),
    ]
    assert method.taken(composed("scene=cup", "sampler=mitsuba")) == ["budget.iterations=400"]


@pytest.mark.parametrize("typed", ["scene.method.sampler=ours", "scene.method={}"])
def test_it_is_no_setting_of_its_own(typed):
    with pytest.raises(InputError, match="say sampler=NAME, estimator=NAME, …, or ~scene.method"):
        composed("scene=cup", typed)


def test_a_set_that_comes_along_is_asked_whether_its_object_is_known():
    """The board's plane stands in its file; the head begins as a hull."""
    assert composed("scene=photos", "photos.path=chessboard").estimator.name == "two_path"
    assert composed("scene=photos", "photos.path=head").estimator.name == "silhouettes"


def test_a_scene_without_one_keeps_the_usual_choices():
    usual = composed("scene=pottery")
    assert (usual.sampler.name, usual.estimator.name) == ("progress", "two_path")
    assert OmegaConf.to_container(usual.scene.method) == {}


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """Writes a scene of one's own."""
    (tmp_path / "scene").mkdir()
    monkeypatch.setenv(searchpath.VARIABLE, str(tmp_path))
    return (tmp_path / "scene/mine.yaml").write_text


def test_a_scene_takes_what_those_in_its_defaults_take(mine):
    own = "name: mine\nmethod: {estimator: {batch: 16}}\n"
    mine(f"defaults: [cup, _self_]\n{own}")
    assert settings(composed("scene=mine")) == ("uniform", "plateau", 16, "cosine")
    mine(f"defaults: [/scene/cup@_here_]\n{own}")
    assert settings(composed("scene=mine")) == ("uniform", "plateau", 16, "cosine")
    mine(f"defaults: [_self_, cup]\n{own}")
    assert settings(composed("scene=mine")) == ("uniform", "plateau", 2048, "cosine")


def test_what_it_takes_may_refer_to_its_sizes(mine):
    iterations = "{iterations: '${scene.sizes.${size}.width}'}"
    mine(f"defaults: [cup, _self_]\nname: mine\nmethod: {{budget: {iterations}}}\n")
    found = composed("scene=mine", "size=tiny")
    assert found.budget.iterations == 32 and "budget.iterations=32" in method.taken(found)


def test_photographs_of_one_s_own_say_whether_something_moves(mine):
    known = "defaults: [photos, _self_]\nname: mine\nphotos: {path: chessboard"
    mine(f"{known}}}\n")
    assert composed("scene=mine").estimator.name == "two_path"
    mine(f"{known}, pose: true}}\n")
    found = composed("scene=mine")
    assert (found.sampler.name, found.estimator.name) == ("ours", "silhouettes")
    mine(f"{known}, pose: true}}\nmethod: {{sampler: uniform}}\n")
    found = composed("scene=mine")
    assert (found.sampler.name, found.estimator.name) == ("uniform", "silhouettes")


def test_what_it_has_from_others_is_listed_in_a_row(mine, capsys):
    """Into a pipe, which has no width."""
    mine(
        "defaults: [cup, _self_]\nname: mine\nsizes: {tiny: {width: 8}}\n"
        "method: {budget: {iterations: '${scene.sizes.${size}.width}'}}\n"
    )
    assert main(["scenes"]) == 0
    (row,) = [line for line in capsys.readouterr().out.splitlines() if " mine " in line]
    told = "A mug whose handle hides behind it; its angle is unknown. Takes estimator=plateau"
    assert all(text in row for text in (told, "cup.angle", "tiny"))


def test_every_word_of_the_unknowns_tells_whether_something_moves():
    words = ["scene=photos", "photos.path=nowhere", "scene.unknowns.sky.data.lr=0.05"]
    words.insert(2, 'scene.unknowns={"object.vertices": {}}')
    assert compose(translate(words)).estimator.name == "silhouettes"
