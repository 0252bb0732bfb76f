"""Plateau-reduced gradients of a small scene, against quadrature over the parameters."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from poses_for_tests import AT, COLOUR, PLACE, SIGMA, blurred_problem
from scipy import stats

from isas_cli import losses
from isas_cli.errors import InputError
from isas_cli.estimators import renderings
from isas_cli.estimators.finite_differences import FiniteDifferences
from isas_cli.estimators.plateau import Plateau
from isas_cli.estimators.renderings import Renderings
from isas_cli.estimators.stock import Stock
from isas_cli.pixels import PixelDistribution, Tiles
from isas_cli.render import Renderer
from isas_cli.samplers.base import Stage1Settings
from isas_cli.samplers.differences import Differences

BATCH = 192  # four paths a pixel
LEVEL = 1e-4  # of each comparison of two unknowns
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(3)  # exact for the colour, whose ℒ is quadratic
STEPS = np.linspace(-4.5, 4.5, 61)  # of the place, in widths
GRID = stats.norm.pdf(STEPS) * (STEPS[1] - STEPS[0])
SETS, PATHS = 8, 64  # of references; a pixel, node and side


@pytest.fixture(scope="module")
def problem():
    return blurred_problem()


def uniform(p) -> PixelDistribution:
    return PixelDistribution.uniform(Tiles.over(p.views))


def references_of(p) -> dict[str, np.ndarray]:
    """Gradients of both smoothed objectives, (sets, 2), by quadrature over the parameters; each set
    from two independent renderings of all nodes."""
    renderer = Renderer(p)
    keys = p.unknowns.keys
    weight = GRID[:, None] * (WEIGHTS / WEIGHTS.sum())[None, :]
    slopes = [weight * STEPS[:, None] / SIGMA[0], weight * NODES[None, :] / SIGMA[1]]
    target = np.array(p.targets).reshape(-1, 3)
    # All paths of a node in one launch.
    pixels = dr.repeat(dr.arange(mi.UInt32, p.views.total), PATHS)

    def images(seed: int) -> np.ndarray:
        """P at all nodes, (61, 3, pixels, 3), by the same random numbers."""
        found = np.empty((len(STEPS), len(NODES), p.views.total, 3))
        for i, j in np.ndindex(found.shape[:2]):
            at = (AT[0] + SIGMA[0] * STEPS[i], AT[1] + SIGMA[1] * NODES[j])
            arrays = {key: np.array([x], np.float32) for key, x in zip(keys, at)}
            p.unknowns.write(p.unknowns.values_of(arrays))
            drawn = np.array(renderer.pixels(pixels, 1, lambda s: seed))
            found[i, j] = drawn.T.reshape(p.views.total, PATHS, 3).mean(axis=1)
        return found

    def mean(weights, values):
        return np.tensordot(weights, values, axes=([0, 1], [0, 1]))

    found: dict[str, list] = {"image": [], "loss": []}
    for number in range(SETS):
        a, b = (images(1000 + 2 * number + side) for side in (0, 1))
        residual = 2 * (mean(weight, a) - target)
        found["image"].append([np.mean(residual * mean(slope, b)) for slope in slopes])
        squares = np.mean((a - target) * (b - target), axis=(2, 3))
        found["loss"].append([np.sum(slope * squares) for slope in slopes])
    p.unknowns.write(p.unknowns.starts())
    return {kind: np.array(rows) for kind, rows in found.items()}


@pytest.fixture(scope="module")
def references(problem) -> dict[str, np.ndarray]:
    return references_of(problem)


def rows(estimator, p, count: int, distribution=None) -> np.ndarray:
    """``count`` independent estimates of the gradient by both unknowns."""
    distribution = distribution or uniform(p)
    values = p.unknowns.starts()
    found = []
    for i in range(count):
        gradient = estimator.estimate(values, distribution, 7, i, 0.0)
        found.append([float(gradient[key][0]) for key in p.unknowns.keys])
    p.unknowns.write(values)
    return np.array(found)


def p_value(found: np.ndarray, reference: np.ndarray) -> float:
    """Welch's, of both unknowns, by Bonferroni; prints what is compared."""
    test = stats.ttest_ind(found, reference, equal_var=False)
    visible = 4 * np.sqrt(found.var(axis=0, ddof=1) / len(found)) / np.abs(reference.mean(axis=0))
    print("found", found.mean(axis=0), "reference", reference.mean(axis=0), "p", test.pvalue)
    print("bias that would be seen, as a share:", visible)
    return min(1.0, 2 * test.pvalue.min())


def made(p, **settings) -> Plateau:
    return Plateau(p, losses.L2(), BATCH, **settings)


@pytest.mark.parametrize("scheme", ("joint", "separate"))
@pytest.mark.parametrize("smooth", ("image", "loss"))
def test_unbiased_for_the_objective_it_names(problem, references, smooth, scheme):
    found = rows(made(problem, smooth=smooth, scheme=scheme), problem, 600)
    assert p_value(found, references[smooth]) > LEVEL


def test_several_pairs_and_independent_random_numbers(problem, references):
    found = rows(made(problem, smooth="image", pairs=3, common=False), problem, 300)
    assert p_value(found, references["image"]) > LEVEL


@pytest.mark.parametrize("smooth", ("image", "loss"))
def test_several_paths_a_pixel(problem, references, smooth):
    fewer = Plateau(problem, losses.L2(), BATCH // 4, smooth, spp=4)
    assert fewer.paths_per_step == made(problem, smooth=smooth).paths_per_step
    assert p_value(rows(fewer, problem, 600), references[smooth]) > LEVEL


def test_paths_of_another_pixel_are_noticed(problem, references, monkeypatch):
    def shifted(radiance, lanes):
        lanes = dr.minimum(lanes + 1, dr.width(radiance) - 1)
        return mi.Color3f(*[dr.gather(mi.Float, channel, lanes) for channel in radiance])

    monkeypatch.setattr(renderings, "_part", shifted)
    estimator = Plateau(problem, losses.L2(), BATCH // 4, "image", spp=4)
    assert p_value(rows(estimator, problem, 600), references["image"]) < LEVEL


def test_one_rendering_for_both_of_a_side_is_noticed(problem, references, monkeypatch):
    """Its paths' variance, which depends on θ, would be descended along."""
    whole = Renderings._traced

    def same(self, *arguments):
        return whole(self, *arguments)[:1] * 2

    monkeypatch.setattr(Renderings, "_traced", same)
    estimator = Plateau(problem, losses.L2(), BATCH // 2, "loss", spp=2)
    assert p_value(rows(estimator, problem, 600), references["loss"]) < LEVEL


def test_several_paths_of_fewer_pixels_lower_the_variance():
    """Of narrow blurs near the truth, where noise times noise outweighs the rest."""
    p = blurred_problem(at=(0.2, 0.7), widths=(0.03, 0.02))
    several, single = (
        rows(Plateau(p, losses.L2(), BATCH // n, "image", common=False, spp=n), p, 300)
        for n in (6, 1)
    )
    print("variance, single over several", single.var(axis=0) / several.var(axis=0))
    assert np.all(single.var(axis=0) > 1.5 * several.var(axis=0))


@pytest.mark.parametrize("smooth", ("image", "loss"))
def test_pixels_drawn_where_renderings_differ(problem, references, smooth):
    """Unbiased with the pmf that is made for it, and of less variance than uniform pixels."""
    estimator = made(problem, smooth=smooth)
    sampler = Differences(stage1=Stage1Settings(resolution=8, spp=8, probes=8, denoise="none"))
    sampler.follow(estimator.blur, smooth)
    sampler.prepare(problem, losses.L2(), BATCH)
    weights = sampler.look(problem.unknowns.starts(), 3, 0)
    drawn = rows(estimator, problem, 600, sampler.distribution(weights))
    assert p_value(drawn, references[smooth]) > LEVEL


def test_the_two_objectives_differ(problem, references):
    """What the tests above would notice if one were taken for the other."""
    found = rows(made(problem, smooth="loss"), problem, 600)
    assert p_value(found, references["image"]) < LEVEL


def test_one_offset_for_residual_and_derivative_is_noticed(problem, references, monkeypatch):
    """The mean of the pair as the blurred image: correlated with its difference."""
    estimator = made(problem, smooth="image")
    honest = estimator._renderings.of_images

    def careless(θ, pair, other, distribution, seeds):
        seeds = np.array([seeds[0], seeds[2], seeds[2], seeds[2]])
        return honest(θ, pair, pair.plus, distribution, seeds)

    monkeypatch.setattr(estimator._renderings, "of_images", careless)
    assert p_value(rows(estimator, problem, 600), references["image"]) < LEVEL


@pytest.mark.parametrize("smooth", ("image", "loss"))
def test_mitsubas_derivative_blurred(smooth):
    """κ∂P, by prb_projective, of a ball that glows: no silhouette is seen by way of others, which
    would take seconds a step."""
    p = blurred_problem(glows=True)
    found = rows(Stock(p, losses.L2(), 2 * BATCH, smooth, silhouettes="direct"), p, 100)
    assert p_value(found, references_of(p)[smooth]) > LEVEL


def test_mitsubas_own_derivative():
    """Unblurred, of place and radiance, against differences over so small a step that they change
    no more: the mean image is smooth in both."""
    p = blurred_problem(glows=True)
    found = rows(Stock(p, losses.L2(), 2 * BATCH, silhouettes="direct"), p, 100)
    exact = rows(FiniteDifferences(p, losses.L2(), 64 * BATCH, 0.01), p, 60)
    assert p_value(found, exact) > LEVEL
    assert np.all(np.abs(exact.mean(axis=0)) > 5 * exact.std(axis=0) / math.sqrt(len(exact)))


def test_mitsubas_derivative_of_all_views():
    """A first camera that looks away: the second's gradient arrives."""
    p = blurred_problem(glows=True, blind=True)
    found = rows(Stock(p, losses.L2(), 4 * BATCH, silhouettes="direct"), p, 4)
    assert np.all(np.abs(found.mean(axis=0)) > 1e-4)


def test_kernel_and_renderer_agree_at_the_end_of_a_range():
    """The radiance near 1, where it is clamped."""
    p = blurred_problem(at=(AT[0], 0.9), widths=(0.05, 0.3), glows=True)
    by_kernel = rows(made(p, smooth="loss", scheme="separate"), p, 600)
    by_renderer = rows(Stock(p, losses.L2(), 2 * BATCH, "loss", silhouettes="direct"), p, 200)
    test = stats.ttest_ind(by_kernel[:, 1], by_renderer[:, 1], equal_var=False)
    print(by_kernel.mean(axis=0), by_renderer.mean(axis=0), test.pvalue)
    assert test.pvalue > LEVEL


def test_the_landscape_holds_no_noise_of_its_paths():
    """At the truth the loss from two halves is that of the targets' noise, which is small; the
    squared error of one half would be that of one path a pixel."""
    from isas_cli import landscape

    p = blurred_problem()
    truth = np.array([0.2, 0.7])
    axes = [np.array([0.2])]
    found = [
        landscape.measure(
            p, losses.L2(), truth, [0], [PLACE], axes, [(0.1,)], "image", 1, base
        ).hard[0]
        for base in range(60)
    ]
    p.unknowns.write(p.unknowns.truths())
    image = Renderer(p).range(0, p.views.total, 1, lambda i: 77)
    one = np.mean((image - np.array(p.targets).reshape(-1, 3)) ** 2)
    print("two halves", np.mean(found), "one", one)
    assert abs(np.mean(found)) < 0.2 * one


@pytest.mark.parametrize("smooth", ("image", "loss"))
def test_common_random_numbers_lower_the_variance(smooth):
    """Of narrow blurs, where the paths' noise is larger than what the offsets change."""
    p = blurred_problem(widths=(0.03, 0.02))
    common, apart = (
        rows(made(p, smooth=smooth, common=common), p, 300) for common in (True, False)
    )
    print("variance, apart over common", apart.var(axis=0) / common.var(axis=0))
    assert np.all(apart.var(axis=0) > 1.5 * common.var(axis=0))


def test_narrow_blurs_stay_finite(problem):
    """σ = 1e-4: the colour's gradient is then the loss's own, against central differences."""
    p = blurred_problem(widths=(1e-4, 1e-4))
    found = rows(made(p, smooth="loss", scheme="separate"), p, 400)
    assert np.all(np.isfinite(found))
    exact = rows(FiniteDifferences(p, losses.L2(), BATCH, 1000.0), p, 400)
    test = stats.ttest_ind(found[:, 1], exact[:, 1], equal_var=False)
    print(found.mean(axis=0), exact.mean(axis=0), test.pvalue)
    assert test.pvalue > LEVEL


@pytest.mark.parametrize("spp", (1, 3))
def test_central_differences_are_those_of_the_loss(problem, spp):
    """Against renderings of the whole images at both ends."""
    estimator = FiniteDifferences(problem, losses.L2(), BATCH // spp, 0.5, spp=spp)
    assert estimator.paths_per_step == 4 * 2 * BATCH
    found = rows(estimator, problem, 200)
    renderer = Renderer(problem)
    target = np.array(problem.targets).reshape(-1, 3)
    expected = []
    for number in range(8):
        row = []
        for k in (0, 1):
            ends = []
            for sign in (-1, 1):
                at = np.array(AT, np.float32)
                at[k] += sign * 0.5 * SIGMA[k]
                values = {PLACE: at[:1], COLOUR: at[1:]}
                problem.unknowns.write(problem.unknowns.values_of(values))
                a, b = (
                    renderer.range(0, problem.views.total, 64, lambda s: 1000 * number + s + side)
                    for side in (0, 500)
                )
                ends.append(np.mean((a - target) * (b - target)))
            row.append((ends[1] - ends[0]) / SIGMA[k])
        expected.append(row)
    assert p_value(found, np.array(expected)) > LEVEL


def test_mitsubas_own_derivative_does_not_see_over_a_plateau():
    """The ball outside the view: no derivative, while the blurred objective has a slope. (Upwards:
    a ball that comes into view at a wrong place is worse than none.)"""
    p = blurred_problem(at=(-2.6, AT[1]), widths=(0.8, 0.1), glows=True)
    stock = rows(Stock(p, losses.L2(), BATCH, silhouettes="direct"), p, 8)
    plateau = rows(made(p, smooth="loss"), p, 800)
    assert np.abs(stock[:, 0]).max() < 1e-6
    mean, error = plateau[:, 0].mean(), plateau[:, 0].std() / math.sqrt(len(plateau))
    print("slope", mean, "±", error)
    assert mean > 4 * error


def test_an_unknown_without_blur_is_refused():
    p = blurred_problem()
    p.unknowns.items[1].blur = None
    with pytest.raises(InputError, match=f"'{COLOUR}'.*has no blur, which sampler=plateau needs"):
        made(p)


def test_values_beyond_their_range_are_rendered_at_its_end(problem):
    from isas_cli.estimators.blur import Blur

    blur = Blur(problem, "plateau")
    blur.write(np.array([0.0, 1.7]))
    assert float(problem.unknowns.params[COLOUR][0]) == 1.0
    assert dr.width(problem.unknowns.leaves[PLACE]) == 1
    assert mi.Float is type(problem.unknowns.leaves[PLACE])
    problem.unknowns.write(problem.unknowns.starts())
