"""Loss derivatives against differences, and what each claims about bias."""

import mitsuba as mi
import numpy as np
import pytest

from isas_cli.losses import L1, L2, RelativeL2
from isas_cli.runtime.errors import InputError

LOSSES = {"l2": L2(), "relative_l2": RelativeL2(), "l1": L1()}


@pytest.mark.parametrize("name", LOSSES)
def test_derivative_matches_central_differences(name, rng):
    loss, step = LOSSES[name], 1e-3
    image, target = rng.uniform(0, 4, (3, 200)), rng.uniform(0, 4, (3, 200))
    image[np.abs(image - target) < 0.01] += 0.1  # L1's kink
    up, down = (
        np.array(loss.value(mi.Color3f(image + s), mi.Color3f(target)), np.float64)
        for s in (step, -step)
    )
    derivative = np.array(loss.derivative(mi.Color3f(image), mi.Color3f(target)))
    assert np.allclose(derivative, (up - down) / (2 * step), rtol=2e-2, atol=2e-2)


@pytest.mark.parametrize("name", ("l2", "relative_l2"))
def test_curvature_is_the_difference_of_the_derivative(name, rng):
    loss, step = LOSSES[name], 1e-2
    target = rng.uniform(0, 4, (3, 200))
    up, down = (
        np.array(loss.derivative(mi.Color3f(target + s), mi.Color3f(target)), np.float64)
        for s in (step, -step)
    )
    curvature = np.array(loss.curvature(mi.Color3f(target)))
    assert np.allclose(curvature, (up - down) / (2 * step), rtol=1e-2)


@pytest.mark.parametrize("name", LOSSES)
def test_linear_says_whether_the_derivative_is_linear(name, rng):
    """For a linear derivative the mean of derivatives is the derivative at the mean."""
    loss = LOSSES[name]
    samples = rng.exponential(1, (3, 10_000))
    target = mi.Color3f(0.7)
    mean = np.array(loss.derivative(mi.Color3f(samples), target), np.float64).mean(axis=1)
    at_mean = np.array(loss.derivative(mi.Color3f(samples.mean(axis=1)), target)).reshape(3)
    assert np.allclose(mean, at_mean, rtol=1e-3, atol=1e-4) == loss.linear


@pytest.mark.parametrize("name", LOSSES)
def test_measured_loss_is_free_of_noise_where_the_loss_is_quadratic(name, rng):
    loss = LOSSES[name]
    a, b = (mi.Color3f(rng.exponential(1, (3, 200_000))) for _ in range(2))
    target = mi.Color3f(0.7)
    mean = np.array(loss.measured(a, b, target), np.float64).mean()
    exact = float(loss.value(mi.Color3f(1.0), target)[0][0])
    assert (abs(mean / exact - 1) < 0.05) == loss.linear


def test_black_targets_stay_finite():
    assert np.all(np.isfinite(np.array(RelativeL2().derivative(mi.Color3f(5.0), mi.Color3f(0.0)))))


@pytest.mark.parametrize("name", LOSSES)
@pytest.mark.parametrize("radiance", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_has_no_derivative(name, radiance):
    """Estimators leave it out and count it; the sign of it would pass for one."""
    found = np.array(LOSSES[name].derivative(mi.Color3f(radiance), mi.Color3f(0.3)))
    assert not np.isfinite(found).any()


@pytest.mark.parametrize("name", LOSSES)
def test_nothing_to_do_at_the_target(name):
    assert np.all(np.array(LOSSES[name].derivative(mi.Color3f(0.3), mi.Color3f(0.3))) == 0)


def test_epsilon_must_be_positive():
    with pytest.raises(InputError, match="loss.epsilon"):
        RelativeL2(epsilon=0)
