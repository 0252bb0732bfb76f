"""Every scene with every sampler: three iterations at the size `tiny`, as configured; and what
its views show."""

from pathlib import Path

import numpy as np
import pytest
from crosses import crossed, some
from omegaconf import OmegaConf
from problems_for_tests import configured, workshop_of
from samplers_for_tests import pixel_samplers
from test_scenes import NAMES

from isas_cli.config import schema
from isas_cli.config.compose import compose, options, translate
from isas_cli.engine import experiment
from isas_cli.engine.loop import Hooks
from isas_cli.engine.workshop import Workshop
from isas_cli.unknowns.parameters import as_numpy

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


@pytest.fixture(scope="module")
def workshop(request) -> Workshop:
    """The problem of one scene, from its configuration, for all samplers."""
    return workshop_of(f"scene={request.param}", *SMALL)


@pytest.mark.parametrize("workshop, sampler", crossed(SCENES, SAMPLERS, 1), indirect=["workshop"])
def test_three_iterations(workshop, sampler):
    chosen = f"scene={workshop.problem.name}", f"sampler={sampler}"
    loop = workshop.loop(*configured(*chosen, *SMALL))
    loop.rehearse()
    rows: list[dict] = []
    status = loop.run(Hooks(evaluated=rows.append))
    workshop.problem.unknowns.write(loop.stepper.values)  # detach

    assert status == "done"
    assert loop.position.iteration == rows[-1]["iteration"] == ITERATIONS
    for unknown in workshop.problem.unknowns:
        found = as_numpy(loop.stepper.values[unknown.key])
        assert np.isfinite(found).all()
        assert unknown.low <= found.min() and found.max() <= unknown.high
        assert np.abs(found - unknown.start).max() > 1e-3, f"{unknown.key} has not moved"
        assert unknown.seen.mean() > 0.15, f"most of {unknown.key} is out of view"
    last = rows[-1]
    assert last["nonfinite"] == 0 and loop.lost == 0
    assert last["gradient_norm"] > 0
    if workshop.problem.name != "caustic_failure":
        assert loop.warnings == []
    measured = {k: v for k, v in last.items() if isinstance(v, float)}
    if len(workshop.problem.unknowns.switches) > 1:
        # The last of these few steps is the first of its level: no mean to be apart from.
        measured.pop("gradient_noise")
    assert {"loss", "image_rmse", "parameter_rmse", "gradient_norm"} <= measured.keys()
    assert all(np.isfinite(v) for v in measured.values()), measured


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


@pytest.mark.parametrize("scene", [*SCENES, *MOVING])
def test_choices_compose_together(scene):
    """Each sampler, each loss and each size with some scene, and each scene with one of each: each
    of these groups is composed by itself, and a composition takes a tenth of a second. All sizes of
    each scene: tests/config/test_config.py."""
    file = OmegaConf.load(Path(schema.folder()) / "scene" / f"{scene}.yaml")
    sizes = OmegaConf.to_container(file.sizes)
    assert list(sizes) == ["tiny", "default", "paper"]
    number, losses = [*SCENES, *MOVING].index(scene), options("loss")
    # What moves is for the samplers that choose no pixels for path replay.
    others = [name for name in options("sampler") if name not in SAMPLERS]
    samplers = others if scene in MOVING else SAMPLERS
    sampler, loss = samplers[number % len(samplers)], losses[number % len(losses)]
    size = list(sizes)[number // len(losses) % len(sizes)]
    chosen = f"scene={scene}", f"sampler={sampler}", f"loss={loss}", f"size={size}"
    cfg = compose(translate(chosen))
    typed, _ = experiment.checked(cfg)
    assert (cfg.scene.name, cfg.sampler.name, cfg.loss.name) == (scene, sampler, loss)
    assert typed.size == size and typed.scene.arguments.items() <= sizes[size].items()
