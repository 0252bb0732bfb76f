"""What `isas variance` computes, against distributions that are known and against brute force."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from brute_force import PerPath
from gradient_estimates import Gradients, WithoutWeights, configured
from montecarlo import z_against
from scenes_for_tests import ROUGHNESS, TEXTURE, problem
from scipy import stats

from isas_cli.config.schema import OptimizerConfig
from isas_cli.estimators.two_path import TwoPath
from isas_cli.losses import L2
from isas_cli.measure.variance import best, moments
from isas_cli.measure.variance.intervals import Bootstrap, bias
from isas_cli.measure.variance.rounds import Bench
from isas_cli.measure.variance.table import BEST, GRADIENT, UNIFORM, Results, biased, rows
from isas_cli.measure.variance.tally import Directions, Tally
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.samplers.stage1.cells import Cells
from isas_cli.samplers.uniform import Uniform

LEVEL = 1e-3


def bench(p, batch: int, base: int, estimator: type = TwoPath) -> Bench:
    made = Bench(p, L2(), p.unknowns.starts(), batch, base, OptimizerConfig())
    made.estimator = estimator(p, made.loss, batch)
    return made


def test_a_tally_is_the_sample_variance_without_keeping_the_samples(rng):
    estimates = rng.normal(3.0, [1.0, 2.0, 0.5, 7.0], (50, 4)).astype(np.float32)
    tally = Tally(Directions({"a": np.ones(1), "b": np.ones(3)}, 0))
    for row in estimates:
        tally.add({"a": row[:1].copy(), "b": row[1:].copy()})
    exact = estimates.astype(np.float64)
    assert sum(tally.steps) / 49 == pytest.approx(exact.var(axis=0, ddof=1).sum(), rel=1e-12)
    assert tally.squared_norm == pytest.approx(np.sum(exact.mean(axis=0) ** 2), rel=1e-12)
    assert np.allclose(np.array(tally.projections), exact)


def test_each_step_of_a_tally_has_the_variance_as_its_mean(rng):
    """Skewed and heavy-tailed estimates, so that nothing is owed to the normal distribution."""
    steps = np.empty((4000, 6))
    for row in steps:
        tally = Tally(Directions({"a": np.ones(2)}, 0))
        for estimate in rng.exponential(1.0, (6, 2)):
            tally.add({"a": estimate})
        row[:] = tally.steps
    assert np.all(steps[:, 0] == 0)
    assert z_against(steps[:, 1:], np.full(5, 2.0)) > LEVEL


def test_entries_that_are_not_finite_count_as_zero():
    tally = Tally(Directions({"a": np.ones(3)}, 0))
    for row in ([1.0, np.nan, 2.0], [1.0, np.inf, 4.0], [1.0, 3.0, 3.0]):
        tally.add({"a": np.array(row, np.float32)})
    assert tally.nonfinite == 2
    assert np.allclose(tally.mean["a"], [1, 1, 3])


@pytest.mark.parametrize("spread", [0.0, 0.5])
def test_intervals_hold_the_truth_as_often_as_they_say(rng, spread):
    """400 measurements of 64 rounds of 4; with ``spread`` a round's pmf is more or less lucky.
    Coverage within four standard errors of 95 %, and 2 % below it for the percentile method."""
    samples, rounds, each = 400, 64, 4
    lucky = np.exp(rng.normal(-(spread**2) / 2, spread, (samples, 2, rounds)))
    steps = lucky[..., None] * rng.chisquare(1, (samples, 2, rounds, each))
    made = Bootstrap(steps.sum(axis=-1).reshape(2 * samples, rounds).T, np.full(rounds, each))
    held = np.array([_holds(made.variance(i), 1.0) for i in range(2 * samples)])
    ratios = np.array([_holds(made.ratio(2 * i, 2 * i + 1), 1.0) for i in range(samples)])
    print("coverage", held.mean(), "of ratios", ratios.mean())
    for found in (held, ratios):
        error = np.sqrt(0.05 * 0.95 / found.size)
        assert 0.93 - 4 * error < found.mean() < 0.95 + 4 * error
    if spread:  # resampled one by one, as if estimates of one round had nothing in common
        lone = steps.reshape(2 * samples, rounds * each)
        error = lone.std(axis=1) / np.sqrt(lone.shape[1])
        naive = np.abs(lone.mean(axis=1) - 1) < 1.96 * error
        assert naive.mean() < held.mean(), "the rounds' luck should show"


def _holds(estimate, truth: float) -> bool:
    return estimate.low <= truth <= estimate.high


def test_very_many_rounds_give_the_interval_that_their_blocks_give(rng):
    steps = rng.chisquare(1, (5000, 2))
    made = Bootstrap(steps, np.ones(5000)).variance(0)
    assert made.value == pytest.approx(steps[:, 0].mean())
    assert (made.high - made.low) / 2 == pytest.approx(1.96 * (2 / 5000) ** 0.5, rel=0.2)


def test_one_round_gives_no_interval():
    made = Bootstrap(np.array([[3.0, 6.0]]), np.array([3]))
    assert made.ratio(1, 0).value == 2 and np.isnan(made.ratio(1, 0).low)


def test_bias_is_called_by_chance_as_often_as_stated_and_noticed_when_there(rng):
    null = np.array(
        [bias(rng.normal(size=(64, 5)), rng.normal(size=(64, 5)))[1] for _ in range(600)]
    )
    # Bonferroni over five directions: p ≤ x has a probability of nearly x for small x.
    rejected = stats.binomtest(int((null < 0.05).sum()), null.size, 0.05)
    assert rejected.pvalue > LEVEL, rejected
    shifted = rng.normal(size=(256, 5)) + np.array([0, 0, 0.5, 0, 0])
    z, p = bias(shifted, rng.normal(size=(256, 5)))
    assert z > 4 and p < 1e-4
    assert np.isnan(bias(shifted, shifted)[0]), "equal to the bit: nothing to test"


@pytest.fixture(scope="module")
def small():
    """A texture of 2 × 2 texels and a roughness, seen in 192 pixels."""
    return problem({TEXTURE: 0.5, ROUGHNESS: 0.6}, size=2)


@pytest.fixture(scope="module")
def measured(small):
    starts = small.unknowns.starts()
    return [moments.measure(small, L2(), starts, 512, base) for base in range(8)]


def test_second_moments_are_those_of_single_paths_and_single_unknowns(small, measured):
    """Σ_k (Σ_c r_c ∂I_c/∂θ_k)² path by path, one unit tangent for each unknown, against matrices of
    means along random signs."""
    cells, samples, repeats = Cells.over(small.film_sizes, 12), 16, 12
    assert cells.count == small.views.total
    starts, share = small.unknowns.starts(), float(small.share[0])
    paths = PerPath(small, L2(), cells, samples)
    found = []
    for i in range(repeats):
        derivative = paths.derivatives(77, i)
        residual = paths.residuals(77, i)
        contribution = np.einsum("cn,kcn->kn", residual, derivative) * share
        found.append(np.sum(contribution**2, axis=0).reshape(-1, samples).mean(axis=1))
    small.unknowns.write(starts)
    exact = np.array(found)  # by pixel
    place = np.array(small.views.index(*small.views.locate_slot(dr.arange(mi.UInt32, cells.count))))
    made = np.array([m.mean for m in measured])
    total = stats.ttest_ind(exact.sum(axis=1), made.sum(axis=1), equal_var=False)
    print("Σ_j A_j", exact.sum(axis=1).mean(), made.sum(axis=1).mean(), total)
    assert total.pvalue > LEVEL
    assert abs(exact.sum(axis=1).mean() / made.sum(axis=1).mean() - 1) < 0.1
    roots = np.sqrt(np.maximum([exact.mean(axis=0)[place], made.mean(axis=0)], 0))
    assert np.corrcoef(roots)[0, 1] > 0.97


def test_halves_are_independent_and_agree(measured):
    differences = np.array([m.halves[0].sum() - m.halves[1].sum() for m in measured])
    assert z_against(differences[:, None], np.zeros(1)) > LEVEL
    a, b = measured[0].halves
    assert not np.array_equal(a, b) and np.corrcoef(np.sqrt(np.abs([a, b])))[0, 1] > 0.9


def test_variance_of_single_draws_is_the_closed_form(small, measured, seed):
    """With one pixel per estimate nothing is stratified: V = Σ_j A_j/p_j - ‖∇‖², for any pmf."""
    integrator, repeats = small.integrator, 2048
    one_way = integrator.cut(replace(integrator.paths, crossed=False))
    p = replace(small, integrator=one_way)
    made = bench(p, 1, seed % 1000)
    found = best.find(measured[0])
    contestants = [made.sampled(UNIFORM, Uniform()), made.fixed(BEST, found.distribution)]
    made.run(contestants, repeats, lambda rounds: None)
    for contestant, second in zip(
        contestants, (measured[1].second_moment(contestants[0].distribution), None)
    ):
        second = second or measured[1].second_moment(found.distribution)
        steps = np.array(contestant.tally.steps[1:])
        exact = second - contestant.tally.squared_norm
        error = steps.std(ddof=1) / np.sqrt(steps.size)
        z = (steps.mean() - exact) / error
        print(contestant.label, "measured", steps.mean(), "±", error, "closed form", exact, "z", z)
        assert abs(z) < 4 and error < 0.28 * exact


def test_pixels_that_contribute_nothing_need_no_probability(small):
    some = moments.Moments(small, Tiles.over(small.views), np.zeros((2, 3)), 2)
    some.pixels = np.array([1.0, 4.0, 3.0])
    contributions, p = np.array([2.0, 0.0, 1.0]), np.array([0.5, 0.0, 0.25])
    assert some.sum_over(p, contributions) == 4 + 12
    assert some.sum_over(np.zeros(3), contributions) == np.inf


def test_no_sampler_beats_the_best_pmf(small, measured):
    """Judged by paths that none of them was made from. The bound lies below what was reached."""
    found, judge = best.find(measured[0]), measured[1]
    reached = judge.second_moment(found.distribution)
    starts = small.unknowns.starts()
    for name in ("uniform", "relevant", "gradient", "ours", "joint", "balanced"):
        sampler = configured("sampler", name).on(small, L2(), 4096)
        pmf = sampler.distribution(sampler.look(starts, 5, 1))
        assert judge.second_moment(pmf) > 0.99 * reached, name
    small.unknowns.write(starts)
    assert found.bound < found.second_moment
    # From half of the paths, so slightly worse; all of 512 paths are near what the bound allows.
    assert 0.9 * found.bound < reached < 1.05 * found.second_moment


def test_variances_are_those_of_estimates_made_one_by_one(small, seed):
    """Against the estimates that other tests use, other seeds, at a batch that is stratified."""
    made = bench(small, 256, seed % 1000)
    contestant = made.sampled(UNIFORM, Uniform())
    made.run([contestant], 512, lambda rounds: None)
    own = np.array(contestant.tally.steps[1:])
    others = Gradients(small, L2(), 256).uniform(512, seed)
    away = np.sum((others - others.mean(axis=0)) ** 2, axis=1) * len(others) / (len(others) - 1)
    error = np.hypot(*(x.std(ddof=1) / np.sqrt(x.size) for x in (own, away)))
    print("variance", own.mean(), away.mean(), "standard error", error)
    assert abs(own.mean() - away.mean()) < 4 * error and error < 0.12 * own.mean()


@pytest.mark.parametrize("estimator", [TwoPath, WithoutWeights])
def test_a_biased_estimator_is_flagged_and_an_honest_one_is_not(small, seed, estimator):
    """The same pmf with and without its weights, a texture and a roughness unknown."""
    honest, other = bench(small, 256, seed % 1000), bench(small, 256, seed % 1000, estimator)
    contestants = [honest.sampled(UNIFORM, Uniform())]
    ours = [other.sampled(name, configured("sampler", name)) for name in (GRADIENT, "ours")]
    honest.run(contestants, 192, lambda rounds: None)
    done: list[int] = []
    other.run(ours, 192, lambda rounds: done.__setitem__(slice(None), rounds))
    table = rows([*contestants, *ours], done, Results(256, 512, None))
    found = {row["sampler"]: row for row in table}
    for name in (GRADIENT, "ours"):
        print(estimator.__name__, name, found[name]["bias_z"], found[name]["bias_p"])
        assert biased(found[name]) == (estimator is WithoutWeights)
    assert np.isnan(found[UNIFORM]["bias_z"])


def test_rounds_turn_and_an_interrupted_one_is_left_out(small):
    made = bench(small, 64, 1)
    contestants = [made.sampled(UNIFORM, Uniform()), made.fixed("same", _alike(small))]
    order: list[str] = []
    honest = made._round
    made._round = lambda contestant, *more: (
        order.append(contestant.label),
        honest(contestant, *more),
    )[1]
    seen: list[int] = []
    asked = iter([False] * 10 + [True] * 9)
    done = made.run(contestants, 200, lambda rounds: seen.append(sum(rounds)), lambda: next(asked))
    assert not done and seen == [4] and order == [UNIFORM, "same", "same"]
    table = rows(contestants, [4], Results(64, 128, None))
    # The same pmf and the same random numbers: the same estimates, but for the order in which
    # threads add to a gradient.
    assert table[1]["ratio_to_uniform"] == pytest.approx(1, rel=1e-5)
    assert table[0]["repeats"] == 4


def _alike(p) -> PixelDistribution:
    return PixelDistribution.uniform(Tiles.over(p.views))


def test_textures_are_compared_along_directions_that_show_a_missing_weight(rng):
    pilot = rng.normal(size=300)
    directions = Directions({"texture": pilot, "scalar": np.ones(1)}, 3)
    along = directions({"texture": pilot / np.linalg.norm(pilot), "scalar": np.full(1, 2.0)})
    assert along.size == 7 and along[-1] == 2
    assert along[5] == pytest.approx(1, rel=1e-6)
