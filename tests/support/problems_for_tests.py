"""What a run makes of its settings before it begins, and a few iterations of one."""

from __future__ import annotations

import numpy as np
import pytest

from isas_cli.config.compose import compose, translate
from isas_cli.config.schema import Config
from isas_cli.engine import experiment
from isas_cli.engine.choices import Choices
from isas_cli.engine.display import Display
from isas_cli.engine.experiment import Phases
from isas_cli.engine.loop import Hooks, Loop
from isas_cli.engine.workshop import Workshop
from isas_cli.runtime.budget import Budget
from isas_cli.scene.problem import Problem
from isas_cli.unknowns.parameters import as_numpy


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


def workshops(*settings: str):
    """A module's fixture: the problem of the scene that a test is given, for all its loops."""

    @pytest.fixture(scope="module")
    def workshop(request) -> Workshop:
        return workshop_of(f"scene={request.param}", *settings)

    return workshop


def iterated(
    workshop: Workshop, settings: list[str], least: float, absent: bool
) -> tuple[Loop, dict[str, float]]:
    """A loop that has run, and the numbers of its last evaluation, all finite but the gradient's
    noise where it is ``absent``; each unknown within its range and further than ``least`` from its
    start."""
    loop = workshop.loop(*configured(f"scene={workshop.problem.name}", *settings))
    loop.rehearse()
    rows: list[dict] = []
    assert loop.run(Hooks(evaluated=rows.append)) == "done"
    workshop.problem.unknowns.write(loop.stepper.values)  # detach
    last = rows[-1]
    assert loop.position.iteration == last["iteration"]
    assert last["nonfinite"] == 0 and loop.lost == 0
    measured = {k: v for k, v in last.items() if isinstance(v, float)}
    if absent:
        del measured["gradient_noise"]
    assert all(np.isfinite(v) for v in measured.values()), measured
    for unknown in workshop.problem.unknowns:
        found = as_numpy(loop.stepper.values[unknown.key])
        assert np.isfinite(found).all()
        assert unknown.low <= found.min() and found.max() <= unknown.high
        assert np.abs(found - unknown.start).max() > least, f"{unknown.key} has not moved"
    return loop, measured
