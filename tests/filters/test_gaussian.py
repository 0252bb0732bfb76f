"""Gradients smoothed over their neighbours."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scenes_for_tests import ROUGHNESS, TEXTURE, problem
from scipy.ndimage import gaussian_filter1d

from isas_cli.config.schema import OptimizerConfig
from isas_cli.engine.optimiser import Stepper
from isas_cli.filters import Gaussian, Laplacian, Layout, Nothing
from isas_cli.filters.gaussian import bell, convolved, smoothed
from isas_cli.unknowns.parameters import as_numpy, flat, own, unflat

AROUND = ((0, False), (1, True))  # as an environment is


def smooth(array: np.ndarray, width: float, share: float, seen=None) -> np.ndarray:
    told = None if seen is None else own(mi.Float, seen.astype(np.float32).ravel())
    layout = Layout(array.shape, AROUND, told)
    return np.array(smoothed(mi.Float(array.ravel()), layout, width, share)).reshape(array.shape)


def noise(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def test_it_is_a_gaussian_reflected_at_open_ends_and_around_where_the_map_closes():
    map_ = noise(1, 20, 30, 3)
    for share in (1.0, 1.05**-25):
        once = gaussian_filter1d(map_.astype(float), 2.0 * share, 0, mode="reflect", radius=6)
        both = gaussian_filter1d(once, 3.0 * share, 1, mode="wrap", radius=9)
        assert np.allclose(smooth(map_, 0.1, share), both, atol=1e-6)


def test_it_is_symmetric_and_keeps_what_is_constant():
    a, b = noise(2, 16, 12, 1), noise(3, 16, 12, 1)
    found = [smooth(x, 0.15, 1.0) for x in (a, b)]
    assert np.vdot(found[0], b) == pytest.approx(np.vdot(a, found[1]), rel=1e-4)
    level = np.full((16, 12, 1), 0.7, np.float32)
    assert np.allclose(smooth(level, 0.15, 1.0), 0.7, atol=1e-6)
    # Downhill: no wave is turned round.
    assert np.vdot(found[0], a) > 0


def test_what_is_not_seen_reaches_nothing_and_stays():
    """Of two charts with a gap, each keeps its own constant, whatever lies in the gap."""
    map_, seen = np.zeros((24, 24, 3), np.float32), np.ones((24, 24, 3), bool)
    map_[:, :8], map_[:, 8:18], map_[:, 18:] = 1.0, noise(4, 24, 10, 3) * 1e6, 1.0
    seen[:, 8:18] = False
    found = smooth(map_, 0.08, 1.0, seen)
    assert np.allclose(found[seen], 1.0, atol=1e-5)
    assert np.array_equal(found[~seen], map_[~seen])


def test_with_weights_it_is_symmetric_in_the_metric_of_their_sums_and_leads_downhill():
    rng = np.random.default_rng(5)
    seen = rng.random((16, 12, 1)) < 0.6
    a, b = noise(6, 16, 12, 1) * seen, noise(7, 16, 12, 1) * seen
    layout = Layout(seen.shape, AROUND)
    kernels = [bell(0.1 * side, 5) for side in (16, 12)]
    of_all = np.array(convolved(mi.Float(seen.astype(np.float32).ravel()), layout, kernels))
    metric = of_all.reshape(seen.shape)
    found = [smooth(x, 0.1, 1.0, seen) * seen for x in (a, b)]
    assert np.vdot(found[0] * metric, b) == pytest.approx(np.vdot(a * metric, found[1]), rel=1e-3)
    assert np.vdot(found[0] * metric, a) > 0


def test_at_a_share_of_nothing_and_of_few_entries_it_changes_nothing():
    map_ = noise(3, 16, 12, 3)
    assert np.allclose(smooth(map_, 0.1, 1e-4), map_, atol=1e-7)
    entries = mi.Float(map_.ravel())
    assert smoothed(entries, Layout(map_.shape, AROUND), 0.01) is entries


def errors(chosen, noise: float) -> tuple[float, float]:
    """Of a texture and of a roughness, after 60 steps along (value - truth) + noise."""
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}, size=16)
    stepper = Stepper(p.unknowns, OptimizerConfig(lr=0.05), chosen)
    rng = np.random.default_rng(4)
    truth = {TEXTURE: 0.8, ROUGHNESS: 0.3}
    for step in range(60):
        found = {}
        for key, value in stepper.values.items():
            drawn = mi.Float(noise * rng.normal(size=dr.width(flat(value))))
            found[key] = unflat(value, flat(value) - truth[key] + drawn)
        stepper.step(found, step / 60)
    return tuple(
        float(np.sqrt(np.mean((as_numpy(stepper.values[key]) - truth[key]) ** 2)))
        for key in (TEXTURE, ROUGHNESS)
    )


def test_a_smooth_texture_is_found_sooner_through_noise_and_numbers_are_left_alone():
    plain, smoothed_ = errors(Nothing(), 3.0), errors(Gaussian(0.1), 3.0)
    assert smoothed_[0] < 0.75 * plain[0]
    assert smoothed_[1] == plain[1]


def test_widths_are_of_a_ladder():
    """Dr.Jit keeps a table of every kernel that it has met, and rates fall at every step."""
    array = noise(4, 30, 40)
    before = len(dr._resample_cache)
    for share in np.linspace(1, 0.5, 200):
        smooth(array, 0.1, share)
    assert 0 < len(dr._resample_cache) - before <= 32


def test_maps_too_small_for_it_are_known():
    p = problem({TEXTURE: 0.5})
    assert not Stepper(p.unknowns, OptimizerConfig(), Gaussian()).filtering
    assert not Stepper(p.unknowns, OptimizerConfig(), Laplacian()).filtering
    assert Stepper(p.unknowns, OptimizerConfig(), Gaussian(0.2)).filtering
    assert Stepper(p.unknowns, OptimizerConfig(), Laplacian(coarsest=1)).filtering
