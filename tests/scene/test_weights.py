"""Views that count differently."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scenes_for_tests import TEXTURE, problem

from isas_cli.engine.evaluate import Evaluator
from isas_cli.estimators.two_path import TwoPath
from isas_cli.losses.l2 import L2
from isas_cli.losses.structure import Structure
from isas_cli.rendering import targets
from isas_cli.rendering.integrators import Paths
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.runtime.errors import InputError
from isas_cli.scene.weights import of_views
from isas_cli.unknowns.parameters import as_numpy

MASKS = [np.ones(12), np.array([1.0, 1.0, 0.0, 0.0]), np.ones(8)]


def test_equal_lets_every_view_count_alike_whatever_its_size_and_mask():
    weights = of_views("equal", MASKS)
    sums = [weight * mask.sum() for weight, mask in zip(weights, MASKS)]
    assert np.allclose(sums, sums[0]) and np.mean(weights) == pytest.approx(1)


def test_numbers_are_taken_as_they_are_up_to_their_mean():
    assert np.allclose(of_views([1, 2, 3], MASKS), [0.5, 1.0, 1.5])


@pytest.mark.parametrize(
    "given", [[1, 2], [1, 2, 0], [1, 2, -1], [1, 2, float("nan")], "most", "123", 3, [[1], 2, 3]]
)
def test_other_weights_are_refused_in_one_line(given):
    with pytest.raises(InputError, match=r"scene\.weights=.*each of the 3 views"):
        of_views(given, MASKS)


def test_a_wrong_number_is_refused_before_targets_are_rendered(monkeypatch, refused):
    monkeypatch.setattr(targets, "render", None)
    told = "scene.weights=[1, 2, 3]: must be equal, or a number above 0 for each of the 2 views"
    refused(["run", "scene=pottery", "size=tiny", "scene.weights=[1,2,3]"], told)


def test_a_view_of_which_nothing_counts_is_named():
    with pytest.raises(InputError, match="view 1 counts"):
        of_views("equal", [np.ones(3), np.zeros(3)])
    with pytest.raises(InputError, match="view b.png counts"):
        of_views("equal", [np.ones(3), np.zeros(3)], ["a.png", "b.png"])


def test_a_view_of_which_what_is_beside_the_object_counts_alone_is_weighed_by_that():
    """As of photographs before black whose object is too bright for the camera."""
    p = problem({TEXTURE: 0.5})
    (first, second) = (width * height for width, height in p.film_sizes)
    mask, part = np.ones((2, p.views.total), np.float32)
    part[:first:2] = 0
    mask[first::2], part[first + 1 :: 2] = 0, 0
    p.set_targets(p.targets, mi.Float(mask), "test")
    p.part = mi.Float(part)
    p.weigh("equal")
    counted = first - (first + 1) // 2, second - (second + 1) // 2
    assert p.weights[0] * counted[0] == pytest.approx(p.weights[1] * counted[1])


def gradient(p) -> np.ndarray:
    """Mean over 60 estimates."""
    pmf = PixelDistribution.uniform(Tiles.over(p.views))
    estimator, values = TwoPath(p, L2(), 4096), p.unknowns.starts()
    found = [as_numpy(estimator.estimate(values, pmf, 1, i, 0.0)[TEXTURE]) for i in range(60)]
    return np.array(found, np.float64)


def test_the_gradient_is_the_weighted_mean_of_the_views_own():
    """Two views of equal size: with weights 3 and 1, ¾ of the one's and ¼ of the other's."""
    both = problem({TEXTURE: 0.5})
    single = []
    for view in (0, 1):
        p = problem({TEXTURE: 0.5})
        mask = np.repeat([view == 0, view == 1], p.views.total // 2).astype(np.float32)
        p.set_targets(p.targets, mi.Float(mask), "test")
        single.append(gradient(p))
    unweighed = both.target_hash
    both.weigh([3, 1])
    assert both.target_hash != unweighed, "runs of other weights are another problem"
    whole = gradient(both)
    wanted = 0.75 * single[0].mean(0) + 0.25 * single[1].mean(0)
    error = np.sqrt(whole.var(0) + single[0].var(0) + single[1].var(0)) / np.sqrt(60)
    assert np.abs((whole.mean(0) - wanted) / np.maximum(error, 1e-12)).max() < 5
    alike = (single[0].mean(0) + single[1].mean(0)) / 2
    assert np.abs((whole.mean(0) - alike) / np.maximum(error, 1e-12)).max() > 6


def measured(p) -> np.ndarray:
    """The square of the image's error, the loss, and the square of how far paths of two edges are
    from all."""
    evaluator, values = Evaluator(p, L2(), p.views.total, 64, 1), p.unknowns.starts()
    found = evaluator(values)
    apart = evaluator.apart(replace(p, integrator=p.integrator.cut(Paths(2, 2))), values)
    return np.array([found["image_rmse"] ** 2, found["loss"], apart**2])


def test_what_is_measured_is_the_weighted_mean_of_the_views_own():
    """Of the same two, to rounding."""
    p, single = problem({TEXTURE: 0.5}), []
    for view in (0, 1):
        # More than none, so that all pixels are rendered, by the same random numbers.
        mask = np.repeat([view == 0, view == 1], p.views.total // 2) + 1e-9
        p.set_targets(p.targets, mi.Float(mask.astype(np.float32)), "test")
        single.append(measured(p))
    p.set_targets(p.targets, None, "test")
    p.weigh([3, 1])
    assert np.allclose(measured(p), 0.75 * single[0] + 0.25 * single[1], rtol=1e-4, atol=0)
    assert np.abs(single[0] / single[1] - 1).min() > 0.02, "the case shows nothing"


def test_what_counts_much_is_measured_as_much_however_few_pixels_are_drawn(monkeypatch):
    """One pixel that counts as much as all others, and alone shows anything."""
    p = problem({TEXTURE: 0.5})
    mask = np.ones(p.views.total, np.float32)
    mask[7] = mask.size - 1
    p.set_targets(p.targets, mi.Float(mask), "test")

    def halves(self, values, renderer=None):
        shown = dr.select(self.pixels == 7, mi.Color3f(1), 0)
        return (shown, shown) if renderer is None else (0 * shown, 0 * shown)

    monkeypatch.setattr(Evaluator, "_halves", halves)
    for seed in range(8):
        evaluator = Evaluator(p, L2(), 64, 2, seed)
        assert abs(np.mean(np.array(evaluator.pixels) == 7) - 0.5) <= 1 / 64
        evaluator.target = dr.zeros(mi.Color3f, 64)
        evaluator.references = evaluator.target, evaluator.target
        found, apart = evaluator(p.unknowns.starts()), evaluator.apart(p, {})
        for each in (found["loss"], found["image_rmse"] ** 2, apart**2):
            assert each == pytest.approx(0.5, abs=1.01 / 64)


def test_pixels_of_windows_that_are_drawn_count_over_what_their_windows_do():
    p, loss = problem({TEXTURE: 0.5}), Structure(side=3)
    mask = np.random.default_rng(1).uniform(0.2, 1, p.views.total).astype(np.float32)
    p.set_targets(p.targets, mi.Float(mask), "test")
    evaluator = Evaluator(p, loss, 20 * loss.windows.count, 2, 1)
    own = mask[np.array(evaluator.pixels)].reshape(-1, loss.windows.count)
    found = np.array(evaluator._weight()).reshape(own.shape)
    assert np.allclose(found, own / own.min(axis=1, keepdims=True))


def test_pixels_that_count_alike_are_drawn_as_without_weights():
    p = problem({TEXTURE: 0.5})
    evenly = np.array(Evaluator(p, L2(), 64, 2, 1).pixels)
    p.set_targets(p.targets, dr.ones(mi.Float, p.views.total), "test")
    assert np.array_equal(np.array(Evaluator(p, L2(), 64, 2, 1).pixels), evenly)
