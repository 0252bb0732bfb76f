"""Grids from coarse to fine: what resampling keeps, and what a run makes of levels."""

import io

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from PIL import Image, ImageSequence
from scenes_for_tests import TEXTURE, dictionary, render_targets, without_targets
from scipy import ndimage
from volumes_for_tests import ALBEDO, DENSITY, N, problem, through_the_middle, uneven

from isas_cli import losses
from isas_cli.config.schema import OptimizerConfig, UnknownConfig
from isas_cli.engine.evaluate import Evaluator
from isas_cli.engine.loop import Hooks, Loop
from isas_cli.engine.optimiser import Stepper
from isas_cli.estimators.two_path import TwoPath
from isas_cli.rendering import coverage, rays, turntable, volume
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.runtime.budget import Budget
from isas_cli.runtime.errors import InputError
from isas_cli.samplers.ours import Ours
from isas_cli.samplers.progress import Progress
from isas_cli.samplers.sampler import Stage1Settings
from isas_cli.samplers.uniform import Uniform
from isas_cli.scene.file_checks import read_bounds
from isas_cli.unknowns.parameters import as_numpy, flat

STAGE1 = Stage1Settings(resolution=8, spp=2, denoise="none")
# Of one channel, of odd sides, of sides that are no multiples, flat.
SHAPES = [(8, 8, 8, 1), (5, 6, 7, 3), (1, 4, 2, 1)]


def grid_of(shape: tuple[int, ...]):
    density = np.full(shape[:3], 1.0)
    kind = problem(density, np.full((*shape[:3], 3), 0.5)).unknowns[DENSITY].kind
    kind.present = np.zeros(shape, np.float32)
    return kind


@pytest.mark.parametrize("shape", SHAPES)
def test_resampling_keeps_constants_and_means(shape, rng):
    kind = grid_of(shape)
    array = rng.uniform(0, 1, shape).astype(np.float32)
    for doublings in range(1, kind.doublings + 1):
        smaller = kind.shape(doublings)
        assert smaller[3] == shape[3] and max(smaller[:3]) >= 2
        coarse = kind.coarse(array, smaller)
        assert coarse.shape == smaller and coarse.mean() == pytest.approx(array.mean(), rel=1e-5)
        np.testing.assert_allclose(kind.coarse(np.full(shape, 0.7), smaller), 0.7, rtol=1e-6)
        whole = kind.whole(kind.value(coarse))
        assert whole.shape == shape
        assert coarse.min() - 1e-6 <= whole.min() and whole.max() <= coarse.max() + 1e-6
        flat_ = kind.whole(kind.value(np.full(smaller, 0.7, np.float32)))
        np.testing.assert_allclose(flat_, 0.7, rtol=1e-6)
        if not any(side % few for side, few in zip(shape, smaller)):
            assert whole.mean() == pytest.approx(array.mean(), rel=1e-5)
    np.testing.assert_array_equal(kind.whole(kind.value(array)), array)


def test_a_coarser_grid_is_interpolated_at_the_finer_points(rng):
    kind = grid_of((8, 6, 4, 3))
    coarse = rng.uniform(0, 1, kind.shape(1)).astype(np.float32)
    places = [
        (np.arange(many) + 0.5) / many * few - 0.5
        for many, few in zip(kind.present.shape[:3], coarse.shape[:3])
    ]
    where = np.meshgrid(*places, indexing="ij")
    expected = np.stack(
        [ndimage.map_coordinates(coarse[..., c], where, order=1, mode="nearest") for c in range(3)],
        axis=-1,
    )
    np.testing.assert_allclose(kind.whole(kind.value(coarse)), expected, atol=1e-6)


@pytest.mark.parametrize(
    "levels, words",
    [
        (0, "a number of levels, at least 1"),
        (True, "a number of levels"),
        ([0.6, 0.3], "rising between 0 and 1"),
        ([0.5, 1.0], "rising between 0 and 1"),
        ("many", "rising between 0 and 1"),
        (3, "at most 2 levels, the coarsest of"),
    ],
)
def test_levels_that_cannot_be_are_one_line(levels, words):
    with pytest.raises(InputError, match=f"levels.*{words}"):
        problem(*uneven(), levels=levels)


def test_textures_have_no_levels():
    scene = dictionary()
    with pytest.raises(InputError, match="levels=2: what it is of .texture, .* has one level"):
        without_targets(scene, {TEXTURE: UnknownConfig(start=0.5, levels=2)})


def test_levels_follow_the_budget():
    p = problem(*uneven(8), levels=3)
    assert p.unknowns.switches == pytest.approx([0, 1 / 7, 3 / 7])
    assert [p.unknowns.level(x) for x in (0, 0.14, 0.15, 0.43, 1)] == [0, 0, 1, 2, 2]
    sides = [p.unknowns.shapes(level)[ALBEDO][0] for level in range(3)]
    assert sides == [2, 4, 8]
    p.unknowns[ALBEDO].doubled = (0.3,)
    assert p.unknowns.switches == pytest.approx([0, 1 / 7, 0.3, 3 / 7])
    assert [p.unknowns.shapes(level)[ALBEDO][0] for level in range(4)] == [4, 4, 8, 8]
    assert [p.unknowns.shapes(level)[DENSITY][0] for level in range(4)] == [2, 4, 4, 8]


def steps(p, freeze: bool) -> list[np.ndarray]:
    """Whole values after Adam's steps at both levels, from one estimator."""
    estimator = TwoPath(p, losses.L2(), 2048, freeze)
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    stepper, found = Stepper(p.unknowns, OptimizerConfig(lr=0.1, schedule="constant")), []
    for iteration in range(12):
        if iteration == 6:
            before = p.unknowns.arrays(stepper.values)
            stepper.refine(1)
            after = p.unknowns.arrays(stepper.values)
            for key in before:  # the next level is the whole grid: nothing is lost
                np.testing.assert_allclose(after[key], before[key], atol=1e-6)
        gradients = estimator.estimate(stepper.values, uniform, 1, iteration, 0.0)
        assert all(tuple(g.shape) == tuple(stepper.values[k].shape) for k, g in gradients.items())
        stepper.step(gradients, 0.0)
        arrays = p.unknowns.arrays(stepper.values)
        found.append(np.concatenate([array.ravel() for array in arrays.values()]))
    p.unknowns.write(stepper.values)
    return found


def test_frozen_kernels_follow_adam_through_levels():
    found = []
    for freeze in (True, False):
        p = problem(*uneven(), "emission", levels=2)
        render_targets(p, 64)
        found.append(np.stack(steps(p, freeze)))
    moved = np.abs(np.diff(found[1], axis=0)).max(axis=1)
    assert (moved > 1e-3).all(), "every step moves something"
    np.testing.assert_allclose(*found, atol=1e-3)


def loop(p, sampler, iterations: int, batch: int = 1024) -> Loop:
    loss = losses.L2()
    at_work = sampler.on(p, loss, batch)
    stepper = Stepper(p.unknowns, OptimizerConfig(lr=0.1))
    evaluator = Evaluator(p, loss, 10_000, 4, 1)
    made = Loop(
        p, at_work, stepper, evaluator, Budget(iterations=iterations), TwoPath(p, loss, batch), 1, 5
    )
    made.rehearse()
    return made


@pytest.fixture(scope="module")
def glowing():
    p = problem(*uneven(), "emission", levels=[0.5])
    render_targets(p, 256)
    return p


def test_a_run_passes_through_its_levels(glowing):
    p, ours = glowing, Ours(refresh=0, stage1=STAGE1)
    made, rows, sides, kept = loop(p, ours, 40), [], [], []

    def stepped(l, spent):
        sides.append(l.stepper.values[DENSITY].shape[0])
        kept.append(l.stepper.taken)

    assert made.run(Hooks(evaluated=rows.append, stepped=stepped)) == "done"
    p.unknowns.write(made.stepper.values)
    assert sides == [2] * 20 + [4] * 20
    assert kept == [*range(1, 21), *range(1, 21)], "moments begin anew"
    assert rows[-1]["image_rmse"] < 0.5 * rows[0]["image_rmse"]
    # A look where each level begins.
    assert rows[-1]["paths"] == 40 * 2 * 1024 + 2 * made.sampler.paths_per_look
    assert made.stepper.scales[0][DENSITY] != made.stepper.scales[1][DENSITY]
    assert set(made.clock.billed_seconds) == {"stage1", "step"}


def test_progress_looks_at_each_level_anew(glowing):
    p, shapes, surveys = glowing, [], []
    made = loop(p, Progress(refresh=10, stage1=STAGE1), 24)
    sampler = made.sampler
    honest = sampler._survey
    sampler._survey = lambda seed, shapes: surveys.append(shapes) or honest(seed, shapes)
    look, looked = sampler.look, []
    sampler.look = lambda values, seed, i, *more: looked.append(i) or look(values, seed, i, *more)

    def stepped(l, spent):
        shapes.append({k: dr.width(flat(v)) for k, v in l.stepper.values.items()})

    made.run(Hooks(stepped=stepped))
    p.unknowns.write(made.stepper.values)
    assert shapes[0] == shapes[11] == {DENSITY: 8, ALBEDO: 24}
    assert shapes[12] == shapes[-1] == {DENSITY: 64, ALBEDO: 192}
    # Surveys where a level begins, and nowhere else: those of the rehearsal are not used.
    assert surveys == [p.unknowns.shapes(0), p.unknowns.shapes(1)]
    assert looked == [0, 10, 12, 20], "12 is where the level begins"
    paths = 24 * 2 * 1024 + 4 * sampler.paths_per_look + 2 * sampler.paths_before
    assert made.position.paths == paths


def test_a_continued_run_is_at_its_level(glowing):
    p, uniform = glowing, Uniform()
    made = loop(p, uniform, 20)
    made.run(Hooks(stop=lambda: made.position.iteration == 13))
    arrays, state = made.export()
    again = loop(p, uniform, 200)  # by the larger budget, 13 steps would be the first level
    again.restore(arrays, state)
    assert again.stepper.level == 1 and again.stepper.taken == 3
    assert again.stepper.scales == made.stepper.scales
    again.advance(Hooks(), 0.0)
    p.unknowns.write(again.stepper.values)
    assert again.stepper.values[DENSITY].shape == (4, 4, 4, 1) and again.position.iteration == 14


def test_what_is_no_finer_keeps_its_moments(glowing):
    p = glowing
    stepper = Stepper(p.unknowns, OptimizerConfig(lr=0.1))
    p.unknowns[ALBEDO].doubled = ()
    try:
        stepper = Stepper(p.unknowns, OptimizerConfig(lr=0.1))
        rng = np.random.default_rng(1)
        for _ in range(3):
            stepper.step(_noise(stepper.values, rng), 0.0)
        before, _ = stepper.export()
        stepper.refine(1)
        after, state = stepper.export()
        for name in ("value", "first", "second", "visits"):
            np.testing.assert_array_equal(before[f"{name}/{ALBEDO}"], after[f"{name}/{ALBEDO}"])
        assert not after[f"first/{DENSITY}"].any() and not after[f"visits/{DENSITY}"].any()
        assert state["steps"] == {DENSITY: 0, ALBEDO: 3}
        stepper.calibrate([_noise(stepper.values, rng)])
        assert stepper.scales[1][ALBEDO] == stepper.scales[0][ALBEDO]
        assert stepper.scales[1][DENSITY] != stepper.scales[0][DENSITY]
    finally:
        p.unknowns[ALBEDO].doubled = (0.5,)


def _noise(values: dict, rng: np.random.Generator) -> dict:
    return {
        key: type(value)(mi.Float(rng.normal(size=dr.width(flat(value)))), value.shape)
        for key, value in values.items()
    }


def test_evaluations_and_pictures_are_whole(glowing):
    p = glowing
    values = p.unknowns.starts(p.unknowns.shapes(0))
    assert as_numpy(values[DENSITY]).shape == (2, 2, 2, 1)
    assert p.unknowns.arrays(values)[ALBEDO].shape == (4, 4, 4, 3)
    evaluator = Evaluator(p, losses.L2(), 1000, 2, 1)
    coarse, whole = evaluator(values), evaluator(p.unknowns.starts())
    p.unknowns.write(p.unknowns.starts())
    for name in coarse:  # the start is constant, so both stand for the same
        assert coarse[name] == pytest.approx(whole[name], rel=1e-4), name


def test_the_error_counts_what_matters_at_the_truth(monkeypatch, tmp_path):
    """A thin shell around an opaque core of 4³ in 8³: points deep within count nowhere; an emission
    counts only where there is something to emit."""
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    density = np.full((8, 8, 8), 1e-3)
    density[2:6, 2:6, 2:6] = 60.0
    p = problem(density, 0.4, "emission")
    coverage.fill_in(p, 1)
    seen, glow = p.unknowns[DENSITY].seen[..., 0], p.unknowns[ALBEDO].seen.any(axis=3)
    assert not seen[3:5, 3:5, 3:5].any() and not glow[3:5, 3:5, 3:5].any()
    # The side that the camera looks at from the front, right and above, and the air around.
    assert seen[7].mean() > 0.5
    empty = density < 1
    empty[1:7, 1:7, 1:7] = False  # beside the core, points are interpolated with it
    assert not glow[empty].any() and glow[5, 2:6, 2:6].any()


def test_no_density_at_all_is_judged_at_the_start(monkeypatch, tmp_path):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    p = problem(0.0, 0.4, "emission")
    coverage.fill_in(p, 1)
    assert p.unknowns[ALBEDO].seen.mean() > 0.5 and p.unknowns[DENSITY].seen.mean() > 0.5


def test_what_glows_is_seen_where_no_density_is_known_yet(monkeypatch, tmp_path):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    p = problem(2.0, 0.4, "emission", density=0.0)
    for each in p.unknowns:
        each.truth = None
    coverage.fill_in(p, 1)
    assert p.unknowns[ALBEDO].seen.mean() > 0.5 and p.unknowns[DENSITY].seen.mean() > 0.5


def test_starts_from_files(tmp_path, rng):
    kind = problem(*uneven()).unknowns[DENSITY].kind
    wanted = rng.uniform(0, 1, (4, 4, 4, 1)).astype(np.float32)
    np.save(tmp_path / "grid.npy", wanted[..., 0])
    (tmp_path / "grid.vol").write_bytes(kind.files(wanted)["vol"])
    for name in ("grid.npy", "grid.vol"):
        np.testing.assert_array_equal(kind.start(str(tmp_path / name), "start"), wanted)
    np.save(tmp_path / "other.npy", np.zeros((2, 4, 4)))
    (tmp_path / "bad.vol").write_bytes(b"VOL")
    for name, words in (
        ("other.npy", r"is \(2, 4, 4, 1\) of float64, the grid \(4, 4, 4, 1\)"),
        ("bad.vol", "bad.vol: "),
        ("none.npy", "a .npy or .vol file that exists"),
        ("smoke.vdb", r"OpenVDB has no package.* z first: np.save\(f, a.transpose\(2, 1, 0\)\)"),
        ("grid.exr", "a .npy or .vol file that exists"),
    ):
        with pytest.raises(InputError, match=words) as told:
            kind.start(str(tmp_path / name), "start")
        assert "\n" not in str(told.value)


def test_a_grid_s_file_says_what_box_it_fills(tmp_path):
    """Into which Mitsuba puts it by `use_grid_bbox`."""
    kind = problem(*uneven()).unknowns[DENSITY].kind
    (tmp_path / "grid.vol").write_bytes(kind.files(kind.present)["vol"])
    assert read_bounds(tmp_path / "grid.vol") == pytest.approx((-1, -1, -1, 1, 1, 1))


def test_volumes_turn(rng):
    """A column off the middle is seen at other places from other sides, as bright."""
    kind = grid_of((8, 8, 8, 1))
    column = np.zeros((8, 8, 8, 1), np.float32)
    column[4, 2:6, 6] = 2.0
    assert kind.volume(column).shape == (8, 8, 8)
    assert grid_of((8, 8, 8, 3)).volume(np.zeros((8, 8, 8, 3), np.float32)) is None
    shown = {"truth": kind.volume(column), "result": kind.volume(column / 2)}
    content = turntable.of_volumes(shown)
    frames = ImageSequence.Iterator(Image.open(io.BytesIO(content)))
    pictures = np.stack([np.array(frame.convert("L"), float) for frame in frames])
    assert pictures.shape[1] * 2 == pictures.shape[2] and len(pictures) > 10
    truth, result = np.split(pictures, 2, axis=2)
    assert truth[0].max() > 200 and 100 < result[0].max() < 0.9 * truth[0].max()
    middles = [(p.sum(axis=0) @ np.arange(p.shape[1])) / p.sum() for p in truth]
    assert np.ptp(middles) > 0.3 * truth.shape[2]


@pytest.mark.parametrize("integrator", ["prbvolpath", "emission"])
def test_a_path_s_work_is_its_collisions(integrator, monkeypatch):
    """Through an even medium as many as the majorant times the way, roulette left out."""
    monkeypatch.setattr(volume, "_WEAK", 0.0)
    p = problem(0.8, 0.6, integrator)
    found = {}
    for name, ray in (
        ("through", through_the_middle(p)),
        ("beside", mi.Ray3f(dr.full(mi.Point3f, 0, N) + [3, 0, 5], mi.Vector3f(0, 0, -1))),
    ):
        with dr.suspend_grad():
            work = p.integrator.work(p.scene, rays.stream(mi.UInt32(1), N), ray)
        found[name] = np.array(work, np.float64)
    assert not found["beside"].any()
    majorant = volume._FEWEST["emits" if integrator == "emission" else "scatters"] / 2
    assert majorant > 1.1 * 0.8
    way = 2.0
    mean, error = found["through"].mean(), found["through"].std() / np.sqrt(N)
    print(mean, majorant * way, error)
    if integrator == "emission":
        assert abs(mean - majorant * way) < 5 * error
    else:  # paths that scatter stay longer, or leave sooner
        assert 0.5 * majorant * way < mean < 2 * majorant * way
