"""Records of earlier versions: their configurations as they would be written today."""

from isas_cli.config.compose import compose, translate
from isas_cli.config.earlier import modern

ESTIMATOR = {"batch": 512, "derivative_sampling": False, "freeze": True}


def test_a_pixel_sampler_s_run_gets_the_two_path_estimator():
    sampler = {"name": "ours", "_target_": "isas_cli.samplers.ours.Ours", "floor": 0.05}
    found = modern({"sampler": sampler, "estimator": ESTIMATOR, "seed": 1})
    assert found["sampler"] == sampler and found["seed"] == 1
    today = compose(["scene=pottery", "sampler=ours", "estimator.batch=512"])
    # What has been added since does as it did then.
    added = {"crossed": False, "blurred": False}
    assert {**added, **found["estimator"]} == {**today.estimator, **added}
    assert found["prior"] == today.prior


def test_a_gradient_s_run_gets_its_estimator_and_the_sampler_that_drew_for_it():
    base = {"name": "differences", "_target_": "isas_cli.samplers.differences.Differences"}
    old = {
        "name": "plateau",
        "_target_": "isas_cli.samplers.plateau.Plateau",
        "base": base,
        "scheme": "separate",
        "spp": 4,
    }
    found = modern({"sampler": old, "estimator": ESTIMATOR})
    assert found["sampler"] == base
    settings = found["estimator"]
    assert (settings["name"], settings["scheme"], settings["spp"]) == ("plateau", "separate", 4)
    assert settings["batch"] == 512 and "derivative_sampling" not in settings
    uniform = {"name": "uniform", "_target_": "isas_cli.samplers.uniform.Uniform"}
    found = modern({"sampler": {**old, "base": uniform}, "estimator": ESTIMATOR})
    today = compose(translate(["scene=pottery", "sampler=plateau"]))
    assert found["sampler"] == today.sampler
    assert found["estimator"]["_target_"] == today.estimator["_target_"]


def test_today_s_configuration_stays_as_it_is():
    today = {"sampler": {"name": "ours"}, "estimator": {"name": "plateau"}, "prior": {}}
    today["effects"] = {"name": "auto", "directions": None}
    assert modern(today) is today
    assert modern({}) == {}


def test_what_was_smoothing_is_the_width_of_a_filter():
    today = compose(translate(["scene=pottery", "optimizer.filter=gaussian"])).optimizer
    old = {key: value for key, value in today.items() if key != "filter"}
    found = modern({"optimizer": {**old, "smoothing": 0.03}})["optimizer"]
    assert found == {**today, "filter": {**today.filter, "width": 0.03}}
    none = compose(translate(["scene=pottery", "optimizer.filter=none"])).optimizer
    for smoothing in ({}, {"smoothing": 0.0}):
        assert modern({"optimizer": {**old, **smoothing}})["optimizer"] == none
