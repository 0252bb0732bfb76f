"""The sampler `progress`: its two fixed points, its masses, its costs."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from brute_force import PerPath, cell_means
from scenes_for_tests import ROUGHNESS, TEXTURE, problem
from scipy.optimize import minimize

from isas_cli import losses
from isas_cli.config.schema import OptimizerConfig
from isas_cli.engine.evaluate import Evaluator
from isas_cli.engine.optimiser import Stepper
from isas_cli.rendering import rays
from isas_cli.runtime.errors import InputError
from isas_cli.samplers import progress
from isas_cli.samplers.allocation import masses, tangents
from isas_cli.samplers.progress import Masses, Progress
from isas_cli.samplers.sampler import Moments, Stage1Settings
from isas_cli.samplers.stage1.cells import Cells
from isas_cli.samplers.stage1.path_cost import PathCost


def prepared(p, resolution: int, spp: int, batch: int = 512, **settings) -> Masses:
    stage1 = Stage1Settings(resolution=resolution, spp=spp, denoise="none", average=0.5)
    return Progress(stage1=stage1, **settings).on(p, losses.L2(), batch)


def first_look(p, sampler: Masses, base: int = 1) -> np.ndarray:
    weights = np.array(sampler.look(p.unknowns.starts(), base, 0), np.float64)
    p.unknowns.write(p.unknowns.starts())
    return weights / weights.sum()


def _survey(sampler: Masses) -> tuple:
    (found,) = sampler._surveys.values()
    return found


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Total variation between two pmfs, in [0, 1]."""
    return float(np.abs(a / a.sum() - b / b.sum()).sum() / 2)


def test_one_unknown_is_drawn_by_least_variance_per_time():
    """Fixed point 1: p ∝ √(Σ_c p_1c) J / √c for a single number that all channels share, against
    brute force on other paths; up to the order of the sum over channels and the root."""
    p = problem({ROUGHNESS: 0.5}, resolution=(24, 16))
    sampler = prepared(p, 8, 512, passes=4)
    found = first_look(p, sampler)
    cells = sampler.cells
    paths = PerPath(p, losses.L2(), cells, 1024)
    residual = paths.residuals(9, 0)
    derivative = paths.derivatives(9, 0)[0]
    p.unknowns.write(p.unknowns.starts())
    first, second = (cell_means(x**2, 1024) for x in (residual, derivative))
    cost = np.array(_survey(sampler)[1])
    least_variance = np.sqrt((first * second).sum(axis=0) / cost)
    size = np.sqrt(first * second).sum(axis=0) / np.sqrt(cost)
    by_mean = (np.sqrt(first) * cell_means(np.abs(derivative), 1024)).sum(axis=0) / np.sqrt(cost)
    print(*(distance(found, other) for other in (size, least_variance, by_mean)))
    assert distance(found, size) < 0.06
    assert distance(found, least_variance) < 0.06
    assert distance(by_mean, least_variance) > 0.1, "a mean of |J| would do as well"
    assert distance(np.ones(found.size), least_variance) > 0.4, "the case shows nothing"


def test_curvature_is_the_second_difference_of_the_loss():
    """Of a number that the images are linear in; cells are of 2 × 2 pixels."""
    key = "sky.radiance.value"
    p = problem({key: 0.5}, resolution=(24, 16))
    sampler = prepared(p, 12, 32)
    assert np.allclose(np.array(sampler.cells.scale_x), 2)
    assert np.allclose(np.array(sampler.cells.scale_y), 2)
    first_look(p, sampler)
    evaluator, step = Evaluator(p, losses.L2(), p.views.total, 64, 1), 0.2
    low, middle, high = (
        evaluator(p.unknowns.values_of({key: p.unknowns[key].start + np.float32(s)}))["loss"]
        for s in (-step, 0, step)
    )
    p.unknowns.write(p.unknowns.starts())
    wanted = (low - 2 * middle + high) / step**2
    found = float(dr.sum(_survey(sampler)[0][key])[0])
    print(found / wanted)
    assert found == pytest.approx(wanted, rel=0.3)


def test_one_unknown_ignores_how_much_mass_an_unknown_should_get():
    """With a single unknown its mass is 1, whatever curvature and moments say."""
    c, h = {"a": mi.Float([3.0])}, {"a": mi.Float([0.1])}
    moments = Moments(*({"a": mi.Float([x])} for x in (1e-3, 5.0, 0.2)), {"a": 0.02})
    for given in (None, moments):
        assert np.allclose(np.array(tangents(c, h, given, 0.01)["a"]), 1)


def test_a_texture_of_like_texels_gets_equal_mass_per_texel():
    """Fixed point 2, in closed form: texel k has n_k pixels of its own with the same r and J."""
    n = np.array([1.0, 4, 9, 50, 400])
    r, j = 0.7, 0.2
    c, h = {"t": mi.Float(n * r * j)}, {"t": mi.Float(n * j**2)}
    mass = np.array(masses(c, h, None, 1e-6)["t"])
    assert np.allclose(mass, mass[0], rtol=1e-4)
    along = np.array(tangents(c, h, None, 1e-6)["t"])
    assert np.allclose(along * r * j * n, along[0] * r * j, rtol=1e-4)  # n pixels share a mass


def test_a_texture_on_a_scene_gets_more_equal_mass_than_uniform_gives():
    """Fixed point 2 on a floor whose texels differ in how many pixels see them, with noise that
    differs little: the sampler's masses per texel are near equal, uniform's are not."""
    p = problem({TEXTURE: 0.5}, size=4, resolution=(48, 32), depth=2, constant_target=3.0)
    sampler = prepared(p, 48, 16, passes=4, overhead=1e6)  # costs alike
    found = first_look(p, sampler)
    exact = np.abs(PerPath(p, losses.L2(), sampler.cells, 32).derivatives(9, 0))
    p.unknowns.write(p.unknowns.starts())
    share = exact.reshape(len(exact), 3, sampler.cells.count, 32).mean(axis=3).sum(axis=1)
    share /= share.sum(axis=0).clip(1e-30)  # of each cell's mass, by texel and channel

    def spread(pmf):
        mass = (share * pmf).sum(axis=1)
        return mass.std() / mass.mean()

    assert spread(found) < 0.5 * spread(np.ones(found.size) / found.size)


def expected_error(mass, c, h, δ, η):
    s = c / np.sqrt(mass)
    x = η * s / (2 * h * δ**2)
    return (δ**2 * x / (1 + x)).sum()


def test_masses_minimise_what_adam_leaves():
    """P against a numerical minimiser of Σ_k F_k: from the pmf that P brings about, P comes again;
    a fixed point of the iteration, with s_k² in Adam's second moment."""
    rng = np.random.default_rng(5)
    k, δ, η = 6, 0.3, 0.02
    c, h = rng.uniform(0.2, 2, k), rng.uniform(0.5, 4, k)

    def objective(logits):
        mass = np.exp(logits - logits.max())
        return expected_error(mass / mass.sum(), c, h, δ, η)

    best = np.exp(minimize(objective, np.zeros(k), tol=1e-14).x)
    best /= best.sum()
    s2 = c**2 / best
    m2 = h**2 * δ**2  # without noise in the first moment
    zero = np.zeros(k)
    moments = Moments(
        *({"t": mi.Float(x)} for x in (np.sqrt(m2), s2, zero)),
        {"t": η},
    )
    found = np.array(masses({"t": mi.Float(c)}, {"t": mi.Float(h)}, moments, 1e-9)["t"])
    assert np.allclose(found / found.sum(), best, rtol=0.01)
    greedy = np.ones(k) / k
    assert objective(np.log(best)) < objective(np.log(greedy))


def test_masses_minimise_the_mean_over_keys_in_steps():
    """A texture of 40 and a number in a unit 100 times as large, against a numerical minimiser of
    the mean over keys of each key's mean squared error in steps; the same in any other unit. The
    plain sum over entries would leave the number a share as if there were 41 texels."""
    rng = np.random.default_rng(6)
    counts, η = {"t": 40, "x": 1}, {"t": 0.02, "x": 2.0}
    c = {"t": rng.uniform(0.5, 2, 40), "x": np.array([0.03])}
    h = {"t": rng.uniform(0.5, 4, 40), "x": np.array([4e-4])}

    def left(logits):  # x_k ≪ 1: F = η s / 2h
        mass = np.exp(logits - logits.max())
        mass /= mass.sum()
        total = 0.0
        for key, part in (("t", mass[:40]), ("x", mass[40:])):
            total += np.mean(η[key] * c[key] / np.sqrt(part) / (2 * h[key]) / η[key] ** 2)
        return total

    best = np.exp(minimize(left, np.zeros(41), tol=1e-14).x)
    best /= best.sum()

    def found(unit: float = 1.0, **rates) -> np.ndarray:
        scaled = {"t": 1.0, "x": unit}
        given = (
            {key: mi.Float(x[key] / scaled[key] ** power) for key in counts}
            for x, power in ((c, 1), (h, 2))
        )
        own = {key: rate * scaled[key] for key, rate in η.items()} if not rates else rates
        made = masses(*given, None, 1e-6, own)
        mass = np.concatenate([np.array(made[key], np.float64) for key in counts])
        return mass / mass.sum()

    assert np.allclose(found(), best, rtol=0.01)
    assert np.allclose(found(unit=1e-3), best, rtol=0.01)
    assert not np.allclose(found(t=1.0, x=1.0), best, rtol=0.5)


def test_unknowns_that_are_done_or_out_of_reach_are_dropped():
    """Of two keys alike the one whose mean gradient has vanished gets next to nothing; so does an
    entry whose noise is far above what its error could show."""
    count = 1000
    rng = np.random.default_rng(1)
    alike = mi.Float(np.ones(count))
    c, h = {"a": alike, "b": alike}, {"a": alike, "b": alike}
    noise = np.full(count, 0.01)
    drift = rng.normal(0, 0.1, count)
    first = {"a": mi.Float(0.3 + drift), "b": mi.Float(drift)}
    second = {"a": mi.Float(np.ones(count)), "b": mi.Float(np.ones(count))}
    both = {"a": mi.Float(noise), "b": mi.Float(noise)}
    rate = {"a": 0.02, "b": 0.02}
    found = masses(c, h, Moments(first, second, both, rate), 1e-3)
    assert float(dr.sum(found["b"])[0]) < 0.3 * float(dr.sum(found["a"])[0])
    resting = masses(c, h, Moments(first, second, both, rate | {"a": 0.0}), 1e-3)
    assert not dr.any(resting["a"] > 0) and dr.all(resting["b"] == found["b"])

    noisy = np.ones(count)
    noisy[0] = 1e8
    moments = Moments({"a": first["a"]}, {"a": mi.Float(noisy)}, {"a": both["a"]}, rate)
    mass = np.array(masses({"a": alike}, {"a": alike}, moments, 1e-3)["a"])
    assert mass[0] < 1e-2 * mass[1]


def test_nothing_left_to_gain_is_no_reason_to_stop():
    """All masses zero, as after a run of zero gradients: as if there were no moments."""
    one = {"a": mi.Float([1.0, 2.0])}
    zero = {"a": mi.Float([0.0, 0.0])}
    huge = {"a": mi.Float([np.inf, np.inf])}
    found = np.array(tangents(one, one, Moments(zero, huge, zero, {"a": 0.02}), 1e-3)["a"])
    assert np.allclose(found, np.array(tangents(one, one, None, 1e-3)["a"]))


def test_what_rests_has_no_mass_from_the_first_look_on(monkeypatch):
    """But where nothing else has any."""
    p, found = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}), []
    p.unknowns[TEXTURE].during = (0.5, 1.0)
    monkeypatch.setattr(
        progress, "tangents", lambda *given: found.append(tangents(*given)) or found[-1]
    )
    sampler, values = prepared(p, 4, 8), p.unknowns.starts()
    for spent in (0.0, 0.6):
        sampler.look(values, 1, 0, None, spent)
    p.unknowns.write(values)
    assert [bool(dr.any(each[TEXTURE] > 0)) for each in found] == [False, True]
    assert all(dr.all(each[ROUGHNESS] > 0) for each in found)
    one, none = {"a": mi.Float([1.0, 2.0])}, mi.Float([0.0])
    kept = tangents(one | {"b": none}, one | {"b": none}, None, 1e-3, None, ["a"])
    assert np.allclose(np.array(kept["a"]), np.array(tangents(one, one, None, 1e-3)["a"]))


def test_scalars_whose_error_is_below_their_noise_stay_in():
    one = mi.Float([1.0])
    moments = Moments({"a": mi.Float([0.0])}, {"a": one}, {"a": mi.Float([0.05])}, {"a": 0.02})
    assert float(masses({"a": one}, {"a": one}, moments, 1e-3)["a"][0]) > 0.1


def test_paths_cost_what_they_meet():
    """The sky costs nothing, a surface one vertex or more, up to what the depth allows."""
    for depth in (2, 4):
        p = problem({ROUGHNESS: 0.5}, resolution=(32, 32), depth=depth)
        cells = Cells.over(p.film_sizes, 32)
        cost = np.array(PathCost(p, cells, 16)(1, 0)).reshape(2, 32, 32)
        assert cost[0, 0, 0] == 0  # sky
        assert 1 <= cost[0, 14, 16] <= depth - 1  # the wall
        assert np.all(cost <= depth - 1)
    assert cost.max() > 1.2  # floor and wall see each other


def test_dear_pixels_are_drawn_less():
    """Twice the same problem: where the overhead is small, cheap pixels gain."""
    p = problem({TEXTURE: 0.5}, resolution=(24, 16))
    cheap, dear = (first_look(p, prepared(p, 8, 32, overhead=o)) for o in (0.01, 1e6))
    cost = np.array(PathCost(p, Cells.over(p.film_sizes, 8), 64)(3, 0)) + 0.01
    p.unknowns.write(p.unknowns.starts())
    both = (dear > 1e-4) & (cheap > 1e-6)
    slope = np.polyfit(np.log(cost[both]), np.log(cheap[both] / dear[both]), 1)[0]
    assert slope == pytest.approx(-0.5, abs=0.1)


def test_looks_come_at_doubling_intervals():
    due = [i for i in range(500) if Progress(refresh=60).due(i)]
    assert due == [0, 60, 120, 240, 480]
    assert [i for i in range(500) if Progress(refresh=0).due(i)] == [0]


def test_a_continued_run_finds_the_survey_again():
    """The survey is a function of problem, settings and base seed: what a second sampler finds at
    a later iteration, without a first look, has the same bits on one thread and rounds alike."""
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    stepper = Stepper(p.unknowns, OptimizerConfig())
    stepper.step(p.unknowns.starts(), 0.0)
    moments = stepper.moments(0.1)
    values = p.unknowns.starts()
    rows = []
    for again in (False, True):
        sampler = prepared(p, 4, 8)
        if not again:
            sampler.look(values, 7, 0)
        rows.append(np.array(sampler.look(values, 7, 60, moments), np.float64))
    p.unknowns.write(values)
    assert np.allclose(rows[0], rows[1], rtol=1e-3, atol=1e-6 * rows[0].max())


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"passes": 0}, "sampler.passes=0"),
        ({"least": 0.0}, "sampler.least=0.0"),
        ({"overhead": -1.0}, "sampler.overhead=-1.0"),
        ({"stage1": Stage1Settings(probes=2)}, "sampler.stage1.probes=2"),
    ],
)
def test_bad_settings_are_named(settings, message):
    with pytest.raises(InputError, match=message):
        Progress(**settings)


@pytest.mark.parametrize("unit", [1e-10, 1e10])
def test_the_unit_of_the_loss_does_not_matter(unit):
    """Gradients of a mean over many pixels are tiny; squares of their squares leave float32."""
    rng = np.random.default_rng(3)
    c, h, m = rng.uniform(0.2, 2, (3, 8))
    s2, noise = rng.uniform(0.5, 4, 8), rng.uniform(0.01, 0.1, 8)

    def found(scale):
        moments = Moments(
            *({"t": mi.Float(x)} for x in (m * scale, s2 * scale**2, noise * scale**2)), {"t": 0.02}
        )
        given = {"t": mi.Float(c * scale)}, {"t": mi.Float(h * scale)}
        mass = np.array(masses(*given, moments, 1e-3)["t"], np.float64)
        return mass / mass.sum()

    assert np.allclose(found(unit), found(1.0), rtol=1e-3)


@pytest.mark.parametrize("unit", [1e-12, 1e-24])
def test_dim_scenes_have_the_masses_of_bright_ones(unit):
    """Radiances of 1e-6 and 1e-12: curvatures and gradients fall with their squares, and neither's
    own squares are left in float32."""
    rng = np.random.default_rng(3)
    c, h, m = rng.uniform(0.2, 2, (3, 8))
    s2, noise = rng.uniform(0.5, 4, 8), rng.uniform(0.01, 0.1, 8)

    def found(scale):
        moments = Moments(*({"t": mi.Float(x)} for x in (m, s2, noise)), {"t": 0.02}, scale)
        given = {"t": mi.Float(c * scale)}, {"t": mi.Float(h * scale)}
        mass = np.array(masses(*given, moments, 1e-3)["t"], np.float64)
        return mass / mass.sum()

    assert np.allclose(found(unit), found(1.0), rtol=1e-3)


def test_one_entry_that_is_not_finite_does_not_spoil_its_key():
    one, bad = mi.Float([1.0, 1.0, 1.0]), mi.Float([1.0, np.nan, 1.0])
    moments = Moments(
        *({"a": one * x, "b": one * x} for x in (0.3, 1.0, 0.01)), {"a": 0.02, "b": 0.02}
    )
    for given in (None, moments):
        found = masses({"a": one, "b": one}, {"a": bad, "b": one}, given, 1e-3)
        a, b = (np.array(found[key]) for key in "ab")
        assert a[1] == 0 and np.allclose(a[[0, 2]], b[[0, 2]], rtol=0.5) and np.all(b > 0)


def test_paths_are_counted_as_they_are_traced(monkeypatch):
    """What the record bills as paths: every lane of every stream that a look makes."""
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    stage1 = Stage1Settings(resolution=4, spp=2, denoise="none")
    sampler = Progress(stage1=stage1).on(p, losses.L2(), 512, freeze=False)
    traced = []
    honest = rays.stream
    monkeypatch.setattr(
        rays, "stream", lambda seed, count: (traced.append(count), honest(seed, count))[1]
    )
    values = p.unknowns.starts()
    sampler.look(values, 1, 0)
    assert sum(traced) == sampler.paths_before + sampler.paths_per_look
    traced.clear()
    stepper = Stepper(p.unknowns, OptimizerConfig())
    stepper.step(p.unknowns.starts(), 0.0)
    sampler.look(values, 1, 60, stepper.moments(0.1))
    p.unknowns.write(values)
    assert sum(traced) == sampler.paths_per_look
