"""What a setting is to a run is said once, beside it, and all who ask get the same answer."""

import dataclasses

import pytest
from omegaconf import OmegaConf

from isas_cli.cli.sweeps import fingerprint
from isas_cli.config.roles import Role, meaning, resuming
from isas_cli.config.schema import Config
from isas_cli.report.compare import labels

TEXTURE = "scene.unknowns.jar.bsdf.base_color.data"


@pytest.mark.parametrize("field", dataclasses.fields(Config), ids=lambda field: field.name)
def test_every_setting_says_what_it_is(field):
    assert "meaning" in field.metadata


@pytest.mark.parametrize(
    "key, role",
    {
        "optimizer.lr": Role.METHOD,
        "estimator.batch": Role.METHOD,
        "prior.weight": Role.METHOD,
        "budget.seconds": Role.METHOD,
        f"{TEXTURE}.lr": Role.METHOD,
        f"{TEXTURE}.range": Role.METHOD,
        f"{TEXTURE}.blur.start": Role.METHOD,
        f"{TEXTURE}.start": Role.PROBLEM,
        "scene.path": Role.PROBLEM,
        "scene.sizes.tiny.views": Role.RECORD,
        "target.spp": Role.PROBLEM,
        "profile": Role.RECORD,
        "report": Role.RECORD,
        "frames.spp": Role.RECORD,
        "seed": Role.SEED,
        "threads": Role.PLACE,
        "hydra.run.dir": Role.PLACE,
    }.items(),
)
def test_the_innermost_field_decides(key, role):
    assert meaning(key).role is role


@pytest.mark.parametrize("setting", ("profile", "report", "evaluation.spp", "threads", "tracker"))
def test_what_changes_no_result_makes_no_other_method(setting):
    plain = {"sampler.name": "ours", "optimizer.lr": "0.02"}
    assert labels.split({**plain, setting: "1"}) == labels.split(plain)


def test_a_sweep_s_folder_is_named_after_what_is_computed():
    def digest(**changes) -> str:
        plain = {"seed": 1, "threads": 0, "report": True, "optimizer": {"lr": 0.02}}
        return fingerprint._text(OmegaConf.create({**plain, **changes}))

    assert digest() == digest(threads=2) != digest(report=False)
    assert digest() != digest(optimizer={"lr": 0.1}) and digest() != digest(seed=2)


def test_what_a_continued_run_may_change():
    budgets = {f"budget.{name}" for name in ("seconds", "iterations", "paths", "converged")}
    assert set(resuming()) == {*budgets, "threads", "tracker", "profile"}
