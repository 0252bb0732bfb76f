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

    def __init__(self, whole):
        self._whole = whole

    def __getattr__(self, name):
        return getattr(self._whole, name)

    def primal(self, scene, sampler, ray):
        radiance, *rest = self._whole.primal(scene, sampler, ray)
        lane = dr.arange(mi.UInt32, dr.width(radiance))
        return dr.select(lane == BAD, mi.Spectrum(dr.nan), radiance), *rest


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
