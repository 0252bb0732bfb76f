"""A part of the census of derivatives (benchmarks/derivatives.py), small enough for every day: all
plugins are known, and what isas differentiates rightly stays so."""

import _plugins
import mitsuba as mi
import numpy as np
import pytest
from _derivative_methods import Trial
from _derivative_trial import Census

from isas_cli.config.schema import SceneConfig, UnknownConfig
from isas_cli.engine import assemble
from isas_cli.runtime import backend
from isas_cli.unknowns import verdicts

SEEDS = 12
# Keys, of scenes whose other keys are left out.
RIGHT = [
    ("diffuse", "thing.bsdf.reflectance.value"),
    ("roughconductor", "thing.bsdf.eta.value"),
    ("principled", "thing.bsdf.base_color.value"),
    ("blendbsdf", "thing.bsdf.weight.value"),
    ("roughdielectric", "thing.bsdf.specular_transmittance.value"),
    ("envmap", "thing.data"),
    ("mesh_attribute", "thing.vertex_color"),
    ("mask", "thing.bsdf.opacity.value"),
    ("blendbsdf-mirror", "thing.bsdf.bsdf_0.reflectance.value"),
    ("blendbsdf-null", "thing.bsdf.weight.value"),
    ("plastic", "thing.bsdf.diffuse_reflectance.value"),
    ("conductor", "thing.bsdf.eta.value"),
    ("thindielectric", "thing.bsdf.specular_transmittance.value"),
    ("principled", "thing.bsdf.specular"),
    ("roughplastic", "thing.bsdf.alpha"),
    ("hair", "thing.bsdf.eumelanin"),
]


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    with backend.loading():
        return _plugins.write(tmp_path_factory.mktemp("plugins"))


def test_every_plugin_has_a_scene_or_a_reason():
    found = _plugins.installed()
    assert _plugins.unclassified(found) == []
    assert {"mask", "sunsky", "prb", "flat_sensor"} <= set(found)


def test_a_plugin_of_a_new_version_is_named():
    assert _plugins.unclassified({"mask": "BSDF", "velvet": "BSDF", "gloss": "Film"}) == ["velvet"]


def test_reasons_are_of_plugins_that_are_there_and_have_no_scene():
    shown = {_plugins.subject(name) for name in _plugins.SCENES}
    assert set(_plugins.REASONS) <= set(_plugins.installed()) - shown
    assert shown <= set(_plugins.installed())


def compared(trial: Trial, key: str, ways: tuple[str, ...]) -> tuple[Census, str]:
    census = Census(trial, SEEDS, seconds=1e9)
    census.ways = {way: census.ways[way] for way in ways}
    list(census.rows(ends=False))
    return census, "random" if trial.kinds[key].present.size > 3 else "all"


@pytest.mark.parametrize(("scene", "key"), RIGHT)
def test_derivatives_by_isas_are_those_of_differences(scenes, scene, key):
    trial = Trial.of(scenes[scene], key)
    census, direction = compared(trial, key, ("isas", "replayed"))
    reference, error = census.estimates.of("reference", key, "generic", direction)
    for way in ("isas", "replayed"):
        found, own = census.estimates.of(way, key, "generic", direction)
        apart = np.hypot(error, own)
        print(way, found / reference, "±", apart / np.abs(reference))
        assert np.all(2 * apart < 0.1 * np.abs(reference)), "too noisy to tell"
        assert np.all(np.abs(found - reference) < 4 * apart + 0.01 * np.abs(reference))
    ours, noise = census.estimates.of("picture_isas")
    theirs, more = census.estimates.of("picture")
    assert np.all(np.abs(ours - theirs) < 4 * np.hypot(noise, more))


def test_differences_tell_a_wrong_derivative(scenes):
    """``prb`` of an opacity: it lays the derivative of what is seen through gaps on the surface."""
    key = "thing.bsdf.opacity.value"
    census, _ = compared(Trial.of(scenes["mask"], key), key, ("prb",))
    reference, error = census.estimates.of("reference", key, "generic", "all")
    found, own = census.estimates.of("prb", key, "generic", "all")
    assert np.all(np.abs(found - reference) > 4 * np.hypot(error, own))


@pytest.mark.parametrize(
    ("scene", "key", "place"),
    [
        ("mask-textured", "thing.bsdf.opacity.data", ("MaskBSDF", "opacity")),
        ("checkerboard", "thing.bsdf.reflectance.color0.value", ("SmoothDiffuse", "reflectance")),
        ("hg", "thing.interior_medium.albedo.value.value", ("HomogeneousMedium", "albedo")),
        ("mesh_attribute", "thing.vertex_color", ("Mesh", "vertex_color")),
        ("envmap", "thing.scale", ("EnvironmentMapEmitter", "scale")),
    ],
)
def test_a_verdict_is_of_what_holds_the_numbers(scenes, scene, key, place):
    with backend.loading():
        loaded = mi.load_file(str(scenes[scene]))
    assert verdicts.place(mi.traverse(loaded), key) == place


def test_what_the_census_does_not_know_is_said():
    assert verdicts.verdict("velvet", "softness") == verdicts.UNKNOWN
    assert verdicts.note("velvet", "softness") == ""


def test_what_the_census_found_wrong_runs_with_a_word(scenes):
    bump, matte = "thing.bsdf.nested_texture.data", "thing.bsdf.nested_bsdf.reflectance.value"
    for place in (("BumpMap", "nested_texture"), ("NormalMap", "normalmap")):
        assert verdicts.verdict(*place) in verdicts.WRONG
    unknowns = {key: UnknownConfig(start=0.4) for key in (bump, matte)}
    path = str(scenes["bumpmap-points"])
    found = assemble.bare(SceneConfig(name="file", path=path, unknowns=unknowns))[0].warnings
    (text,) = (each for each in found if "not right everywhere" in each)
    assert bump in text and "away from the camera" in text and matte not in text
