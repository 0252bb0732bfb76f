"""The two-path estimator: freezing and masks. That it is unbiased: ``test_unbiased``."""

from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
from gradient_estimates import Gradients
from scenes_for_tests import ROUGHNESS, TEXTURE, problem

from isas_cli import losses
from isas_cli.estimators.two_path import TwoPath

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
