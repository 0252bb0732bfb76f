"""Every scene whose objects move, with every gradient that can move them: three iterations at the
size `tiny`, as configured; and one that is solved."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from crosses import crossed, some
from samplers_for_tests import pixel_samplers
from test_tiny_scenes import ITERATIONS, MOVING, SMALL, configured

from isas_cli.engine import experiment
from isas_cli.engine.display import Display
from isas_cli.engine.experiment import Phases
from isas_cli.engine.loop import Hooks
from isas_cli.engine.workshop import Workshop
from isas_cli.rendering.integrators import Unrolled
from isas_cli.runtime.errors import InputError, NumericalError
from isas_cli.unknowns.parameters import as_numpy

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


@pytest.fixture(scope="module")
def workshop(request) -> Workshop:
    return workshop_of(f"scene={request.param}", *SMALL)


# Finite differences of sort take 300 renderings a step; the other scenes show that they run.
CROSSED = [
    pair
    for pair in crossed(MOVING, [*GRADIENTS], 1, always=["plateau"])
    if pair.values != ("sort", "finite_differences")
]


@pytest.mark.parametrize("workshop, name", CROSSED, indirect=["workshop"])
def test_three_iterations(workshop, name):
    scene = workshop.problem.name
    loop = workshop.loop(*configured(f"scene={scene}", *GRADIENTS[name], *SMALL))
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


@pytest.mark.parametrize("workshop", ["occlusion"], indirect=True)
@pytest.mark.parametrize("spp, share, status", ((1, 1.0, "refused"), (2, 0.1, "done")))
def test_a_path_that_is_not_a_number_costs_its_step(monkeypatch, workshop, spp, share, status):
    """Now and then: the step is left out and counted. Every time: the run says so and stops, with
    its values as they were."""
    whole = Unrolled.primal

    def broken(integrator, scene, sampler, ray):
        radiance, state = whole(integrator, scene, sampler, ray)
        first = dr.arange(mi.UInt32, dr.width(ray.o)) == 0
        return dr.select(first & (sampler.next_1d() < share), np.nan, radiance), state

    settings = [*SMALL, "budget.iterations=40", f"sampler.spp={spp}"]
    workshop = Workshop(workshop.problem)  # its kernels are recorded with what is broken
    loop = workshop.loop(*configured("scene=occlusion", "sampler=plateau", *settings))
    monkeypatch.setattr(Unrolled, "primal", broken)
    values, bad = [], []

    def watched(loop, progress):
        values.append(float(loop.stepper.values["red.depth"][0]))
        bad.append(int(loop.stepper.nonfinite[0]))

    if status == "refused":
        with pytest.raises(NumericalError, match="were not finite"):
            loop.run(Hooks(stepped=watched))
        start = float(workshop.problem.unknowns.starts()["red.depth"][0])
        assert np.all(np.array(values) == start)
        return
    assert loop.run(Hooks(stepped=watched)) == "done"
    left_out = np.diff(bad) > 0
    print(left_out.sum(), "steps left out")
    assert 0 < left_out.sum() < 30
    moved = np.diff(values) != 0
    assert not moved[left_out].any() and moved[~left_out].all()


@pytest.mark.parametrize("workshop", ["occlusion"], indirect=True)
@pytest.mark.parametrize(
    "settings, expected",
    (
        # The residual's two renderings have half of a pair's paths each, at least 1, unless given.
        (["sampler=plateau"], (2 + 2, 2 + 6)),
        (["sampler=plateau", "sampler.residual_spp=6"], (6 + 2, 6 + 6)),
        (["sampler=plateau", "sampler.smooth=loss"], (1, 3)),
        (["sampler=finite_differences"], (1, 3)),
    ),
    ids=("image", "residual", "loss", "finite_differences"),
)
def test_paths_of_a_pixel_are_a_setting(workshop, settings, expected):
    """In the proportions ``expected`` of steps with 1 and 3; one of which is run."""
    one, three = (
        workshop.loop(*configured("scene=occlusion", *settings, *SMALL, f"sampler.spp={spp}"))
        for spp in (1, 3)
    )
    paths = one.estimator.paths_per_step, three.estimator.paths_per_step
    assert paths[1] * expected[0] == paths[0] * expected[1]
    if settings == ["sampler=plateau"]:
        three.rehearse()
        assert three.run(Hooks()) == "done" and three.position.iteration == ITERATIONS
        assert three.position.paths == ITERATIONS * paths[1]


@pytest.mark.parametrize("workshop", ["occlusion"], indirect=True)
@pytest.mark.parametrize("budget", ("iterations=24", "seconds=1", "paths=150000"))
def test_the_blur_follows_the_budget(monkeypatch, workshop, budget):
    """In whatever it is measured."""
    settings = [setting for setting in SMALL if "budget" not in setting]
    chosen = configured("scene=occlusion", "sampler=plateau", *settings, f"budget.{budget}")
    loop = workshop.loop(*chosen)
    loop.rehearse()
    told, spent = [], []
    estimate = loop.estimator.estimate

    def watched(*arguments):
        told.append(arguments[-1])
        spent.append(loop.spent)
        return estimate(*arguments)

    monkeypatch.setattr(loop.estimator, "estimate", watched)
    assert loop.run(Hooks()) == "done"
    assert told == pytest.approx(spent, abs=0.02)
    assert told[0] == 0 and np.all(np.diff(told) > 0) and told[-1] > 0.9


@pytest.mark.parametrize("workshop", ["shadows"], indirect=True)
def test_path_replay_refuses_what_moves(workshop):
    for sampler in pixel_samplers():
        with pytest.raises(InputError, match="'ball.place' moves objects.*sampler=plateau"):
            workshop.loop(
                *configured("scene=shadows", "~scene.method", f"sampler={sampler}", *SMALL)
            )


@pytest.mark.parametrize("name", some(("plateau", "mitsuba"), ("plateau",)))
def test_a_hidden_ball_is_found(name):
    """Occlusion, solved at its tiny size, where Mitsuba's derivative stays behind in as many
    iterations."""
    settings = [*SMALL, "budget.iterations=300", "target.spp=256", "estimator.batch=8192"]
    workshop = workshop_of("scene=occlusion", *settings)
    loop = workshop.loop(*configured("scene=occlusion", *GRADIENTS[name], *settings))
    loop.rehearse()
    rows: list[dict] = []
    loop.run(Hooks(evaluated=rows.append))
    workshop.problem.unknowns.write(loop.stepper.values)
    left = rows[-1]["parameter_rmse"] / rows[0]["parameter_rmse"]
    print(left)
    assert left < 0.05 if name == "plateau" else left > 0.5


@pytest.mark.parametrize(
    "overrides, words",
    [
        (["sampler.base=ours"], "sampler=ours looks at derivatives"),
        (["sampler.gradient=neither"], "estimator.gradient=neither: valid: kernel, renderer"),
        (["sampler.gradient=renderer", "sampler.common=false"], "estimator.common=False"),
        (["sampler.gradient=renderer", "sampler.base=gradient"], "take sampler=uniform"),
        (["sampler.silhouettes=direct"], "estimator.silhouettes=direct: only"),
        (["sampler.pairs=0"], "estimator.pairs=0: at least 1"),
        (["sampler.spp=0"], "estimator.spp=0: at least 1"),
        (["sampler=finite_differences", "sampler.spp=0"], "estimator.spp=0: at least 1"),
        (
            ["sampler=finite_differences", "sampler.step=inf"],
            "estimator.step=inf: must be",
        ),
        (["sampler.gradient=renderer", "sampler.spp=4"], "estimator.spp=4: the renderer's"),
        (["sampler.smooth=time"], "estimator.smooth=time: valid: image, loss"),
        (["sampler.residual=two"], "estimator.residual=two: valid: pair, one"),
        (["sampler.residual=one", "sampler.smooth=loss"], "estimator.residual=one: only"),
        (["sampler.residual_spp=4", "sampler.smooth=loss"], "estimator.residual_spp=4: only"),
        (["sampler.residual_spp=1"], "estimator.residual_spp=1: even, at least 2"),
        (["sampler.residual_spp=13"], "estimator.residual_spp=13: even"),
        (["sampler.residual=one", "sampler.gradient=renderer"], "estimator.residual=one: only"),
    ],
)
def test_settings_that_make_no_sense_are_refused(overrides, words):
    settings = overrides if "sampler=" in overrides[0] else ["sampler=plateau", *overrides]
    with pytest.raises(InputError, match=words):
        choices, typed, _ = configured("scene=cup", *settings)
        choices.check(typed)
