"""Plateau-reduced gradients of a small scene, against quadrature over the parameters."""

from __future__ import annotations

import functools

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from blurred_gradients import BATCH, LEVEL, made, p_value, references_of, rows, unbiased, uniform
from crosses import crossed, some
from poses_for_tests import AT, COLOUR, PLACE, RADIANCE, SIGMA, blurred_problem
from scenes_for_tests import means
from scipy import stats

from isas_cli import losses
from isas_cli.config.schema import BlurConfig
from isas_cli.estimators import renderings
from isas_cli.estimators.finite_differences import FiniteDifferences
from isas_cli.estimators.mitsuba import WholeImages
from isas_cli.estimators.plateau import Plateau
from isas_cli.estimators.renderings import Renderings
from isas_cli.rendering.pixels import PixelDistribution
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime.errors import InputError
from isas_cli.samplers.differences import Differences
from isas_cli.samplers.sampler import Blurred, Stage1Settings
from isas_cli.unknowns import blur, smoothing
from isas_cli.unknowns.blur import Blur

COUNT = 1080  # of estimates


@pytest.fixture(scope="module")
def problem():
    return blurred_problem()


@pytest.fixture(scope="module")
def references(problem) -> dict[str, np.ndarray]:
    return references_of(problem)


@pytest.fixture(scope="module")
def estimates(problem):
    """Of each objective and scheme made once: smooth, scheme → ``COUNT`` rows."""

    @functools.cache
    def of(smooth: str, scheme: str) -> np.ndarray:
        return rows(made(problem, smooth=smooth, scheme=scheme), problem, COUNT)

    return of


@pytest.mark.parametrize("smooth, scheme", crossed(("image", "loss"), ("joint", "separate"), 1))
def test_unbiased_for_the_objective_it_names(estimates, references, smooth, scheme):
    assert unbiased(estimates(smooth, scheme), references[smooth])


@pytest.mark.slow
def test_the_papers_single_rendering_for_the_residual(problem, references):
    found = rows(made(problem, smooth="image", residual="one"), problem, COUNT)
    assert unbiased(found, references["image"])


@pytest.mark.slow
def test_a_residual_from_both_sides_lowers_the_variance_at_the_truth():
    """What an offset changes and its opposite changes back is noise that stays at the truth."""
    p = blurred_problem(at=(0.2, 0.7), widths=(0.2, 0.15))
    single, both = (
        rows(made(p, smooth="image", residual=residual, scheme="separate", spp=16), p, 400)
        for residual in ("one", "pair")
    )
    print("variance, one over pair", single.var(axis=0) / both.var(axis=0))
    assert np.all(single.var(axis=0) > 1.5 * both.var(axis=0))


def test_separate_pairs_share_pixels_and_residual(problem):
    estimator = made(problem, smooth="image", scheme="separate", spp=4)
    assert estimator.paths_per_step == BATCH * (2 * 4 + 2 * 2 * 4)
    assert made(problem, smooth="image").paths_per_step == BATCH * 4


def test_the_residuals_paths_are_a_setting(problem, references):
    estimator = Plateau(problem, losses.L2(), BATCH // 4, "image", spp=4, residual_spp=12)
    assert estimator.paths_per_step == BATCH // 4 * (12 + 8)
    assert unbiased(rows(estimator, problem, COUNT), references["image"])


def test_more_paths_of_the_residual_than_fit_are_refused(problem):
    with pytest.raises(
        InputError, match="estimator.residual_spp=16384 times estimator.batch=1048576"
    ):
        Plateau(problem, losses.L2(), 1 << 20, "image", residual_spp=1 << 14)
    with pytest.raises(InputError, match=r"residual_spp=16384 \(as many as the pairs have on one"):
        Plateau(problem, losses.L2(), 1 << 20, "image", spp=1 << 14)


def test_a_pair_for_each_of_very_many_entries_is_refused(problem, monkeypatch):
    """All their offsets are held at once."""
    monkeypatch.setattr(blur, "_MOST_SINGLE", 1)
    with pytest.raises(InputError, match="estimator.scheme=separate takes a pair .* 2 entries"):
        made(problem, scheme="separate")
    with pytest.raises(InputError, match="estimator=finite_differences takes a pair"):
        FiniteDifferences(problem, losses.L2(), BATCH, 1.0)
    made(problem, scheme="joint")


@pytest.mark.slow
def test_more_paths_of_the_residual_lower_the_variance_at_the_truth():
    p = blurred_problem(at=(0.2, 0.7), widths=(0.03, 0.02))
    few, many = (
        rows(made(p, smooth="image", scheme="separate", residual_spp=paths), p, 300)
        for paths in (2, 16)
    )
    print("variance, 2 paths over 16", few.var(axis=0) / many.var(axis=0))
    assert np.all(few.var(axis=0) > 2 * many.var(axis=0))


@pytest.mark.slow
def test_a_residual_that_is_not_blurred_is_noticed(problem, references, monkeypatch):
    """Taken at θ itself, as ordinary gradients take it."""
    monkeypatch.setattr(smoothing, "blurred", lambda σ, rng: np.zeros(σ.size))
    found = rows(made(problem, smooth="image", pairs=4), problem, COUNT)
    assert p_value(found, references["image"]) < LEVEL


@pytest.mark.slow
def test_several_pairs_and_independent_random_numbers(problem, references):
    found = rows(made(problem, smooth="image", pairs=3, common=False), problem, COUNT // 2)
    assert unbiased(found, references["image"])


@pytest.mark.parametrize("smooth", some(("image", "loss"), ("loss",)))
def test_several_paths_a_pixel(problem, references, smooth):
    fewer = Plateau(problem, losses.L2(), BATCH // 4, smooth, spp=4)
    # In image space the residual's two renderings have half of them each.
    paths = {"image": 3 * BATCH, "loss": 4 * BATCH}
    assert fewer.paths_per_step == paths[smooth]
    assert unbiased(rows(fewer, problem, COUNT), references[smooth])


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


@pytest.mark.parametrize("smooth", some(("image", "loss"), ("image",)))
def test_pixels_drawn_where_renderings_differ(problem, references, smooth):
    """Unbiased with the pmf that is made for it."""
    estimator = made(problem, smooth=smooth)
    drawn = rows(estimator, problem, COUNT, drawn_by_differences(estimator, problem, smooth))
    assert unbiased(drawn, references[smooth])


def drawn_by_differences(estimator, p, smooth: str) -> PixelDistribution:
    sampler = Differences(stage1=Stage1Settings(resolution=8, spp=8, probes=8, denoise="none"))
    sampler = sampler.on(p, losses.L2(), BATCH, blurred=Blurred(estimator.blur, smooth))
    return sampler.distribution(sampler.look(p.unknowns.starts(), 3, 0))


@pytest.mark.slow
@pytest.mark.parametrize("smooth", ("image", "loss"))
def test_pixels_drawn_where_renderings_differ_lower_the_variance(smooth):
    """Of blurs so narrow that the offsets' own noise, which no pmf mends, is not most of it."""
    p = blurred_problem(widths=(0.03, 0.02))
    estimator = made(p, smooth=smooth)
    drawn = rows(estimator, p, 600, drawn_by_differences(estimator, p, smooth))
    by_chance = rows(estimator, p, 600)
    print("variance, uniform over drawn", by_chance.var(axis=0) / drawn.var(axis=0))
    assert np.all(by_chance.var(axis=0) > 1.2 * drawn.var(axis=0))


def test_the_two_objectives_differ(estimates, references):
    """What the tests above would notice if one were taken for the other."""
    assert p_value(estimates("loss", "separate"), references["image"]) < LEVEL


def test_one_offset_for_residual_and_derivative_is_noticed(problem, references, monkeypatch):
    """The mean of the pair as the blurred image: correlated with its difference."""
    estimator = made(problem, smooth="image")
    honest = estimator._renderings.of_images

    def careless(θ, pairs, others, distribution, seeds):
        others = pairs[0].plus, pairs[0].minus
        return honest(θ, pairs, others, distribution, np.append(seeds[0], [seeds[3]] * 4))

    monkeypatch.setattr(estimator._renderings, "of_images", careless)
    assert p_value(rows(estimator, problem, 600), references["image"]) < LEVEL


def test_the_landscape_is_blurred_as_it_says():
    """Of the loss: its own values' weighted mean. Of the image: less than that, as the loss is
    convex, and not less than nothing."""
    from isas_cli.measure import landscape

    p = blurred_problem()
    axes = [np.linspace(-2.0, 2.4, 23)]
    σ = 0.4
    image, loss = (
        landscape.measure(
            p, losses.L2(), np.array([0.2, 0.7]), [0], [PLACE], axes, [(σ,)], smooth, 16, 5
        )
        for smooth in ("image", "loss")
    )
    p.unknowns.write(p.unknowns.truths())
    assert np.allclose(image.hard, loss.hard, rtol=1e-4, atol=1e-7)
    density = stats.norm.pdf(axes[0][:, None], axes[0], σ)
    expected = density @ loss.hard / density.sum(axis=1)
    assert np.allclose(loss.blurred[0], expected, rtol=1e-6)
    assert np.all(image.blurred[0] < loss.blurred[0])
    middle = np.argmin(np.abs(axes[0] - 0.2))
    assert image.hard[middle] < 0.05 * image.blurred[0][middle]


def test_a_landscape_is_not_cut_where_it_ends(monkeypatch):
    """What is shown of longer axes is the smoothed loss up to its ends; beyond the colour's range
    nothing is rendered anew."""
    from isas_cli.measure import landscape

    p = blurred_problem()
    σ = 0.2
    rendered, told = [], []
    honest = Renderer.range

    def counted(*arguments):
        rendered.append(None)
        return honest(*arguments)

    monkeypatch.setattr(Renderer, "range", counted)
    whole = landscape.measure(
        p,
        losses.L2(),
        np.array([0.2, 0.7]),
        [1],
        [COLOUR],
        [np.linspace(-0.2, 1.4, 33)],
        [(σ,)],
        "loss",
        16,
        5,
        lambda *finished: told.append(finished),
    )
    # 21 in [0, 1]; the ends may be rounded.
    assert len(rendered) <= 2 * 23 and told == [(number, 33) for number in range(1, 34)]
    found = whole.within([(0.39, 0.81)])
    assert found.axes[0] == pytest.approx(np.linspace(0.4, 0.8, 9))
    # A quadratic but for its clamped ends, blurred over a fine grid.
    place = np.clip(found.axes[0][:, None] + σ * np.linspace(-5, 5, 401), 0, 1)
    weight = stats.norm.pdf(np.linspace(-5, 5, 401))
    quadratic = np.polyfit(found.axes[0], found.hard, 2)
    expected = np.polyval(quadratic, place) @ weight / weight.sum()
    assert np.allclose(found.blurred[0], expected, rtol=0.02)
    cut = landscape._along(found.hard, [landscape._kernel(found.axes[0], σ)])
    assert not np.allclose(cut, expected, rtol=0.02)


def test_the_landscape_holds_no_noise_of_its_paths():
    """At the truth the loss from two halves is that of the targets' noise, which is small; the
    squared error of one half would be that of one path a pixel."""
    from isas_cli.measure import landscape

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


@pytest.mark.slow
@pytest.mark.parametrize("smooth", ("loss", "image"))
def test_narrow_blurs_stay_finite(smooth):
    """σ = 1e-4: the gradient is then the loss's own, against central differences, of the colour as
    of the place, whose noise is that of paths that an edge passes. (Joint pairs are finite, but
    have the place's noise over the colour's width.)"""
    p = blurred_problem(widths=(1e-4, 1e-4))
    assert np.all(np.isfinite(rows(made(p, smooth=smooth, scheme="joint"), p, 300)))
    found = rows(made(p, smooth=smooth, scheme="separate", spp=16), p, COUNT)
    assert np.all(np.isfinite(found))
    exact = rows(FiniteDifferences(p, losses.L2(), BATCH, 1000.0, spp=16), p, 400)
    assert unbiased(found[:, 1:], exact[:, 1:], seen=0.15)
    assert unbiased(found[:, :1], exact[:, :1], seen=0.8)


def test_every_unknown_has_a_schedule_of_its_own():
    p = blurred_problem()
    place, colour = p.unknowns
    place.blur = BlurConfig(start=0.4, end=0.1, hold=0.5)
    colour.blur = BlurConfig(start=0.3, end=0.2, until=0.5)
    blur = Blur(p, "sampler=plateau")
    for progress, expected in (
        (0.0, (0.4, 0.3)),
        (0.25, (0.4, 0.25)),
        (0.75, (0.25, 0.2)),
        (1.0, (0.1, 0.2)),
    ):
        assert blur.widths(np.array(AT), progress) == pytest.approx(expected)


def places_of(p, monkeypatch) -> list[float]:
    """Where the ball comes to be from now on."""
    update, places = p.unknowns._update, []
    monkeypatch.setattr(
        *(p.unknowns, "_update"),
        lambda new: (places.append(float(dr.detach(new[PLACE])[0])), update(new)),
    )
    return places


@pytest.mark.parametrize("scheme, paths", [("joint", (4, 4)), ("separate", (4, 6)), (None, (4, 8))])
def test_what_rests_is_neither_blurred_nor_rendered_for(scheme, paths, monkeypatch):
    """``scheme`` None: central differences. Beside it the slopes are those of what moves alone."""
    p = blurred_problem(glows=True)
    p.unknowns[PLACE].during = (0.5, 1.0)
    if scheme is None:
        estimator = FiniteDifferences(p, losses.L2(), BATCH, 1.0)
    else:
        estimator = made(p, smooth="image", scheme=scheme)
    values, places = p.unknowns.starts(), places_of(p, monkeypatch)
    found = estimator.estimate(values, uniform(p), 7, 3, 0.0)
    assert set(places) == {float(np.float32(AT[0]))}
    assert float(found[PLACE][0]) == 0 != float(found[RADIANCE][0])
    assert estimator.paths_per_step == paths[0] * BATCH
    found = estimator.estimate(values, uniform(p), 7, 3, 0.5)
    assert len(set(places)) > 1 and float(found[PLACE][0]) != 0
    assert estimator.paths_per_step == paths[1] * BATCH


@pytest.mark.parametrize("who", some(("sampler", "renderer"), ("sampler",)))
def test_nor_is_it_where_pixels_are_chosen_or_paths_differentiated(who, monkeypatch):
    p = blurred_problem(glows=True)
    p.unknowns[PLACE].during = (0.5, 1.0)
    if who == "sampler":
        stage1 = Stage1Settings(resolution=8, probes=2, denoise="none")
        blurred = Blurred(Blur(p, "test"), "image")
        sampler = Differences(stage1=stage1).on(p, losses.L2(), BATCH, blurred=blurred)
        at = lambda spent: sampler.look(p.unknowns.starts(), 3, 0, None, spent)
    else:
        estimator = WholeImages(p, losses.L2(), BATCH, "image", silhouettes="direct")
        at = lambda spent: estimator.estimate(p.unknowns.starts(), uniform(p), 7, 3, spent)
    places = places_of(p, monkeypatch)
    at(0.0)
    assert set(places) == {float(np.float32(AT[0]))}
    at(0.5)
    assert len(set(places)) > 1


@pytest.mark.parametrize("method", some(("kernel", "renderer"), ("kernel",)))
def test_estimates_follow_the_schedule(method):
    """At the end of one that falls to the widths of another: the same numbers as that one's."""
    found = []
    for factor, progress in ((1, 0.0), (3, 1.0), (3, 0.0)):
        p = blurred_problem(glows=True)
        for unknown, width in zip(p.unknowns, SIGMA):
            unknown.blur = BlurConfig(start=factor * width, end=width)
        if method == "kernel":
            estimator = made(p, smooth="image")
        else:
            estimator = WholeImages(p, losses.L2(), BATCH, "image", silhouettes="direct")
        gradient = estimator.estimate(p.unknowns.starts(), uniform(p), 7, 3, progress)
        found.append([float(gradient[key][0]) for key in p.unknowns.keys])
    assert found[1] == pytest.approx(found[0], rel=1e-3)
    assert found[2] != pytest.approx(found[0], rel=0.1)


@pytest.mark.parametrize("spp", some((1, 3), (3,)))
def test_central_differences_are_those_of_the_loss(problem, spp):
    """Against renderings of the whole images at both ends."""
    estimator = FiniteDifferences(problem, losses.L2(), BATCH // spp, 0.5, spp=spp)
    assert estimator.paths_per_step == 4 * 2 * BATCH
    found = rows(estimator, problem, 400)
    renderer = Renderer(problem)
    target = np.array(problem.targets).reshape(-1, 3)
    expected = []
    for number in range(24):
        row = []
        for k in (0, 1):
            ends = []
            for sign in (-1, 1):
                at = np.array(AT, np.float32)
                at[k] += sign * 0.5 * SIGMA[k]
                values = {PLACE: at[:1], COLOUR: at[1:]}
                problem.unknowns.write(problem.unknowns.values_of(values))
                a, b = (means(problem, 64, 1000 * number + side, renderer) for side in (0, 500))
                ends.append(np.mean((a - target) * (b - target)))
            row.append((ends[1] - ends[0]) / SIGMA[k])
        expected.append(row)
    assert unbiased(found, np.array(expected))


def test_an_unknown_without_blur_is_refused():
    p = blurred_problem()
    p.unknowns.items[1].blur = None
    with pytest.raises(InputError, match=f"'{COLOUR}'.*has no blur, which estimator=plateau needs"):
        made(p)


def test_values_beyond_their_range_are_rendered_at_its_end(problem):
    blur = Blur(problem, "plateau")
    blur.write(np.array([0.0, 1.7]))
    assert float(problem.unknowns.params[COLOUR][0]) == 1.0
    assert dr.width(problem.unknowns.leaves[PLACE]) == 1
    assert mi.Float is type(problem.unknowns.leaves[PLACE])
    problem.unknowns.write(problem.unknowns.starts())
