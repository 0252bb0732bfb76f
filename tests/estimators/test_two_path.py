"""The two-path estimator: freezing, masks, both paths differentiated. That it is unbiased with any
sampler: ``test_unbiased``."""

from dataclasses import replace
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import volumes_for_tests
from gradient_estimates import Gradients
from montecarlo import welch
from scenes_for_tests import ROUGHNESS, TEXTURE, problem, render_targets

from isas_cli import losses
from isas_cli.config.schema import BlurConfig
from isas_cli.estimators.two_path import TwoPath
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.unknowns import smoothing
from isas_cli.unknowns.parameters import flat

BATCH = 512


def test_freezing_changes_nothing():
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    frozen = Gradients(p, losses.L2(), BATCH).uniform(6, 1)
    unfrozen = partial(TwoPath, freeze=False)
    traced = Gradients(p, losses.L2(), BATCH, unfrozen).uniform(6, 1)
    assert np.abs(frozen - traced).max() <= 1e-6 * np.abs(traced).max()


def test_masked_pixels_do_not_count():
    p = problem({ROUGHNESS: 0.5})
    made = Gradients(p, losses.L2(), BATCH)
    whole = made.uniform(2, 1)
    p.set_targets(p.targets, dr.full(mi.Float, 0.5, p.views.total), "test")
    half = made.uniform(2, 1)
    # A constant weight is normalised away: ℒ is a weighted mean.
    assert np.allclose(whole, half, rtol=1e-5)
    mask = np.zeros(p.views.total, np.float32)
    mask[0] = 1
    p.set_targets(p.targets, mi.Float(mask), "test")
    # The corner sees the sky only.
    assert np.all(made.uniform(2, 1) == 0)


def surfaces(derivative: int):
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}, depth=3)
    whole = p.integrator.paths
    return replace(p, integrator=p.integrator.cut(replace(whole, derivative=derivative)))


def medium():
    p = volumes_for_tests.problem(*volumes_for_tests.uneven())
    render_targets(p, 64)
    return p


def one_way(p):
    paths = replace(p.integrator.paths, crossed=False)
    return replace(p, integrator=p.integrator.cut(paths))


def own_residuals(p, loss, batch: int) -> TwoPath:
    """Each path weighted by its own residual, whose noise is that of its derivative."""

    def along(integrator, scene, streams, rays, adjoints):
        integrator.pair(scene, streams, rays, lambda found: adjoints(found)[::-1])

    return TwoPath(p, loss, batch, True, along)


@pytest.mark.parametrize(
    "made, misled",
    [(partial(surfaces, 3), True), (partial(surfaces, 2), False), (medium, False)],
    ids=["all", "beginning", "medium"],
)
def test_both_paths_tell_the_same_and_more(made, misled):
    """The same mean as one path's derivative with the other's residual, and less noise; a path's
    own residual is noticed (``misled``)."""
    p, repeats, level = made(), 200, 1e-3
    assert p.integrator.crosses and not one_way(p).integrator.crosses
    once = Gradients(one_way(p), losses.L2(), BATCH).uniform(2 * repeats, 2)
    both = Gradients(p, losses.L2(), BATCH).uniform(repeats, 1)
    outcome = welch(both, once, level)
    noise = both.var(axis=0, ddof=1).sum() / once.var(axis=0, ddof=1).sum()
    print(outcome, noise)
    assert outcome.p_value > level and noise < 0.85
    if misled:
        wrong = Gradients(p, losses.L2(), BATCH, own_residuals).uniform(repeats, 1)
        assert welch(wrong, once, level).p_value < level


def test_a_bad_path_is_counted_whichever_it_is():
    p = problem({TEXTURE: 0.5})
    made = Gradients(p, losses.L2(), BATCH)
    made.uniform(1, 1)
    assert made._estimator.nonfinite == 0
    p.set_targets(dr.full(mi.Float, np.nan, dr.width(p.targets)), None, "test")
    made.uniform(1, 1)
    assert made._estimator.nonfinite == BATCH * (1 + p.integrator.crosses)


def test_a_blurred_gradient_is_the_mean_over_the_blur():
    """Against Gauss-Hermite quadrature of sharp gradients, of a roughness whose slope changes much
    within the blur; the sharp gradient in the middle is another."""
    σ, repeats = 0.15, 100
    p = problem({ROUGHNESS: 0.5})
    unknown = p.unknowns[ROUGHNESS]
    unknown.blur = BlurConfig(start=σ, end=σ)
    estimator = TwoPath(p, losses.L2(), 16 * BATCH, blurred=True)
    sharp = Gradients(p, losses.L2(), 16 * BATCH)
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    values = p.unknowns.starts()
    found = [
        float(np.array(flat(estimator.estimate(values, uniform, 1, i, 0.0)[ROUGHNESS]))[0])
        for i in range(10 * repeats)
    ]
    nodes, weights = np.polynomial.hermite_e.hermegauss(7)
    means, errors = [], []
    for node, base in zip(nodes, range(20, 40)):
        sharp.values = p.unknowns.values_of({ROUGHNESS: unknown.start + np.float32(σ * node)})
        rows = sharp.uniform(repeats, base)[:, 0]
        means.append(rows.mean())
        errors.append(rows.std(ddof=1) / np.sqrt(repeats))
    p.unknowns.write(values)
    weights = weights / weights.sum()
    exact, middle = float(weights @ means), means[3]
    own = np.std(found, ddof=1) / len(found) ** 0.5
    error = np.hypot(own, np.sqrt(weights**2 @ np.square(errors)))
    print(np.mean(found), exact, middle, error)
    assert abs(np.mean(found) - exact) < 4 * error
    assert abs(np.mean(found) - middle) > 4 * error, "the case shows nothing"


def test_what_rests_is_not_blurred(monkeypatch):
    p, places = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}), []
    for unknown in p.unknowns:
        unknown.blur = BlurConfig(start=0.1, end=0.1)
    p.unknowns[TEXTURE].during = (0.5, 1.0)
    estimator = TwoPath(p, losses.L2(), BATCH, blurred=True)
    uniform, values = PixelDistribution.uniform(Tiles.over(p.views)), p.unknowns.starts()
    gradients = estimator.gradients
    monkeypatch.setattr(
        estimator, "gradients", lambda at, *given: places.append(at) or gradients(at, *given)
    )
    for spent in (0.0, 0.5):
        estimator.estimate(values, uniform, 1, 0, spent)
    p.unknowns.write(values)
    moved = [[bool(dr.any(flat(at[key]) != 0.5)) for key in (TEXTURE, ROUGHNESS)] for at in places]
    assert moved == [[False, True], [True, True]]


def test_beyond_an_end_of_its_range_a_blurred_gradient_is_none(monkeypatch):
    """Of what is clamped there; at the end itself it is that of the same image."""
    p = problem({ROUGHNESS: 0.5})
    p.unknowns[ROUGHNESS].blur = BlurConfig(start=0.1, end=0.1)
    estimator = TwoPath(p, losses.L2(), BATCH, blurred=True)
    uniform, values = PixelDistribution.uniform(Tiles.over(p.views)), p.unknowns.starts()
    found = []
    for offset in (0.5, 0.6):
        monkeypatch.setattr(smoothing, "blurred", lambda σ, rng, by=offset: np.full(σ.size, by))
        gradient = estimator.estimate(values, uniform, 1, 0, 0.0)[ROUGHNESS]
        found.append(float(np.array(flat(gradient))[0]))
    p.unknowns.write(values)
    assert p.unknowns[ROUGHNESS].high == 1 and found[0] != 0 and found[1] == 0
