"""Masks, views and weights in gradients other than path replay's: by identities that hold to
rounding for the same random numbers, and by means where random numbers differ."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from crosses import some
from poses_for_tests import blurred_problem
from scipy import stats

from isas_cli import losses
from isas_cli.estimators.finite_differences import FiniteDifferences
from isas_cli.estimators.mitsuba import WholeImages
from isas_cli.estimators.plateau import Plateau
from isas_cli.rendering.pixels import PixelDistribution, Tiles

BATCH = 384
MADE = {
    "image": lambda p, loss: Plateau(p, loss, BATCH, "image"),
    "loss": lambda p, loss: Plateau(p, loss, BATCH, "loss"),
    "finite_differences": lambda p, loss: FiniteDifferences(p, loss, BATCH, 1.0),
    "mitsuba": lambda p, loss: WholeImages(p, loss, BATCH, silhouettes="direct"),
    "renderer": lambda p, loss: WholeImages(p, loss, BATCH, "image", silhouettes="direct"),
}


def gradients(p, name: str, loss, mask, count: int = 3, base: int = 3) -> np.ndarray:
    """``(count, 2)`` times the sum of the weights, so that masks add up."""
    weights = None if mask is None else mi.Float(mask.astype(np.float32))
    p.set_targets(p.targets, weights, "test")
    estimator, values = MADE[name](p, loss), p.unknowns.starts()
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    found = []
    for i in range(count):
        gradient = estimator.estimate(values, uniform, base, i, 0.0)
        found.append([float(gradient[key][0]) for key in p.unknowns.keys])
    p.unknowns.write(values)
    return np.array(found) * (p.views.total if mask is None else mask.sum())


@pytest.fixture(scope="module", params=(False, True), ids=("one view", "two views"))
def problem(request):
    return blurred_problem(glows=True, blind=request.param)


@pytest.mark.parametrize("name", MADE)
def test_gradients_of_a_mask_and_of_its_complement_add_up(problem, name):
    mask = np.random.default_rng(2).random(problem.views.total)
    whole, one, other = (gradients(problem, name, losses.L2(), m) for m in (None, mask, 1 - mask))
    assert np.abs(one).min() > 1e-6 and not np.allclose(one, other, rtol=0.05)
    assert np.allclose(whole, one + other, rtol=2e-3, atol=1e-5 * np.abs(whole).max())


@pytest.mark.parametrize("name", some([*MADE], ("image", "loss")))
def test_relative_l2_is_l2_weighted_by_the_target(problem, name):
    """All is grey, so that one weight does for all channels."""
    loss = losses.RelativeL2()
    target = np.array(problem.targets).reshape(-1, 3)
    assert np.allclose(target, target[:, :1], atol=1e-5)
    weighted = gradients(problem, name, losses.L2(), 1 / (target[:, 0] ** 2 + loss.epsilon))
    relative = gradients(problem, name, loss, None)
    assert np.allclose(relative, weighted, rtol=2e-3, atol=1e-5 * np.abs(weighted).max())


@pytest.mark.parametrize("name", some(("image", "loss", "finite_differences"), ("image",)))
def test_a_view_that_shows_nothing_adds_nothing(name):
    """A first camera that looks away: the same gradient, times the pixels, as without it."""
    alone, beside = (
        gradients(blurred_problem(glows=True, blind=blind), name, losses.L2(), None, 800, base)
        for blind, base in ((False, 3), (True, 4))
    )
    test = stats.ttest_ind(alone, beside, equal_var=False)
    print(alone.mean(axis=0), beside.mean(axis=0), test.pvalue)
    assert test.pvalue.min() > 1e-4
    # A factor of two between them would be seen.
    errors = beside.std(axis=0) / np.sqrt(len(beside))
    assert np.max(np.abs(beside.mean(axis=0)) / errors) > 12
