"""One path that is not finite costs its pixel, not the step, and is counted."""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scenes_for_tests import ROUGHNESS, problem
from test_aside import problem as with_plastic

from isas_cli.config.schema import BlurConfig, UnknownConfig
from isas_cli.estimators import renderings
from isas_cli.estimators.aside import Aside
from isas_cli.estimators.finite_differences import FiniteDifferences
from isas_cli.estimators.mitsuba import WholeImages
from isas_cli.estimators.plateau import Plateau
from isas_cli.estimators.two_path import TwoPath
from isas_cli.losses.l2 import L2
from isas_cli.rendering.pixels import PixelDistribution, Tiles

BATCH, BAD = 2048, 7


class Spoiled:
    """An integrator whose path ``BAD`` brings what is no number."""

    def __init__(self, whole, brings: float = dr.nan):
        self._whole, self._brings = whole, brings

    def __getattr__(self, name):
        return getattr(self._whole, name)

    def primal(self, scene, sampler, ray):
        radiance, *rest = self._whole.primal(scene, sampler, ray)
        lane = dr.arange(mi.UInt32, dr.width(radiance))
        return dr.select(lane == BAD, mi.Spectrum(self._brings), radiance), *rest


@dataclasses.dataclass(frozen=True)
class Bounded(L2):
    """A loss that makes of what is no number one that passes for sound."""

    linear = False

    def measured(self, a, b, target):
        return dr.clip(super().measured(a, b, target), -0.1, 0.1)

    def derivative(self, image, target):
        return dr.clip(super().derivative(image, target), -0.1, 0.1)


def of(p, make) -> tuple[dict, int]:
    estimator = make(p)
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    found = estimator.estimate(p.unknowns.starts(), uniform, 3, 0, 0.5)
    return {key: np.ravel(np.array(value)) for key, value in found.items()}, estimator.nonfinite


def image(p):
    return Plateau(p, L2(), BATCH, freeze=False)


def loss(p):
    return Plateau(p, L2(), BATCH, smooth="loss", freeze=False)


def differences(p):
    return FiniteDifferences(p, L2(), BATCH, 1.0, freeze=False)


@pytest.mark.parametrize("make", [image, loss, differences])
def test_a_step_survives_it(make):
    p = problem({ROUGHNESS: UnknownConfig(start=0.4, blur=BlurConfig(start=0.05, end=0.05))})
    clean, none = of(p, make)
    spoiled, lost = of(dataclasses.replace(p, integrator=Spoiled(p.integrator)), make)
    assert none == 0 and lost > 0
    for key in clean:
        assert np.isfinite(spoiled[key]).all()
        # The sum over a batch without one of its pixels.
        np.testing.assert_allclose(spoiled[key], clean[key], rtol=0.2)


def test_differences_beside_paths_survive_it(monkeypatch):
    p = with_plastic({"type": "roughplastic", "alpha": 0.2}, {"alpha": 0.25})
    clean, none = of(p, lambda p: TwoPath(p, L2(), BATCH, freeze=False))
    honest = Aside.__init__

    def spoil(self, problem, *more):
        honest(self, dataclasses.replace(problem, integrator=Spoiled(problem.integrator)), *more)

    monkeypatch.setattr(Aside, "__init__", spoil)
    spoiled, lost = of(p, lambda p: TwoPath(p, L2(), BATCH, freeze=False))
    assert none == 0 and lost > 0
    for key in clean:
        assert np.isfinite(spoiled[key]).all()
        np.testing.assert_allclose(spoiled[key], clean[key], rtol=0.2)


def path_replay(p):
    return TwoPath(p, L2(), BATCH, freeze=False)


def of_mitsuba(p):
    return WholeImages(p, L2(), BATCH)


@pytest.mark.parametrize("make", [path_replay, of_mitsuba])
def test_a_sum_of_all_paths_survives_a_few_that_are_none(make):
    """Of one number: whatever lanes of a packet add up with it."""
    p = problem({ROUGHNESS: UnknownConfig(start=0.4)})
    clean, none = of(p, make)
    pixels = np.array(p.targets)
    pixels[3 * 40 : 3 * 40 + 3] = np.nan
    p.set_targets(mi.Float(pixels), p.mask, "spoiled")
    spoiled, lost = of(p, make)
    assert none == 0 and lost > 0
    assert np.isfinite(spoiled[ROUGHNESS]).all()
    np.testing.assert_allclose(spoiled[ROUGHNESS], clean[ROUGHNESS], rtol=0.2)


def test_a_bounded_loss_lets_no_infinite_path_of_a_pair_through():
    p, sent = problem({ROUGHNESS: UnknownConfig(start=0.4)}), []

    def look(integrator, scene, streams, rays, adjoints):
        first, *others = integrator.radiances(scene, streams, rays)
        lane = dr.arange(mi.UInt32, BATCH)
        first = dr.select(lane == BAD, mi.Spectrum(dr.inf), first)
        sent.extend(np.array(each) for each in adjoints([first, *others]))

    estimator = TwoPath(p, Bounded(), BATCH, False, look)
    p.unknowns.attach(p.unknowns.starts())
    estimator.accumulate(PixelDistribution.uniform(Tiles.over(p.views)), 3, 0)
    p.unknowns.write(p.unknowns.starts())
    assert estimator.nonfinite == 1
    assert all((each[:, BAD] == 0).all() and (each[:, :BAD] != 0).any() for each in sent)


def test_a_bounded_loss_lets_no_infinite_pixel_of_an_image_through():
    p = problem({ROUGHNESS: UnknownConfig(start=0.4)})
    estimator, (width, height) = WholeImages(p, Bounded(), BATCH), p.film_sizes[0]
    image = np.full((height, width, 3), 0.5, np.float32)
    image[0, BAD, 1] = np.inf
    sent = np.array(estimator._adjoint(0, mi.TensorXf(image))).reshape(-1, 3)
    assert estimator.nonfinite == 1
    assert (sent[BAD] == 0).all() and (sent[:BAD] != 0).all()


def test_a_bounded_loss_lets_no_infinite_path_beside_others_through():
    p = with_plastic({"type": "roughplastic", "alpha": 0.2}, {"alpha": 0.25})
    p = dataclasses.replace(p, integrator=Spoiled(p.integrator, dr.inf))
    aside = Aside(p, Bounded(), BATCH, False)
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    sent = np.array(aside._render(uniform, 3, 0, "primal")[1])
    assert not np.isfinite(sent[:, BAD]).any() and np.isfinite(np.delete(sent, BAD, axis=1)).all()


def test_a_bounded_loss_lets_no_infinite_rendering_through():
    pixel, ones, lost = dr.arange(mi.UInt32, 4), dr.ones(mi.Float, 4), [dr.opaque(mi.UInt32, 0)]
    bad = dr.select(pixel == 2, mi.Color3f(dr.inf), 0.3)
    sides, targets = ((bad, mi.Color3f(ones)), (mi.Color3f(ones),) * 2), dr.zeros(mi.Float, 12)
    sent = np.array(renderings._adjoint_kernel(Bounded())(targets, pixel, sides[0]))
    assert np.isfinite(sent).all(axis=0).tolist() == [True, True, False, True]
    kernel = renderings._loss_kernel(Bounded(), 4)
    terms = kernel(targets, None, (pixel, ones), sides, mi.Float(1), lost)
    assert int(lost[0][0]) == 1 and float(terms[2]) == 0
