"""Unrolled short paths against path replay, path by path, with Mitsuba's weights of samples."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scenes_for_tests import ROUGHNESS, TEXTURE, problem
from weights import as_mitsuba

from isas_cli.rendering import attached, rays
from isas_cli.rendering.integrators import Integrator, Replayed, Unrolled, adapt
from isas_cli.unknowns.parameters import flat

UNKNOWNS = {
    TEXTURE: 0.5,
    ROUGHNESS: 0.5,
    "lamp.emitter.radiance.value": 9.0,
    "sky.radiance.value": 0.2,
}


@pytest.fixture(autouse=True)
def weights_as_mitsubas(monkeypatch):
    as_mitsuba(monkeypatch)


def setting(p, seed: int):
    pixel = dr.tile(dr.arange(mi.UInt32, p.views.total), 4)
    stream = rays.stream(mi.UInt32(seed), dr.width(pixel))
    ray, _ = rays.spawn(p.sensors, p.views, *p.views.locate(pixel), stream)
    return ray, stream


def gradients(p, both_ways: bool) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of a weighted sum of radiances, and radiances."""
    integrator = p.integrator if both_ways else Integrator(p.integrator.mitsuba)
    starts = p.unknowns.starts()
    p.unknowns.attach(starts)
    with dr.suspend_grad():
        ray, stream = setting(p, 5)
        radiance, _ = p.integrator.primal(p.scene, stream.clone(), ray)
        weights = np.random.default_rng(1).normal(size=(3, dr.width(ray.o)))
        integrator.backward(p.scene, stream, ray, mi.Color3f(weights))
    found = [np.array(flat(g), np.float64) for g in p.unknowns.gradients().values()]
    p.unknowns.write(starts)
    return np.concatenate(found), np.array(radiance)


@pytest.mark.parametrize("depth", [1, 2, 7])
def test_gradients_agree_with_path_replay(depth):
    """Of long paths with roulette, which begins at the fifth vertex."""
    if depth == 1:
        p = problem({"sky.radiance.value": 0.2}, depth=1)
    else:
        p = problem(UNKNOWNS, depth=depth)
    unrolled, _ = gradients(p, True)
    replayed, _ = gradients(p, False)
    assert np.any(replayed != 0)
    assert np.allclose(unrolled, replayed, rtol=2e-4, atol=1e-5 * np.abs(replayed).max())


def test_radiance_agrees_with_path_replay():
    p = problem(UNKNOWNS, depth=4)
    with dr.suspend_grad():
        ray, stream = setting(p, 7)
        stock, _ = Integrator(p.integrator.mitsuba).primal(p.scene, stream.clone(), ray)
        own = attached.radiance(p.scene, stream, ray, 4, 5)
    assert np.allclose(np.array(own), np.array(stock), rtol=1e-4, atol=1e-6)


def test_forward_agrees_with_path_replay():
    p = problem(UNKNOWNS, depth=4)
    starts = p.unknowns.starts()
    results = []
    for both_ways in (True, False):
        integrator = p.integrator if both_ways else Integrator(p.integrator.mitsuba)
        p.unknowns.push_tangent(starts, {k: v * 0 + 1 for k, v in starts.items()})
        with dr.suspend_grad():
            ray, stream = setting(p, 9)
            results.append(np.array(integrator.forward(p.scene, stream, ray)))
        p.unknowns.write(starts)
    assert np.abs(results[1]).max() > 0.1
    assert np.allclose(*results, rtol=2e-4, atol=1e-5 * np.abs(results[1]).max())


def test_long_paths_are_replayed():
    assert attached.handles(8) and not any(attached.handles(depth) for depth in (9, 2**32 - 1))
    hidden = mi.load_dict({"type": "prb", "max_depth": 3, "hide_emitters": True})
    kinds = {3: Unrolled, 9: Replayed}
    for depth, kind in kinds.items():
        assert type(adapt(mi.load_dict({"type": "prb", "max_depth": depth}))) is kind
    assert type(adapt(hidden)) is Integrator and not adapt(hidden).cuts


def test_inner_product_of_forward_and_backward():
    """⟨J v, w⟩ = ⟨v, Jᵀ w⟩."""
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}, depth=4)
    starts, rng = p.unknowns.starts(), np.random.default_rng(2)
    tangents = {k: type(v)(v) * 0 + float(rng.normal()) for k, v in starts.items()}
    weights = mi.Color3f(rng.normal(size=(3, 4 * p.views.total)))
    p.unknowns.push_tangent(starts, tangents)
    with dr.suspend_grad():
        ray, stream = setting(p, 11)
        jv = np.array(p.integrator.forward(p.scene, stream, ray), np.float64)
    p.unknowns.attach(starts)
    with dr.suspend_grad():
        ray, stream = setting(p, 11)
        p.integrator.backward(p.scene, stream, ray, weights)
    jtw = {k: np.array(flat(g), np.float64) for k, g in p.unknowns.gradients().items()}
    p.unknowns.write(starts)
    left = (jv * np.array(weights, np.float64)).sum()
    right = sum((np.array(flat(tangents[k]), np.float64) * jtw[k]).sum() for k in jtw)
    assert left == pytest.approx(right, rel=1e-4)
