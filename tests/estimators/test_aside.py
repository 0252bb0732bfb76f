"""Differences beside path replay, by numbers that Mitsuba does not differentiate rightly."""

import dataclasses
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from montecarlo import welch
from scenes_for_tests import without_targets

from isas_cli.config.schema import UnknownConfig
from isas_cli.engine import assemble
from isas_cli.estimators import aside
from isas_cli.estimators.two_path import TwoPath
from isas_cli.losses.l2 import L2
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.rendering.renderer import Renderer
from isas_cli.unknowns import routes

SEEDS, BATCH = 24, 1 << 14


def problem(material: dict, unknowns: dict[str, float | UnknownConfig]):
    place = mi.ScalarTransform4f()
    description = {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 4},
        "sensor": {
            "type": "perspective",
            "to_world": place.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16},
        },
        "sky": {"type": "constant"},
        "ball": {"type": "sphere", "bsdf": material},
    }
    p = without_targets(description, {f"ball.bsdf.{key}": at for key, at in unknowns.items()})
    p.set_targets(dr.full(mi.Float, 0.3, 3 * p.views.total), None, "test")
    return p


def expected(p, key: str, h: float) -> np.ndarray:
    """∂ℒ/∂θ from whole pictures, for each seed: of a residual, and of two sides with the same
    random numbers."""
    start, unknowns = p.unknowns[key].start, p.unknowns
    renderer, spp = Renderer(p), BATCH // p.views.total
    pixels = dr.repeat(dr.arange(mi.UInt32, p.views.total), spp)

    def pictures(value, first: int) -> np.ndarray:
        """Written once: tables of some materials are made anew with each number."""
        unknowns.write(unknowns.starts() | unknowns.values_of({key: value}))
        every = (renderer.pixels(pixels, 1, lambda _, s=s: first + s) for s in range(SEEDS))
        means = (np.array(each).reshape(3, p.views.total, spp).mean(axis=2) for each in every)
        return np.array(list(means))

    low, high = (pictures(start + side * h, 10_000) for side in (-1, 1))
    residual = pictures(start, 5_000_000) - 0.3
    sums = np.sum(2 * residual * (high - low) / (2 * h), axis=(1, 2), keepdims=True)
    return sums[:, 0] * p.share[0]


@pytest.mark.parametrize(
    "material, key, h",
    [
        ("roughplastic", "alpha", 0.02),
        ("roughplastic", "eta", 0.05),
        ("pplastic", "eta.value", 0.05),
    ],
)
def test_the_gradient_is_that_of_the_loss(material, key, h):
    values = {"alpha": 0.2, "eta": 1.4, "eta.value": 1.4}
    named = {"alpha": 0.2} if material == "roughplastic" else {}
    color = "diffuse_reflectance.value"
    p = problem({"type": material, **named}, {key: values[key], color: 0.4})
    key, color = (f"ball.bsdf.{each}" for each in (key, color))
    assert p.unknowns[key].kind.aside and not p.unknowns[color].kind.aside
    assert any(key in warning for warning in p.unknowns[key].kind.warnings())
    estimator = TwoPath(p, L2(), BATCH)
    assert estimator.paths_per_step == (2 + 1 + 2) * BATCH
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    found = [
        estimator.estimate(p.unknowns.starts(), uniform, seed, 3, 0.0) for seed in range(SEEDS)
    ]
    for each, step in ((key, h), (color, 0.02)):
        own = np.array([[float(np.ravel(gradients[each])[0])] for gradients in found])
        true = expected(p, each, step)
        told = welch(own, true)
        assert told.p_value > 1e-3, f"{each}: {told}"
        assert told.always_visible < 0.25 * abs(true.mean()), f"{each}: {told}, {true.mean()}"


def test_gradients_of_a_mask_and_of_its_complement_add_up():
    """To rounding, for the same random numbers."""
    p = problem({"type": "roughplastic", "alpha": 0.2}, {"alpha": 0.2})
    uniform, values = PixelDistribution.uniform(Tiles.over(p.views)), p.unknowns.starts()

    def found(mask: np.ndarray | None) -> float:
        """Times the sum of the weights."""
        p.set_targets(p.targets, None if mask is None else mi.Float(mask), "test")
        gradients = TwoPath(p, L2(), BATCH).estimate(values, uniform, 1, 3, 0.0)
        weight = p.views.total if mask is None else mask.sum()
        return float(np.ravel(gradients["ball.bsdf.alpha"])[0]) * weight

    mask = np.random.default_rng(2).random(p.views.total).astype(np.float32)
    whole, one, other = map(found, (None, mask, 1 - mask))
    p.unknowns.write(values)
    assert whole == pytest.approx(one + other, rel=2e-3)
    assert one != 0 != other


def test_what_rests_is_not_rendered_for():
    later = UnknownConfig(start=0.2, during=[0.5, 1])
    p = problem({"type": "roughplastic", "alpha": 0.2}, {"alpha": later, "eta": 1.4})
    uniform, estimator = PixelDistribution.uniform(Tiles.over(p.views)), TwoPath(p, L2(), 1024)
    assert estimator.stages == (0.0,)  # differences are taken from the start
    for spent, entries in ((0.0, 1), (0.5, 2)):
        found = estimator.estimate(p.unknowns.starts(), uniform, 1, 3, spent)
        assert estimator.paths_per_step == (2 + 1 + 2 * entries) * 1024
        moved = [float(np.ravel(found[f"ball.bsdf.{key}"])[0]) != 0 for key in ("alpha", "eta")]
        assert moved == [entries == 2, True]
    colour = "diffuse_reflectance.value"
    p = problem({"type": "roughplastic", "alpha": 0.2}, {"alpha": later, colour: 0.4})
    assert TwoPath(p, L2(), 1024).stages == (0.0, 0.5)


def test_what_can_be_told_by_no_one_is_refused():
    scene = mi.load_dict(
        {
            "type": "scene",
            "splats": {
                "type": "ellipsoids",
                "centers": mi.TensorXf(np.zeros((1, 3), np.float32)),
                "scales": mi.TensorXf(np.ones((1, 3), np.float32)),
                "quaternions": mi.TensorXf(np.float32([[0, 0, 0, 1]])),
            },
        }
    )
    params = mi.traverse(scene)
    assert "moves and turns" in routes.refusal(params, "splats.data")


def test_a_density_alike_everywhere_is_warned_of():
    @dataclasses.dataclass
    class Grid:
        hides, words = True, frozenset(("sigma_t",))

    class One:
        key, kind = "smoke.interior_medium.sigma_t.data", Grid()

    One.start = np.ones((2, 2, 2, 1), np.float32)
    assert "wrong" in assemble._flat_densities([One], object())[0]
    One.start = np.random.default_rng(0).random((2, 2, 2, 1))
    assert assemble._flat_densities([One], object()) == []
    One.start = np.where(np.arange(64) < 16, 2.0, 1e-3).reshape(4, 4, 4, 1)  # a mask
    assert "25% of its start is as dense" in assemble._flat_densities([One], object())[0]


def test_a_step_is_as_small_as_what_it_changes():
    """A density per millimetre; and one that starts at none."""
    thin = SimpleNamespace(low=0.0, high=np.inf, start=np.array([2e-4]))
    low, high = aside._sides(thin, 1e-4)
    assert (low, high) == pytest.approx((9.8e-5, 1.02e-4))
    none = SimpleNamespace(low=0.0, high=np.inf, start=np.array([0.0]))
    assert aside._sides(none, 0.0) == (0.0, 1e-3)
