"""What a run makes of its settings before it begins."""

from __future__ import annotations

from isas_cli.config.compose import compose, translate
from isas_cli.config.schema import Config
from isas_cli.engine import experiment
from isas_cli.engine.choices import Choices
from isas_cli.engine.display import Display
from isas_cli.engine.experiment import Phases
from isas_cli.engine.workshop import Workshop
from isas_cli.runtime.budget import Budget
from isas_cli.scene.problem import Problem


def configured(*settings: str) -> tuple[Choices, Config, Budget]:
    cfg = compose(translate(settings))
    checked = experiment.checked(cfg)
    return Choices.of(cfg), *checked


def built(*settings: str) -> Problem:
    choices, typed, budget = configured(*settings)
    with Display(budget) as display:
        return experiment.built(typed, Phases(display), [choices])


def workshop_of(*settings: str) -> Workshop:
    return Workshop(built(*settings))
