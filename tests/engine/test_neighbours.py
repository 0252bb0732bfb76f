"""Gradients smoothed over their neighbours."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scenes_for_tests import ROUGHNESS, TEXTURE, problem
from scipy.ndimage import gaussian_filter1d

from isas_cli.config.schema import OptimizerConfig
from isas_cli.engine.neighbours import smoothed
from isas_cli.engine.optimiser import Stepper
from isas_cli.runtime.errors import InputError
from isas_cli.unknowns.parameters import as_numpy, flat, unflat

AROUND = ((0, False), (1, True))  # as an environment is


def test_it_is_a_gaussian_reflected_at_open_ends_and_around_where_the_map_closes():
    map_ = np.random.default_rng(1).normal(size=(20, 30, 3)).astype(np.float32)
    for share in (1.0, 0.3):
        ours = np.array(smoothed(mi.TensorXf(map_), AROUND, 0.1, share))
        once = gaussian_filter1d(map_.astype(float), 2.0 * share, 0, mode="reflect", radius=6)
        both = gaussian_filter1d(once, 3.0 * share, 1, mode="wrap", radius=9)
        assert np.allclose(ours, both, atol=1e-6)


def test_it_is_symmetric_and_keeps_what_is_constant():
    rng = np.random.default_rng(2)
    a, b = (rng.normal(size=(16, 12, 1)).astype(np.float32) for _ in range(2))
    smooth = [np.array(smoothed(mi.TensorXf(x), AROUND, 0.15, 1.0)) for x in (a, b)]
    assert np.vdot(smooth[0], b) == pytest.approx(np.vdot(a, smooth[1]), rel=1e-4)
    flat_ = mi.TensorXf(np.full((16, 12, 1), 0.7, np.float32))
    assert np.allclose(np.array(smoothed(flat_, AROUND, 0.15, 1.0)), 0.7, atol=1e-6)
    # Downhill: no wave is turned round.
    assert np.vdot(smooth[0], a) > 0


def test_at_a_share_of_nothing_and_of_few_entries_it_changes_nothing():
    map_ = mi.TensorXf(np.random.default_rng(3).normal(size=(16, 12, 3)).astype(np.float32))
    assert np.allclose(np.array(smoothed(map_, AROUND, 0.1, 1e-4)), np.array(map_), atol=1e-7)
    assert smoothed(map_, AROUND, 0.01, 1.0) is map_


def errors(smoothing: float, noise: float) -> tuple[float, float]:
    """Of a texture and of a roughness, after 60 steps along (value - truth) + noise."""
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}, size=16)
    stepper = Stepper(p.unknowns, OptimizerConfig(lr=0.05, smoothing=smoothing))
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
    plain, smooth = errors(0.0, 3.0), errors(0.1, 3.0)
    assert smooth[0] < 0.75 * plain[0]
    assert smooth[1] == plain[1]


def test_entries_whose_gradient_is_not_finite_do_not_reach_their_neighbours():
    p = problem({TEXTURE: 0.5})
    stepper = Stepper(p.unknowns, OptimizerConfig(smoothing=0.1))
    value = stepper.values[TEXTURE]
    entries = np.ones(dr.width(flat(value)), np.float32)
    entries[7] = np.nan
    stepper.step({TEXTURE: unflat(value, mi.Float(entries))}, 0.0)
    assert int(stepper.nonfinite[0]) == 1
    assert np.isfinite(as_numpy(stepper.values[TEXTURE])).all()


@pytest.mark.parametrize("wrong", [-0.1, 0.25, float("nan")])
def test_a_width_that_is_none_is_refused(wrong):
    with pytest.raises(InputError, match=r"optimizer\.smoothing=.*\[0, 0\.25\)"):
        OptimizerConfig(smoothing=wrong)
