"""Unknowns by which no derivative is taken: who says so, why, and what would help."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from gradient_estimates import configured
from scenes_for_tests import render_targets, without_targets

from isas_cli import losses
from isas_cli.estimators.mitsuba import WholeImages
from isas_cli.rendering import coverage, trial, undone
from isas_cli.rendering.light import shapes_with
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.runtime.errors import InputError

MIRROR, GAP = "ball.bsdf.specular_reflectance.value", "pane.bsdf.opacity.value"
TEXTURE = "pane.bsdf.opacity.data"
FOG = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.8}
HAIR, DIFFUSE = {"type": "hair"}, {"type": "diffuse"}
MEDIUM = {"cloud": {"type": "sphere", "radius": 0.3, "bsdf": {"type": "null"}, "interior": FOG}}


def problem(*keys: str, opacity=0.6, start=0.3, hidden=False, depth=4, **more):
    """A mirror ball and a pane with a gap before a floor, under a sky."""
    look = mi.ScalarTransform4f().look_at([0, 1, 4], [0, 0, 0], [0, 1, 0])
    place = mi.ScalarTransform4f()
    kind = "prbvolpath" if "cloud" in more else "prb"
    scene = {
        "type": "scene",
        "integrator": {"type": kind, "max_depth": depth, "hide_emitters": hidden},
        "sensor": {
            "type": "perspective",
            "to_world": look,
            "film": {"type": "hdrfilm", "width": 12, "height": 10},
        },
        "sky": {"type": "constant"},
        "ball": {
            "type": "sphere",
            "radius": 0.8,
            "bsdf": {"type": "conductor", "specular_reflectance": {"type": "rgb", "value": 0.7}},
        },
        "pane": {
            "type": "rectangle",
            "to_world": place.translate([1, 0, 1]).scale(0.5),
            "bsdf": {"type": "mask", "opacity": opacity, "one": {"type": "diffuse"}},
        },
        "floor": {"type": "rectangle", "to_world": place.translate([0, 0, -1]).scale(3)},
    }
    return without_targets(scene | more, {key: start for key in keys})


def one_step(made) -> None:
    render_targets(made, 4)
    whole = WholeImages(made, losses.L2(), 1)
    uniform = PixelDistribution.uniform(Tiles.over(made.views))
    whole.estimate(made.unknowns.starts(), uniform, 0, 1, 0.0)


@pytest.mark.parametrize("depth", (4, -1))
def test_by_what_mitsuba_does_not_differentiate_is_said(depth):
    with pytest.raises(InputError) as refused:
        one_step(problem(MIRROR, depth=depth))
    told = f"scene.unknowns: Mitsuba does not differentiate by '{MIRROR}': take sampler=uniform "
    assert str(refused.value) == told + "estimator=two_path"


def test_what_no_path_of_isas_differentiates_is_not_promised():
    with pytest.raises(InputError, match="estimator=two_path, without hide_emitters in the scene$"):
        one_step(problem(MIRROR, hidden=True))
    fogged = problem(GAP, "floor.bsdf.reflectance.value", **MEDIUM)
    WholeImages(fogged, losses.L2(), 1)
    (told,) = fogged.warnings
    assert told.endswith("compare with sampler=finite_differences")


def test_a_scene_without_such_derivatives_can_be_traced_and_all_entries_count():
    made = problem(MIRROR, hidden=True)
    trial.look(made, "here")
    coverage.fill_in(made, 0)
    assert np.all(made.unknowns[MIRROR].seen)


GLOSS = "floor.bsdf.clearcoat_gloss.value"


def test_an_unknown_that_no_path_reads_is_told_by_its_cause_beside_hidden_emitters():
    coat = {"type": "principled", "clearcoat": 0.0, "clearcoat_gloss": 0.5}
    floor = {"type": "rectangle", "bsdf": coat}
    made = problem(GLOSS, hidden=True, floor=floor)
    made.unknowns[GLOSS].asked = True
    trial.look(made, "here")
    with pytest.raises(InputError, match="while 'clearcoat' is 0"):
        coverage.fill_in(made, 0)


def checked(made, sampler: str = "ours") -> str:
    settings = configured("estimator", "two_path", {"batch": 64})
    with pytest.raises(InputError) as refused:
        settings.check(made, configured("sampler", sampler), losses.L2())
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_the_refusal_names_all_keys_the_one_cause_and_what_helps():
    told = checked(problem(MIRROR, GAP, hidden=True))
    assert f"'{MIRROR}', '{GAP}'" in told and "media" not in told
    assert "leave hide_emitters out of the scene, or take sampler=finite_differences" in told
    assert "with media: leave media out" in checked(problem(GAP, **MEDIUM))
    both = checked(problem(GAP, hidden=True, **MEDIUM))
    assert "leave media and hide_emitters out" in both


def test_differences_are_offered_for_few_numbers_alone():
    texels = mi.TensorXf(np.full((9, 9, 1), 0.5, np.float32))
    opacity = {"type": "bitmap", "data": texels, "raw": True}
    told = checked(problem(TEXTURE, opacity=opacity, hidden=True))
    assert told.endswith("leave hide_emitters out of the scene")


def test_what_cannot_be_differentiated_is_said_before_what_a_sampler_needs():
    assert checked(problem(GAP, **MEDIUM)) == checked(problem(GAP, **MEDIUM), "uniform")


@pytest.mark.parametrize(
    "depth, words",
    [
        (1, "by paths of one edge, which show lights alone.*take scene.max_depth=2 or more, turn"),
        (2, "by paths of at most 2 edges.*take scene.max_depth=3 or more, turn a camera"),
        (-1, "no view sees it, so no image can tell its value; turn a camera"),
    ],
)
def test_paths_that_are_too_short_are_named_as_a_cause(depth, words):
    behind = {"type": "sphere", "center": [0, 0, 90], "bsdf": {"type": "diffuse"}}
    key = "behind.bsdf.reflectance.value"
    made = problem(key, depth=depth, behind=behind)
    with pytest.raises(InputError, match=words):
        coverage.fill_in(made, 0)
    made.mask = dr.full(mi.Float, 1, made.views.total)
    with pytest.raises(InputError, match="in a pixel that counts.*let masks and weights leave"):
        coverage.fill_in(made, 1)


@pytest.mark.parametrize(
    "material, word, told",
    [
        ({"type": "principled"}, "clearcoat_gloss.value", "while 'clearcoat' is 0: give that a"),
        ({"type": "hair", "sigma_a": 0.5}, "eumelanin", "beside a 'sigma_a': take that out"),
    ],
)
def test_what_its_material_does_not_heed_is_told_why(material, word, told):
    lock = {"type": "sphere", "center": [-1, 0, 1], "radius": 0.4, "bsdf": material}
    with pytest.raises(InputError, match=f"take it off the list; or it has no effect {told}"):
        coverage.fill_in(problem(f"lock.bsdf.{word}", lock=lock), 0)


def test_a_problem_that_misses_nothing_says_nothing():
    assert undone.missed(problem(MIRROR, GAP)) == []


@pytest.mark.parametrize(
    "material, word",
    [
        (HAIR, "eumelanin"),
        ({"type": "blendbsdf", "weight": 0.5, "a": HAIR, "b": DIFFUSE}, "bsdf_0.eumelanin"),
    ],
)
def test_hair_has_no_gap(material, word):
    """Mitsuba lists one, and never draws it."""
    lock = {"type": "sphere", "center": [-1, 0, 1], "radius": 0.4, "bsdf": material}
    made = problem(f"lock.bsdf.{word}", hidden=True, lock=lock)
    assert undone.missed(made) == []
    assert sorted(shapes_with(made.scene, "Delta")) == ["ball", "pane"]
    assert "lock" in shapes_with(made.scene, "Transmission")
