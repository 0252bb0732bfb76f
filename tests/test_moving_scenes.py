"""Every scene whose objects move, with every gradient that can move them: three iterations at the
size `tiny`, as configured; and one that is solved."""

import numpy as np
import pytest
from test_tiny_scenes import ITERATIONS, MOVING, SMALL, configured

from isas_cli import experiment
from isas_cli.compose import pixel_samplers
from isas_cli.display import Display
from isas_cli.errors import InputError
from isas_cli.experiment import Phases
from isas_cli.optimise import Hooks
from isas_cli.unknowns import as_numpy
from isas_cli.workshop import Workshop

GRADIENTS = {
    "plateau": ["sampler=plateau"],
    "drawn": ["sampler=plateau", "sampler.base=differences"],
    "loss": ["sampler=plateau", "sampler.smooth=loss", "sampler.base=gradient"],
    "renderer": ["sampler=plateau", "sampler.gradient=renderer", "sampler.silhouettes=direct"],
    "mitsuba": ["sampler=mitsuba", "sampler.silhouettes=direct"],
    "finite_differences": ["sampler=finite_differences"],
}


def workshop_of(*overrides: str) -> Workshop:
    _, typed, budget = configured(*overrides)
    with Display(budget) as display:
        return Workshop(experiment.built(typed, Phases(display)))


@pytest.fixture(scope="module", params=MOVING)
def workshop(request) -> Workshop:
    return workshop_of(f"scene={request.param}", *SMALL)


@pytest.mark.parametrize("name", GRADIENTS)
def test_three_iterations(workshop, name):
    scene = workshop.problem.name
    if scene == "sort" and name == "finite_differences":
        pytest.skip("300 renderings a step; the other scenes show that it runs")
    cfg, typed, budget = configured(f"scene={scene}", *GRADIENTS[name], *SMALL)
    loop = workshop.loop(cfg, typed, budget)
    loop.rehearse()
    rows: list[dict] = []
    assert loop.run(Hooks(evaluated=rows.append)) == "done"
    workshop.problem.unknowns.write(loop.stepper.values)
    assert loop.position.iteration == rows[-1]["iteration"] == ITERATIONS
    last = rows[-1]
    assert last["nonfinite"] == 0 and loop.lost == 0 and loop.warnings == []
    measured = {k: v for k, v in last.items() if isinstance(v, float)}
    if name in ("renderer", "mitsuba"):
        del measured["gradient_noise"]  # of a gradient that is zero there is none
    assert all(np.isfinite(v) for v in measured.values()), measured
    for unknown in workshop.problem.unknowns:
        found = as_numpy(loop.stepper.values[unknown.key])
        assert unknown.low <= found.min() and found.max() <= unknown.high
        # On a plateau the baselines stay where they are; that is the point.
        if name in ("plateau", "drawn", "loss"):
            assert np.abs(found - unknown.start).max() > 1e-4, f"{unknown.key} has not moved"


def test_path_replay_refuses_what_moves():
    workshop = workshop_of("scene=shadows", *SMALL)
    for sampler in pixel_samplers():
        with pytest.raises(InputError, match="'ball.place' moves objects.*sampler=plateau"):
            workshop.loop(*configured("scene=shadows", f"sampler={sampler}", *SMALL))


def test_a_hidden_ball_is_found():
    """Occlusion, solved at its tiny size where Mitsuba's derivative stays behind."""
    settings = [*SMALL, "budget.iterations=300", "target.spp=256", "estimator.batch=8192"]
    workshop = workshop_of("scene=occlusion", *settings)
    errors = {}
    for name in ("plateau", "mitsuba"):
        iterations = "budget.iterations=300" if name == "plateau" else "budget.iterations=10"
        chosen = configured("scene=occlusion", *GRADIENTS[name], *settings, iterations)
        loop = workshop.loop(*chosen)
        loop.rehearse()
        rows: list[dict] = []
        loop.run(Hooks(evaluated=rows.append))
        workshop.problem.unknowns.write(loop.stepper.values)
        errors[name] = rows[-1]["parameter_rmse"] / rows[0]["parameter_rmse"]
    print(errors)
    assert errors["plateau"] < 0.05
    assert errors["mitsuba"] > 0.5


@pytest.mark.parametrize(
    "overrides, words",
    [
        (["sampler.base=ours"], "sampler.base=ours: it looks at derivatives"),
        (["sampler.gradient=neither"], "sampler.gradient=neither: valid: kernel, renderer"),
        (["sampler.gradient=renderer", "sampler.common=false"], "sampler.common=False"),
        (["sampler.gradient=renderer", "sampler.base=gradient"], "must be uniform"),
        (["sampler.silhouettes=direct"], "sampler.silhouettes=direct: only"),
        (["sampler.pairs=0"], "sampler.pairs=0: at least 1"),
        (["sampler.smooth=time"], "sampler.smooth=time: valid: image, loss"),
    ],
)
def test_settings_that_make_no_sense_are_refused(overrides, words):
    from isas_cli.compose import instantiate

    with pytest.raises(InputError, match=words):
        instantiate(configured("scene=cup", "sampler=plateau", *overrides)[0].sampler, "sampler")
