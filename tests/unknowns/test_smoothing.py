"""Offsets for smoothed gradients against closed forms: linear, quadratic, step, products."""

from __future__ import annotations

import math
import zlib

import numpy as np
import pytest
from scipy import stats

from isas_cli.unknowns import smoothing

SIGMAS = (1e-4, 20.0)  # another is among those of the products
LIMIT = stats.norm.isf(1e-4 / 2)  # per comparison; there are about a hundred


def estimates(name: str, f, θ, σ, pairs: int, calls: int = 4000) -> np.ndarray:
    """``calls`` independent estimates of ∂F/∂θ, (calls, D)."""
    rng = np.random.default_rng(zlib.crc32(f"{name} {θ} {σ} {pairs}".encode()))
    draw = getattr(smoothing, name)
    θ, σ = np.asarray(θ, float), np.asarray(σ, float)
    found = np.empty((calls, σ.size))
    for i in range(calls):
        drawn = draw(σ, pairs, rng)
        total = sum(pair.weight * (f(θ + pair.plus) - f(θ + pair.minus)) for pair in drawn)
        found[i] = total / pairs
    return found


def z(found: np.ndarray, expected) -> np.ndarray:
    error = found.std(axis=0, ddof=1) / math.sqrt(len(found))
    scale = np.maximum(np.abs(expected), 1e-300)
    exact = np.abs(found - expected).max(axis=0) < 1e-9 * scale  # no variance at all
    print("mean", found.mean(axis=0), "expected", expected, "standard error", error)
    return np.where(exact, 0, (found.mean(axis=0) - expected) / np.maximum(error, 1e-300))


def normal(x: float) -> float:
    return math.exp(-x * x / 2) / math.sqrt(2 * math.pi)


@pytest.mark.parametrize("pairs", (1, 3))
@pytest.mark.parametrize("σ", SIGMAS)
@pytest.mark.parametrize("name", ("joint", "separate"))
def test_one_unknown(name, σ, pairs):
    """∂/∂θ of E[f(θ + τ)]: of 3 θ it is 3, of θ² 2 θ, of a step at 0 κ(θ)."""
    for θ in (0.0, 0.7 * σ):
        assert abs(z(estimates(name, lambda t: 3 * t[0], [θ], [σ], pairs), 3.0)) < LIMIT
        if θ:
            assert abs(z(estimates(name, lambda t: t[0] ** 2, [θ], [σ], pairs), 2 * θ)) < LIMIT
        found = estimates(name, lambda t: float(t[0] > 0), [θ], [σ], pairs)
        assert abs(z(found, normal(θ / σ) / σ)) < LIMIT


@pytest.mark.parametrize("name", ("joint", "separate"))
def test_a_plateau_has_a_slope(name):
    """A step three σ away: flat here, and unbiased all the same."""
    found = estimates(name, lambda t: float(t[0] > 0), [-3.0], [1.0], 1, calls=20_000)
    assert abs(z(found, normal(3))) < LIMIT
    assert found.mean() > 0


@pytest.mark.parametrize("σ", ([1e-4, 2e-4], [0.3, 5.0]))
@pytest.mark.parametrize("name", ("joint", "separate"))
def test_two_unknowns(name, σ):
    """Of a product a b the slopes are b and a; of two steps' product κ(a) Φ(b) and κ(b) Φ(a)."""
    θ = [0.5 * σ[0], -0.4 * σ[1]]
    found = estimates(name, lambda t: t[0] * t[1], θ, σ, 1)
    assert np.all(np.abs(z(found, np.array([θ[1], θ[0]]))) < LIMIT)
    found = estimates(name, lambda t: float(t[0] > 0 and t[1] > 0), θ, σ, 1)
    a, b = θ[0] / σ[0], θ[1] / σ[1]
    expected = [normal(a) / σ[0] * stats.norm.cdf(b), normal(b) / σ[1] * stats.norm.cdf(a)]
    assert np.all(np.abs(z(found, np.array(expected))) < LIMIT)


def quartic(t) -> float:
    """Its smoothed slope depends on the blur of all unknowns: 2 θ_k (Σ_i≠k (θ_i² + σ_i²))."""
    return float(np.sum(t**2) ** 2 - np.sum(t**4)) / 2


@pytest.mark.parametrize("name", ("joint", "separate"))
def test_the_blur_of_the_others_is_gaussian(name):
    θ, σ = np.array([0.5, -0.4, 0.3, 0.8, 0.1]), np.array([0.5, 1.0, 0.8, 0.3, 1.5])
    found = estimates(name, quartic, θ, σ, 1, calls=20_000)
    second = θ**2 + σ**2
    expected = 2 * θ * (second.sum() - second)
    assert np.all(np.abs(z(found, expected)) < LIMIT)


def test_a_scheme_that_draws_all_unknowns_from_their_derivative_kernels_is_noticed():
    """The public code's: the others' second moments are 2 σ², not σ²."""
    θ, σ = np.array([0.5, -0.4, 0.3]), np.array([0.5, 1.0, 0.8])
    rng = np.random.default_rng(1)
    found = np.empty((20_000, 3))
    for row in found:
        τ = σ * np.sqrt(-2 * np.log(1 - rng.random(3))) * rng.choice([-1, 1], 3)
        row[:] = np.sign(τ) / (σ * math.sqrt(2 * math.pi)) * (quartic(θ + τ) - quartic(θ - τ))
    second = θ**2 + σ**2
    assert np.any(np.abs(z(found, 2 * θ * (second.sum() - second))) > LIMIT)


def test_a_missing_constant_is_noticed():
    """The paper's Algorithm 1 as it is printed: half the difference, whatever σ is."""
    printed = 0.5 * 0.5 * math.sqrt(2 * math.pi)  # over our weight 1 / (σ √(2π)), σ = 0.5
    found = estimates("joint", lambda t: float(t[0] > 0), [0.2], [0.5], 1) * printed
    assert abs(z(found, normal(0.4) / 0.5)) > LIMIT


def test_offsets_of_one_unknown_have_the_density_of_the_derivative_kernel():
    """|τ| / (2 σ²) exp(-τ² / 2σ²): Rayleigh radii, from -√(2 σ² log ξ)."""
    rng = np.random.default_rng(5)
    for name in ("joint", "separate"):
        draw = getattr(smoothing, name)
        drawn = [pair for _ in range(2000) for pair in draw(np.array([0.25]), 2, rng)]
        radii = np.abs([pair.plus[0] for pair in drawn])
        assert stats.kstest(radii, stats.rayleigh(scale=0.25).cdf).pvalue > 1e-3
        assert all(pair.plus == -pair.minus for pair in drawn)
    assert abs(np.mean(np.sign([p.plus[0] for p in smoothing.joint(np.ones(1), 4000, rng)]))) < 0.06


def test_more_pairs_lower_the_variance_at_least_by_their_number():
    """Stratified radii may only help; 20 % for the estimate's own error."""
    one, eight = (
        estimates("joint", lambda t: float(t[0] > 0.4), [0.1], [0.5], pairs).var()
        for pairs in (1, 8)
    )
    assert eight < 1.2 * one / 8


def test_antithetic_pairs_beat_single_draws_of_the_kernel():
    """Eq. 9 with τ ~ κ and no pairs, at equal numbers of values of f: far from the step, where
    single draws carry the step's height into every estimate."""
    σ, θ = 0.5, 1.0
    rng = np.random.default_rng(3)
    τ = σ * rng.standard_normal((4000, 2))
    single = (τ / σ**2 * (θ + τ > 0)).mean(axis=1)
    pairs = estimates("joint", lambda t: float(t[0] > 0), [θ], [σ], 1)
    assert abs(z(single[:, None], normal(θ / σ) / σ)) < LIMIT
    assert pairs.var() < 0.5 * single.var()


def test_separate_pairs_have_less_variance_than_joint_ones():
    """What they cost D times as much for."""
    θ, σ = np.full(8, 0.1), np.full(8, 0.5)

    def f(t):
        return float(np.sum(t > 0))

    assert estimates("separate", f, θ, σ, 1).var() < estimates("joint", f, θ, σ, 1).var()


def test_central_differences():
    steps = np.array([1e-3, 1e-2])
    found = sum(
        pair.weight
        * (np.prod(np.array([2.0, 3.0]) + pair.plus) - np.prod(np.array([2.0, 3.0]) + pair.minus))
        for pair in smoothing.central(steps)
    )
    assert np.allclose(found, [3.0, 2.0])


def test_the_blurred_value_is_the_smoothed_one():
    rng = np.random.default_rng(2)
    σ = np.array([0.5, 2.0])
    values = [np.sum((1 + smoothing.blurred(σ, rng)) ** 2) for _ in range(4000)]
    assert abs(z(np.array(values)[:, None], 2 + np.sum(σ**2))) < LIMIT


def sloped(slope, θ, σ) -> np.ndarray:
    """Estimates of ∂F/∂θ by Eq. 8: the integrand's own slope at θ + τ."""
    rng = np.random.default_rng(zlib.crc32(f"{θ} {σ}".encode()))
    return np.array([slope(θ + smoothing.blurred(σ, rng)) for _ in range(4000)])


@pytest.mark.parametrize("σ", ([1e-4, 2e-4], [0.3, 5.0]))
def test_the_slope_blurred(σ):
    """Eq. 8 where there is a slope: of 3 a + b it is (3, 1), of a² + b² 2 θ, of a b² (its slope by
    a depends on b's blur)."""
    σ = np.array(σ)
    θ = np.array([0.5, -0.4]) * σ
    assert np.all(z(sloped(lambda t: np.array([3.0, 1.0]), θ, σ), [3, 1]) == 0)
    assert np.all(np.abs(z(sloped(lambda t: 2 * t, θ, σ), 2 * θ)) < LIMIT)
    found = sloped(lambda t: np.array([t[1] ** 2, 2 * t[0] * t[1]]), θ, σ)
    expected = np.array([θ[1] ** 2 + σ[1] ** 2, 2 * θ[0] * θ[1]])
    assert np.all(np.abs(z(found, expected)) < LIMIT)


def test_the_slope_blurred_does_not_see_a_step():
    """What silhouettes' derivatives are for: the step's own slope is 0 wherever it is taken, that
    of what is smoothed is not, and pairs of values see it."""
    found = estimates("joint", lambda t: float(t[0] > 0), [0.0], [1.0], 1)
    assert abs(z(found, normal(0))) < LIMIT


def test_image_space_by_independent_offsets():
    """dℒ(Q)/dθ for ℒ = Q², Q the step's blur: 2 Q Q'. With the same offset for both factors it is
    the blurred loss's, ℒ(step) = step, which is Q' alone."""
    θ, σ = 0.4, 0.5
    rng = np.random.default_rng(8)

    def step(t) -> float:
        return float(t[0] > 0)

    found = []
    for _ in range(8000):
        (pair,) = smoothing.joint(np.array([σ]), 1, rng)
        other = step(θ + smoothing.blurred(np.array([σ]), rng))
        found.append(2 * other * pair.weight * (step(θ + pair.plus) - step(θ + pair.minus)))
    q, slope = stats.norm.cdf(θ / σ), normal(θ / σ) / σ
    assert abs(z(np.array(found), 2 * q * slope)) < LIMIT
    assert abs(z(np.array(found), slope)) > LIMIT


@pytest.mark.parametrize(
    "until, progress, expected",
    [(1.0, 0, 3.0), (1.0, 0.25, 3.0), (1.0, 0.625, 1.6), (1.0, 1.0, 0.2), (1.0, 1.5, 0.2)]
    + [(0.5, 0.25, 3.0), (0.5, 0.375, 1.6), (0.5, 0.5, 0.2), (0.5, 0.7, 0.2)],
)
def test_the_width_holds_then_falls_linearly(until, progress, expected):
    assert smoothing.width(3.0, 0.2, 0.25, until, progress) == pytest.approx(expected)


def test_the_width_does_not_fall_below_what_the_scene_resolves():
    """A turn by σ moves a vertex a unit away by many of its roundings."""
    (σ,) = smoothing.stable(np.array([1e-9]), np.array([0.0]), math.degrees(1))
    moved = np.float32(1) + np.float32(math.radians(σ))
    assert abs((moved - np.float32(1)) / math.radians(σ) - 1) < 1 / 128


def test_the_width_does_not_fall_below_what_single_precision_resolves():
    σ = smoothing.stable(np.array([1e-9, 1e-9, 1e-4]), np.array([0.1, -500.0, 1.0]))
    assert σ[2] == 1e-4  # in the range that is tested
    for value, width in zip((0.1, 500.0), σ):
        θ = np.float32(value)
        moved = np.float32(θ + np.float32(width)) - np.float32(θ - np.float32(width))
        assert abs(moved / (2 * width) - 1) < 1 / 128
