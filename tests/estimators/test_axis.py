"""Estimators as an axis of their own: presets, combinations, and what is refused before a target is
rendered."""

import types

import mitsuba as mi
import pytest
from gradient_estimates import configured
from poses_for_tests import blurred_problem
from scenes_for_tests import ROUGHNESS, TEXTURE, dictionary, without_targets

from isas_cli import losses
from isas_cli.config.compose import compose, instantiate, options, translate
from isas_cli.config.presets import PRESETS
from isas_cli.config.schema import typed
from isas_cli.estimators.finite_differences import FiniteDifferences
from isas_cli.estimators.mitsuba import WholeImages
from isas_cli.estimators.plateau import Plateau
from isas_cli.estimators.silhouettes import ByShape
from isas_cli.estimators.two_path import TwoPath
from isas_cli.rendering import integrators
from isas_cli.runtime.errors import InputError
from isas_cli.samplers.uniform import Alike, Uniform

MADE = {
    "two_path": TwoPath,
    "plateau": Plateau,
    "finite_differences": FiniteDifferences,
    "mitsuba": WholeImages,
    "silhouettes": ByShape,
}
# A pixel sampler's way from the images to a distribution, and who can use it.
PLAIN = {"uniform", "gradient"}
MOMENTS = {"preconditioned", "progress"}


def chosen(*settings: str):
    cfg = compose(translate(["scene=cup", *settings]))
    typed(cfg)
    return cfg


def test_there_is_a_test_for_every_estimator():
    assert set(MADE) == set(options("estimator"))
    assert set(PRESETS) == set(options("sampler")) & set(options("estimator"))


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_an_estimator_with_uniform_pixels(name):
    cfg = chosen(f"sampler={name}")
    assert cfg.estimator.name == cfg.sampler.name == name
    assert type(instantiate(cfg.sampler, "sampler")).__name__ == "Uniform"
    made = instantiate(cfg.estimator, "estimator").on(blurred_problem(), losses.L2())
    assert type(made) is MADE[name]


def test_settings_of_a_preset_go_to_the_estimator_and_its_base_draws():
    cfg = chosen(
        *("sampler=plateau", "sampler.scheme=separate", "sampler.spp=4"),
        *("sampler.base=differences", "sampler.base.stage1.resolution=128"),
    )
    assert (cfg.estimator.name, cfg.estimator.scheme, cfg.estimator.spp) == (
        *("plateau", "separate"),
        4,
    )
    assert (cfg.sampler.name, cfg.sampler.stage1.resolution) == ("differences", 128)
    same = chosen(
        *("estimator=plateau", "estimator.scheme=separate", "estimator.spp=4"),
        *("sampler=differences", "sampler.stage1.resolution=128"),
    )
    assert (same.estimator, same.sampler) == (cfg.estimator, cfg.sampler)
    with pytest.raises(InputError, match="sampler=plateau is a preset for estimator=plateau"):
        chosen("sampler=plateau", "estimator=mitsuba")
    # A race names its samplers elsewhere; with another sampler it is no setting.
    assert translate(["sampler.spp=4"]) == ["estimator.spp=4"]
    assert translate(["sampler=ours", "sampler.spp=4"]) == ["sampler=ours", "sampler.spp=4"]


@pytest.mark.parametrize("estimator", MADE)
def test_which_samplers_go_with_it(estimator):
    fits = {
        "two_path": set(options("sampler")) - {"differences"} | set(PRESETS),
        "plateau": {*PLAIN, "differences", *PRESETS},
        "finite_differences": {*PLAIN, *PRESETS},
        "mitsuba": {"uniform", *PRESETS},
        "silhouettes": set(options("sampler")) - {"differences", *MOMENTS} | set(PRESETS),
    }[estimator]
    settings = configured("estimator", estimator)
    for name in options("sampler"):
        sampler = configured("sampler", name)
        if name in fits:
            settings.fits(sampler)
        else:
            with pytest.raises(InputError, match=rf"sampler={name}|sampler={sampler.name}"):
                settings.fits(sampler)


def test_whole_images_go_with_a_sampler_of_ones_own_that_draws_alike():
    configured("estimator", "mitsuba").fits(type("Even", (Uniform,), {})())


def volumetric():
    """A problem whose scene names prbvolpath."""
    scene = dictionary()
    scene["integrator"] = {"type": "prbvolpath", "max_depth": 4}
    return without_targets(scene, {TEXTURE: 0.5, ROUGHNESS: 0.5})


def test_media_and_samplers_that_need_forward_mode_are_refused_in_one_line():
    p, loss = volumetric(), losses.L2()
    assert p.integrator.simulates == ("surfaces", "media") and not p.integrator.has_forward
    settings = configured("estimator", "two_path", {"batch": 64})
    refused = []
    for name in set(options("sampler")) - {"differences", *PRESETS}:
        try:
            settings.check(p, configured("sampler", name), loss)
        except InputError as error:
            refused.append(name)
            assert f"sampler={name} differentiates paths in forward mode" in str(error)
            assert "PRBVolpathIntegrator" in str(error) and "\n" not in str(error)
    everyone = set(options("sampler")) - {"differences", *PRESETS}
    assert set(refused) == everyone - PLAIN - {"progress"}
    # Which is what is taken by itself.
    found = settings.looks(configured("sampler", "progress"), p, loss)
    assert isinstance(found, Alike) and "pixels are drawn uniformly" in p.warnings[-1]


def test_an_integrator_without_path_replay_is_refused():
    for base, words in (
        (mi.load_dict({"type": "path"}), "the integrator PathIntegrator"),
        (None, "no integrator"),
    ):
        with pytest.raises(InputError, match=rf"scene=x has {words}.*prb"):
            integrators.adapt(base, "scene=x")


def test_whole_images_are_rendered_by_the_scene_s_own_integrator():
    """Not by a surface one whatever the scene names: that would show another image than the
    targets."""
    p = volumetric()
    made = WholeImages(p, losses.L2(), 64)
    assert made.integrator is p.integrator.mitsuba
    moving = blurred_problem()
    assert (
        type(WholeImages(moving, losses.L2(), 64).integrator).__name__
        != type(moving.integrator.mitsuba).__name__
    )
    moving.integrator = integrators.adapt(mi.load_dict({"type": "prbvolpath", "max_depth": 3}))
    with pytest.raises(InputError, match="prb_projective, which simulates no media"):
        WholeImages(moving, losses.L2(), 64)


def test_the_record_says_how_derivatives_are_taken():
    scene = mi.load_dict(
        {
            "type": "scene",
            "lamp": {"type": "point"},
            "mirror": {"type": "sphere", "bsdf": {"type": "conductor"}},
            "floor": {"type": "rectangle"},
        }
    )
    moving = types.SimpleNamespace(
        unknowns=types.SimpleNamespace(moving=["turn"]),
        **dict(part=None, edges=None),
        integrator=types.SimpleNamespace(
            name="PRBIntegrator", derivatives="path replay", max_depth=3
        ),
        scene=scene,
    )
    words = {name: configured("estimator", name).derivatives(moving) for name in MADE}
    assert words["two_path"] == "path replay"
    assert words["plateau"].startswith("none taken: plain renderings")
    assert words["finite_differences"].startswith("none taken: difference quotients")
    assert "prb_projective" in words["mitsuba"]
    assert words["silhouettes"].endswith("by way of mirror are left out")
