"""Every scene with every sampler: three iterations at the size `tiny`, as configured; and what
its views show."""

import numpy as np
import pytest
from crosses import crossed, some
from problems_for_tests import configured, iterated, workshop_of, workshops
from samplers_for_tests import pixel_samplers
from test_scenes import NAMES

from isas_cli.config.compose import options
from isas_cli.engine.loop import Hooks
from isas_cli.engine.workshop import Workshop

MOVING = ["caustic", "cup", "global_illumination", "occlusion", "shadows", "shadows_prdpt", "sort"]
SHAPES = ["dodoco_b", "kirby", "shadowplay"]
JOINT = ["object_joint_shape"]  # test_joint_scenes.py
PHOTOS = ["photos", "chessboard"]  # tests/engine/test_photo_runs.py
OTHERS = ["file", "external", *MOVING, *SHAPES, *JOINT, *PHOTOS]
SCENES = [name for name in options("scene") if name not in OTHERS]
SAMPLERS = pixel_samplers()
ITERATIONS = 3
SMALL = [
    "size=tiny",
    f"budget.iterations={ITERATIONS}",
    "target.spp=8",
    "estimator.batch=1024",
    "evaluation.count=2",
    "evaluation.pixels=512",
    "evaluation.spp=2",
]


workshop = workshops(*SMALL)


@pytest.mark.parametrize("workshop, sampler", crossed(SCENES, SAMPLERS, 1), indirect=["workshop"])
def test_three_iterations(workshop, sampler):
    # The last of these few steps may be the first of its level: no mean to be apart from.
    levels = len(workshop.problem.unknowns.switches) > 1
    loop, last = iterated(workshop, [f"sampler={sampler}", *SMALL], 1e-3, levels)
    assert loop.position.iteration == ITERATIONS
    for unknown in workshop.problem.unknowns:
        assert unknown.seen.mean() > 0.15, f"most of {unknown.key} is out of view"
    assert last["gradient_norm"] > 0
    if workshop.problem.name != "caustic_failure":
        assert loop.warnings == []
    assert {"loss", "image_rmse", "parameter_rmse"} <= last.keys()


@pytest.mark.parametrize("workshop", SCENES, indirect=True)
def test_every_view_is_finite_and_lit(workshop):
    problem = workshop.problem
    assert not any("not finite" in warning for warning in problem.warnings)
    for view in range(len(problem.film_sizes)):
        image = problem.target_image(view)
        assert np.isfinite(image).all() and (image >= 0).all()
        if problem.name in NAMES:
            assert (image.mean(axis=2) > 1e-3).mean() > 0.95


@pytest.mark.parametrize("workshop", ["pottery"], indirect=True)
def test_views_of_the_spiral_differ(workshop):
    images = [workshop.problem.target_image(view) for view in range(2)]
    assert np.abs(images[0] - images[1]).mean() > 0.05


@pytest.fixture(scope="module")
def roughness() -> Workshop:
    return workshop_of("scene=trashcan", *SMALL)


@pytest.mark.parametrize("sampler", some(SAMPLERS, ("progress",)))
def test_derivative_sampling_with_each_sampler(roughness, sampler):
    """From the setting to the steps, which take five paths a pixel instead of two."""
    loops = {}
    for special in ("false", "true"):
        chosen = [f"sampler={sampler}", f"estimator.derivative_sampling={special}"]
        if sampler == "progress":
            chosen += ["sampler.refresh=0"]  # its look at the start, not after many steps
        loops[special] = roughness.loop(*configured("scene=trashcan", *chosen, *SMALL))
        loops[special].rehearse()
        assert loops[special].run(Hooks()) == "done"
        roughness.problem.unknowns.write(loops[special].stepper.values)  # detach
    plain, drawn = loops["false"], loops["true"]
    (key,) = roughness.problem.unknowns.keys
    values = [float(loop.stepper.values[key][0]) for loop in (plain, drawn)]
    assert values[0] != values[1] and all(0.05 <= v < 0.8 or v > 0.8 for v in values)
    assert "two parts" in drawn.problem.integrator.derivatives
    assert "two parts" not in plain.problem.integrator.derivatives
    batch = ITERATIONS * 1024
    steps = [loop.position.paths - looks(loop) for loop in (plain, drawn)]
    assert steps == [2 * batch, 5 * batch]
    # Paths that give derivatives count fourfold, those that give residuals once.
    assert looks(drawn) == looks(plain) + 3 * DERIVATIVES[sampler](plain.sampler)


def looks(loop) -> int:
    """Paths of all looks of a run of ITERATIONS."""
    sampler = loop.sampler
    later = sum(map(sampler.settings.due, range(ITERATIONS)))
    return sampler.paths_before + sampler.paths_per_look * later


def cells(sampler) -> int:
    return sampler.cells.count * sampler.settings.stage1.spp


# Paths that give derivatives, in all looks of ITERATIONS iterations at the defaults, one unknown.
DERIVATIVES = {
    "uniform": lambda s: 0,
    "relevant": lambda s: cells(s) * s.settings.stage1.probes,
    "gradient": lambda s: 0,
    "ours": cells,
    "joint": cells,
    "balanced": lambda s: cells(s) * (s.settings.passes + 1),
    # Looks at iterations 0, 1 and 2.
    "preconditioned": lambda s: 3 * cells(s),
    "multiresolution": cells,
    # Two at each look and two of the survey, both as often as there are passes.
    "progress": lambda s: s.settings.passes * cells(s) * 4,
}
