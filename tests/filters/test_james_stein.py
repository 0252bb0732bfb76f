"""How much is smoothed is estimated: nothing where there is no noise, all where there is nothing
else, and in between as far as it pays."""

import mitsuba as mi
import numpy as np
import pytest

from isas_cli.filters import JamesStein, Layout
from isas_cli.filters.axes import convolution
from isas_cli.filters.gaussian import smoothed
from isas_cli.unknowns.parameters import own

SHAPE, AXES, WIDTH = (40, 40, 1), ((0, True), (1, False)), 0.05


def filtered(gradients, seen=None) -> np.ndarray:
    """What becomes of the last of ``gradients``."""
    told = None if seen is None else own(mi.Float, seen.astype(np.float32).ravel())
    on = JamesStein(WIDTH).on(Layout(SHAPE, AXES, told), (0.9, 0.999), True)
    for gradient in gradients:
        found = on.gradient(mi.Float(gradient.ravel().astype(np.float32)), 1.0)
    return np.array(found).reshape(SHAPE)


def smooth(gradient: np.ndarray) -> np.ndarray:
    entries = mi.Float(gradient.ravel().astype(np.float32))
    return np.array(smoothed(entries, Layout(SHAPE, AXES), WIDTH)).reshape(SHAPE)


def test_without_noise_the_gradient_stays():
    gradient = np.random.default_rng(1).normal(size=SHAPE)
    for steps in (1, 2, 30):
        assert np.allclose(filtered([gradient] * steps), gradient, atol=1e-5)
    level = np.full(SHAPE, 0.3)
    assert np.allclose(filtered([level] * 5), level, atol=1e-6)


def test_of_the_first_step_nothing_is_known():
    gradient = np.random.default_rng(2).normal(size=SHAPE)
    assert np.allclose(filtered([gradient]), gradient, atol=1e-6)


def test_of_noise_alone_the_smoothed_gradient_is_left():
    rng = np.random.default_rng(3)
    gradients = [rng.normal(size=SHAPE) for _ in range(80)]
    found, wanted = filtered(gradients), smooth(gradients[-1])
    left = np.mean((found - wanted) ** 2) / np.mean((gradients[-1] - wanted) ** 2)
    print(f"of the noise that smoothing takes away {left:.3f} is left")
    assert left < 0.03


def test_detail_stays_where_it_is_and_noise_goes_elsewhere():
    """A checkerboard in one half, which no single step tells from the noise, and noise in all."""
    rng = np.random.default_rng(4)
    truth = np.indices(SHAPE).sum(axis=0) % 2 * 1.0 - 0.5
    truth[:, 20:] = 0
    gradients = [truth + rng.normal(size=SHAPE) for _ in range(300)]
    found = [filtered(gradients[:count]) for count in range(296, 301)]
    raw = gradients[295:]
    detail, flat = np.s_[:, 4:16], np.s_[:, 26:]
    kept = np.mean([np.vdot(f[detail], truth[detail]) for f in found])
    assert kept / np.vdot(truth[detail], truth[detail]) > 0.8
    left = np.mean([np.var(f[flat]) / np.var(r[flat]) for f, r in zip(found, raw)])
    assert left < 0.12
    wrong = np.mean([np.mean((f - truth) ** 2) for f in found])
    assert wrong < 0.75 * np.mean([np.mean((r - truth) ** 2) for r in raw])


def test_what_is_not_seen_has_no_part_in_it():
    """Neither its gradient nor its noise; it is as it was."""
    rng = np.random.default_rng(5)
    seen = np.ones(SHAPE, bool)
    seen[:, 15:25] = False
    gradients = [rng.normal(size=SHAPE) for _ in range(20)]
    loud = [np.where(seen, g, 1e4 * g) for g in gradients]
    found = [filtered(each, seen=seen) for each in (gradients, loud)]
    assert np.allclose(found[0][seen], found[1][seen], atol=1e-4)
    assert np.array_equal(found[1][~seen], loud[-1].astype(np.float32)[~seen])


def test_the_noise_of_a_mean_is_estimated_without_bias():
    """σ², over many entries and runs, is the variance of what d̄ is."""
    rng = np.random.default_rng(6)
    on = JamesStein(WIDTH, memory=0.9).on(Layout(SHAPE, AXES), (0.9, 0.999), True)
    means, said = [], []
    for _ in range(30):
        on.forget()
        for _ in range(12):
            on.gradient(mi.Float(rng.normal(size=SHAPE).ravel().astype(np.float32)), 1.0)
        told = 1 - 0.9**12
        means.append(np.mean(np.square(np.array(on.memory["mean"]) / told)))
        spread = np.mean(np.array(on.memory["spread"])) / (1 - 0.9**11)
        said.append(spread * 0.1 / 1.9 * (1 + 0.9**12) / told)
    assert np.mean(said) == pytest.approx(np.mean(means), rel=0.05)


def test_detail_as_large_as_its_noise_is_shrunk_as_james_and_stein_do():
    """A checkerboard of the size of what noise of variance 1 leaves in d̄: ρ is the mean of theirs
    over what windows of nine entries hold."""
    rng, β = np.random.default_rng(7), 0.9
    kernel = smooth(np.eye(1, 1600, 20 * 40 + 20).reshape(SHAPE))
    of_step = 1 - 2 * kernel.max() + np.sum(kernel**2)
    size = np.sqrt(of_step * (1 - β) / (1 + β))  # the variance of a mean that forgets by β
    board = size * (np.indices(SHAPE).sum(axis=0) % 2 * 2.0 - 1)
    on = JamesStein(WIDTH, window=1, memory=β).on(Layout(SHAPE, AXES), (0.9, 0.999), True)
    kept = []
    for _ in range(4):
        on.forget()
        for _ in range(60):
            gradient = board + rng.normal(size=SHAPE)
            found = on.gradient(mi.Float(gradient.ravel().astype(np.float32)), 1.0)
        middle = smooth(gradient)
        detail, above = gradient - middle, np.array(found).reshape(SHAPE) - middle
        kept.append(np.vdot(above, detail) / np.vdot(detail, detail))
    squares = rng.noncentral_chisquare(9, 9, 100_000)
    wanted = np.mean(np.maximum(0, 1 - (9 - 2) / squares))
    print(np.mean(kept), wanted)
    assert np.mean(kept) == pytest.approx(wanted, abs=0.05)


@pytest.mark.parametrize("wraps", (True, False))
def test_windows_reflect_and_wrap_as_convolutions_do(wraps):
    kernel = [0.1, 0.2, 0.4, 0.2, 0.1]
    matrix = convolution(6, kernel, wraps)
    assert np.allclose(matrix, matrix.T) and np.allclose(matrix.sum(axis=1), 1)
    ends = matrix[0, [0, 5]]
    assert np.allclose(ends, [0.4, 0.2] if wraps else [0.6, 0.0])
    wide = convolution(3, [1 / 9] * 9, wraps)
    assert np.allclose(wide.sum(axis=1), 1)
