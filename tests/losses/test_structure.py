"""A loss of windows: against SSIM, against differences, against brute force."""

import functools

import mitsuba as mi
import numpy as np
import pytest
from gradient_estimates import Gradients
from montecarlo import z_against
from problems_for_tests import built

from isas_cli.engine.evaluate import Evaluator
from isas_cli.losses import Structure
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.runtime.errors import InputError
from isas_cli.samplers.ours import Ours
from isas_cli.scene.views import Views


def colours(x: np.ndarray) -> mi.Color3f:
    """``(3, windows, lanes)`` as a loss takes it."""
    return mi.Color3f(np.ascontiguousarray(x.reshape(3, -1), dtype=np.float32))


def dissimilarity(image: np.ndarray, target: np.ndarray, range_: float) -> np.ndarray:
    """1 - SSIM of windows along the last axis, as Wang et al. 2004 define it."""
    a, b = (0.01 * range_) ** 2, (0.03 * range_) ** 2
    means = image.mean(-1), target.mean(-1)
    both = ((image - means[0][..., None]) * (target - means[1][..., None])).mean(-1)
    light = (2 * means[0] * means[1] + a) / (means[0] ** 2 + means[1] ** 2 + a)
    rest = (2 * both + b) / (image.var(-1) + target.var(-1) + b)
    return 1 - light * rest


@pytest.mark.parametrize("side, range_", [(7, 1.0), (2, 1.0), (5, 8.0)])
def test_near_the_target_it_is_one_minus_ssim(side, range_, rng):
    target = rng.uniform(0, 4, (3, 50, side**2))
    offset = rng.normal(size=target.shape) + rng.normal(size=(3, 50, 1))
    loss, apart = Structure(side=side, range=range_), []
    for step in (0.1, 0.025):
        image = target + step * offset
        exact = dissimilarity(image, target, range_)
        found = np.array(loss.value(colours(image), colours(target)), np.float64)
        apart.append(np.abs(found - exact).mean() / exact.mean())
    assert apart[1] < 0.08 and apart[1] < 0.4 * apart[0], "only terms of third order differ"


def test_a_bright_window_keeps_its_variance(rng):
    """Of a mean of 1000 and a spread of 0.1: squares of single precision have no digits left."""
    target = 1000 + rng.uniform(-0.1, 0.1, (3, 20, 49))
    offset = rng.uniform(-0.1, 0.1, target.shape)
    loss = Structure()
    found = np.array(loss.value(colours(target + offset), colours(target)))
    exact = dissimilarity(target + offset, target, 1.0)
    assert found.mean() == pytest.approx(exact.mean(), rel=0.5)


def test_an_image_far_from_its_target_keeps_its_variance(rng):
    """Twice as bright: of a difference of 1000 and a spread of 0.1."""
    target = (1000 + rng.uniform(-0.1, 0.1, (3, 20, 49))).astype(np.float32)
    image = (target + 1000 + rng.uniform(-0.1, 0.1, target.shape)).astype(np.float32)
    found = np.array(Structure().value(colours(image), colours(target)))
    d, t = image.astype(np.float64) - target, target.astype(np.float64)
    exact = d.mean(-1) ** 2 / (2 * t.mean(-1) ** 2 + 0.01**2)
    exact += d.var(-1) / (2 * t.var(-1) + 0.03**2)
    np.testing.assert_allclose(found.reshape(exact.shape), exact, rtol=0.02)


def test_windows_repeat_the_last_pixels_of_their_own_picture():
    from isas_cli.rendering.windows import Windows

    views = Views.of([(4, 3), (2, 5)])
    middle = mi.UInt32(0, 1), mi.UInt32(3, 0), mi.UInt32(0, 2)
    view, column, row, window = Windows(3).spread(views, *middle, 2)
    assert np.array(view).tolist() == [0] * 9 + [1] * 9 == np.array(window).tolist()
    assert np.array(column).tolist() == [2, 3, 3] * 3 + [0, 0, 1] * 3
    assert np.array(row).tolist() == [0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 2, 2, 2, 3, 3, 3]


def along_all(problem, loss, step: float = 0.02) -> float:
    """∂ℒ where all unknowns rise alike, by central differences of every window, without the noise
    of either side: both with the same random numbers, products of independent halves."""
    # More pixels than there are: a window around each.
    evaluator = Evaluator(problem, loss, 10 * problem.views.total * loss.windows.count, 128, 3)
    starts = {u.key: u.start for u in problem.unknowns}
    ends = (
        evaluator(problem.unknowns.values_of({k: np.float32(x + s) for k, x in starts.items()}))
        for s in (step, -step)
    )
    high, low = (end["loss"] for end in ends)
    return (high - low) / (2 * step)


@functools.cache
def windowed(masked: bool) -> tuple:
    """A problem, its loss and the whole loss's derivative."""
    problem, loss = built("scene=pottery", "size=tiny", "target.spp=4"), Structure(side=3)
    total = problem.views.total
    rng = np.random.default_rng(5)
    targets = np.array(problem.targets).reshape(-1, 3) * rng.uniform(0.5, 1.5, (total, 3))
    mask = (rng.random(total) > 0.03).astype(np.float32)
    problem.set_targets(
        mi.Float(np.float32(targets.ravel())), mi.Float(mask) if masked else None, "test"
    )
    return problem, loss, along_all(problem, loss)


@pytest.mark.parametrize("masked, drawn", [(False, "uniform"), (True, "uniform"), (True, "ours")])
def test_its_gradient_is_that_of_all_windows(masked, drawn, seed):
    """On targets that cannot be met, of a scene with noise; pixels without weight take the windows
    that hold them out."""
    problem, loss, exact = windowed(masked)
    gradients = Gradients(problem, loss, 9 * 1024)
    if drawn == "uniform":
        distribution = PixelDistribution.uniform(Tiles.over(problem.views))
        rows = gradients.drawn_from(distribution, 128, seed)
    else:
        rows = gradients.sampled(gradients.prepared(Ours()), 128, seed)
    along = rows.sum(axis=1, keepdims=True)
    error = along.std() / np.sqrt(128)
    print(f"{along.mean():.4g} ± {error:.2g}, exact {exact:.4g}")
    assert error < 0.05 * abs(exact)
    assert z_against(along, np.array([exact])) > 1e-4


def test_what_takes_single_pixels_refuses_it(refused):
    for other in ("scene=dodoco_b", "scene=pottery sampler=mitsuba", "scene=cup sampler=plateau"):
        asked = ["run", *other.split(), "size=tiny", "loss=structure"]
        refused(asked, "takes losses of pixels by themselves", "estimator=two_path")


@pytest.mark.parametrize("given", [{"side": 1}, {"side": 100}, {"range": 0}, {"range": np.inf}])
def test_settings_are_checked(given):
    with pytest.raises(InputError, match="loss."):
        Structure(**given)
