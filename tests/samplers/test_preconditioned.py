"""The preconditioned sampler: its weights, its moment against brute force, its fixed points."""

from dataclasses import fields

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from brute_force import PerPath, cell_means
from montecarlo import z_against
from scenes_for_tests import ROUGHNESS, STAGE1, TEXTURE, UNKNOWNS, problem

from isas_cli import losses
from isas_cli.runtime.errors import InputError
from isas_cli.samplers.ours import Ours
from isas_cli.samplers.preconditioned import Preconditioned, root_weights
from isas_cli.samplers.sampler import Moments, Stage1Settings
from isas_cli.samplers.stage1.cell_moments import Stage1, random_signs
from isas_cli.samplers.stage1.cells import Cells
from isas_cli.unknowns.parameters import flat


def second(p, rng, decades: float = 2.0) -> dict:
    """A v̂ for each entry, spread over powers of ten, in units that differ from key to key."""
    found = {}
    for number, (key, value) in enumerate(p.unknowns.starts().items()):
        exponents = rng.uniform(-decades, decades, dr.width(flat(value)))
        found[key] = mi.Float((10 ** (exponents - 5 * number - 8)).astype(np.float32))
    return found


def moments_of(second: dict) -> Moments:
    """With nothing else in them: nothing else may be read."""
    return Moments(**{f.name: None for f in fields(Moments)} | {"second": second})


def weights_of(second: dict, least: float) -> np.ndarray:
    return np.concatenate(
        [np.array(r, np.float64) ** 2 for r in root_weights(second, least).values()]
    )


def test_weights_are_the_inverse_of_the_second_moment(rng):
    a = (10.0 ** rng.uniform(-12, -8, 7)).astype(np.float32)
    b = (10.0 ** rng.uniform(-20, -18, 5)).astype(np.float32)
    a[2] = 0
    got = weights_of({"a": mi.Float(a), "b": mi.Float(b)}, 0.01)
    mean_a, mean_b = a[a > 0].mean(dtype=float), b.mean(dtype=float)
    held = np.concatenate([np.where(a > 0, a, mean_a) + 0.01 * mean_a, b + 0.01 * mean_b])
    assert np.allclose(got * held, (got * held)[0], rtol=1e-4)


def test_untouched_entries_count_as_the_mean_of_the_touched():
    got = weights_of({"a": mi.Float([1.0, 3.0, 0.0, 2.0]), "b": mi.Float([0.0, 0.0])}, 1e-3)
    assert got[2] == pytest.approx(got[3]), "untouched beside touched"
    assert got[4:] == pytest.approx(got[3]), "a key that nothing has touched"
    nothing = weights_of({"a": mi.Float([0.0, 0.0]), "b": mi.Float([0.0])}, 1e-3)
    assert np.all(nothing == 1)


def test_units_do_not_matter(rng):
    v = (10.0 ** rng.uniform(-2, 2, 50)).astype(np.float32)
    plain = weights_of({"a": mi.Float(v)}, 1e-3)
    for scale in (1e-24, 1e12):
        assert np.allclose(weights_of({"a": mi.Float(v * np.float32(scale))}, 1e-3), plain, 1e-4)


@pytest.mark.parametrize("least", [0.0, -1.0, float("inf"), float("nan")])
def test_least_must_be_a_positive_number(least):
    with pytest.raises(InputError, match="sampler.least="):
        Preconditioned(least=least)


def test_looks_come_early():
    found = [i for i in range(60) if Preconditioned().due(i)]
    assert found == [0, 1, 2, 4, 8, 16, 32, 50]
    assert [i for i in range(5) if Preconditioned(refresh=1).due(i)] == [0, 1, 2, 3, 4]
    with pytest.raises(InputError, match="sampler.refresh=0"):
        Preconditioned(refresh=0)


def test_weighted_moment_matches_brute_force(rng):
    """E_ε over many probes of (Σ_k ε_k √w_k ∂I_j/∂θ_k)² is Σ_k w_k (∂I_j/∂θ_k)² on the very same
    paths, for unknowns whose weights differ by powers of ten."""
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}, size=2)
    cells, samples, probes = Cells.over(p.film_sizes, 4), 8, 256
    derivative = PerPath(p, losses.L2(), cells, samples).derivatives(1, 0)
    squares = cell_means(derivative**2, samples)
    v = second(p, rng, 1.0)
    *texels, roughness = squares.sum(axis=(1, 2))
    share = np.sum(texels / np.array(v[TEXTURE], np.float64))
    v[ROUGHNESS] = mi.Float(roughness / share)  # so that both keys count alike
    roots, w = root_weights(v, 1e-3), weights_of(v, 1e-3)
    exact = np.einsum("k,kcj->cj", w, squares)
    stage1 = Stage1(p, losses.L2(), cells, samples)
    starts = p.unknowns.starts()
    rows = []
    for probe in range(probes):
        _, found = stage1.derivative(starts, random_signs(starts, 77 + probe, roots), 1, 0)
        rows.append(np.array(found, np.float64).reshape(-1))
    p.unknowns.write(starts)
    rows = np.array(rows)
    error = rows.std(axis=0).sum() / np.sqrt(probes) / exact.sum()
    print(f"relative error {rows.mean(axis=0).sum() / exact.sum() - 1:.3g}, at most {error:.3g}")
    seen = rows.std(axis=0) > 1e-3 * rows.mean(axis=0).max()
    assert z_against(rows[:, seen], exact.reshape(-1)[seen]) > 1e-4
    assert np.corrcoef(rows.mean(axis=0), exact.reshape(-1))[0, 1] > 0.999
    plain = squares.sum(axis=0).reshape(-1)
    assert z_against(rows[:, seen], (plain * exact.sum() / plain.sum())[seen]) < 1e-6, "no power"


def test_a_look_is_the_root_of_the_product(rng):
    p = problem(UNKNOWNS)
    sampler = Preconditioned(stage1=Stage1Settings(resolution=4, spp=4, probes=2, denoise="none"))
    sampler = sampler.on(p, losses.L2(), 512)
    starts, v = p.unknowns.starts(), second(p, rng)
    weights = np.array(sampler.look(starts, 3, 7, moments_of(v)))
    stage1 = Stage1(p, losses.L2(), sampler.cells, 4)
    _, first = stage1.residual(starts, 3, 7)
    moment = stage1.second_moment(starts, 2, 3, 7, root_weights(v, sampler.settings.least))
    p.unknowns.write(starts)
    exact = np.sqrt((np.array(first) * np.array(moment)).sum(axis=0))
    assert np.allclose(weights, exact, rtol=1e-3, atol=1e-6 * exact.max())


def test_without_moments_it_is_eq_12():
    p = problem(UNKNOWNS)
    starts, found = p.unknowns.starts(), []
    for kind in (Ours, Preconditioned):
        sampler = kind(stage1=STAGE1).on(p, losses.L2(), 512)
        found.append(np.array(sampler.look(starts, 3, 7)))
    p.unknowns.write(starts)
    assert np.allclose(*found, rtol=1e-5)


def rounds(A: np.ndarray, count: int = 60) -> list[np.ndarray]:
    """p after each look, A_jk exact, v̂_k = Σ_j A_jk / p_j exact: what Adam would have measured."""
    p = [np.full(len(A), 1 / len(A))]
    for _ in range(count):
        v = (A / p[-1][:, None]).sum(axis=0)
        w = weights_of({"a": mi.Float(v.astype(np.float32))}, 1e-9)
        root = np.sqrt(A @ w)
        p.append(root / root.sum())
    return p


def test_fixed_point_of_one_unknown_is_least_variance(rng):
    A = rng.exponential(1, (40, 1))
    for p in rounds(A, 3)[1:]:
        assert np.allclose(p, np.sqrt(A[:, 0]) / np.sqrt(A[:, 0]).sum(), rtol=1e-5)


def test_fixed_point_of_a_texture_is_equal_mass_per_texel(rng):
    """Texels that 1, 4, 16 and 64 pixels see, of any brightness, error and noise."""
    texel = np.repeat(np.arange(4), [1, 4, 16, 64])
    A = np.zeros((len(texel), 4))
    A[np.arange(len(texel)), texel] = (10.0 ** rng.uniform(-3, 3, 4))[texel]
    p = rounds(A)[-1]
    assert np.allclose(p, 0.25 / np.bincount(texel)[texel], rtol=1e-4)
    A *= rng.exponential(1, len(texel))[:, None]
    p = rounds(A)[-1]
    assert np.allclose(np.bincount(texel, p), 0.25, rtol=1e-4)
    assert np.allclose(p[texel == 3] ** 2 / A[texel == 3, 3], p[-1] ** 2 / A[-1, 3], rtol=1e-3)


def test_each_round_raises_the_sum_of_log_progress(rng):
    """Pixels that see several unknowns each; and nothing nearby is better than the fixed point."""
    A = rng.exponential(1, (60, 12)) * (rng.random((60, 12)) < 0.2) * 10.0 ** rng.uniform(-2, 2, 12)
    A += 1e-9

    def progress(p):
        return -0.5 * np.log((A / p[:, None]).sum(axis=0)).sum()

    found = rounds(A)
    gains = np.diff([progress(p) for p in found])
    assert np.all(gains > -1e-5) and gains[0] > 0.1
    for _ in range(50):
        nearby = found[-1] * np.exp(0.1 * rng.standard_normal(60))
        assert progress(nearby / nearby.sum()) < progress(found[-1])
    shares = A / found[-1][:, None]
    mass = (shares / shares.sum(axis=0)).mean(axis=1)
    assert np.allclose(mass, found[-1], rtol=0.01, atol=1e-4), "one K-th for each unknown"


def test_fixed_point_of_a_rendered_texture():
    """Looks in turn with v̂ as Adam would have it end near the fixed point of brute-force A_jk,
    where texels have equal mass, which Eq. (12) is far from."""
    p, loss = problem({TEXTURE: 0.5}, size=4, resolution=(48, 32), depth=2, floor=4.0), losses.L2()
    settings = Stage1Settings(resolution=48, spp=8, probes=8, denoise="none")
    sampler = Preconditioned(least=1e-4, stage1=settings)
    sampler = sampler.on(p, loss, 512)
    starts, spp = p.unknowns.starts(), 32
    paths = PerPath(p, loss, sampler.cells, spp)
    derivative = cell_means(paths.derivatives(9, 0) ** 2, spp)
    residual = cell_means(paths.residuals(9, 0) ** 2, spp)
    A = np.einsum("cj,kcj->jk", residual, derivative)
    wanted = rounds(A + 1e-6 * A.max(axis=0))[-1]
    moments, apart, spread = None, [], []
    for look in range(8):
        weights = np.array(sampler.look(starts, 1, look, moments), np.float64)
        q = 0.99 * weights / weights.sum() + 0.01 / weights.size
        v = (A / q[:, None]).sum(axis=0)
        shares = A / v
        mass = q @ (shares / shares.sum(axis=1, keepdims=True).clip(1e-30))
        apart.append(np.abs(q - wanted).sum() / 2)
        spread.append(mass.std() / mass.mean())
        moments = moments_of({TEXTURE: mi.Float(v.astype(np.float32))})
    p.unknowns.write(starts)
    print(f"total variation {np.round(apart, 3)}, relative spread of mass {np.round(spread, 3)}")
    assert apart[0] > 0.3, "the case is not hard enough to show anything"
    assert max(apart[-2:]) < 0.15
    assert max(spread[-2:]) < 0.2 and spread[0] > 0.8
