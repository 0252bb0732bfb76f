"""Gaussian smoothing of an objective over its parameters (PRDPT §3), and the offsets that estimate
the smoothed objective's gradient from plain values of the objective.

    F(θ) = (κ ⋆ f)(θ) = E[f(θ + τ)],  τ_k ~ N(0, σ_k²) independent

    ∂F/∂θ_k = E[τ_k / σ_k² f(θ + τ)]                                   (Eq. 9, as an expectation)

κ is even, so θ + τ and the paper's θ - τ are the same in distribution. All of f's plateaus that are
not wider than a few σ have a slope in F.

Everything here is on the host and knows nothing of rendering: f may be a pixel or a loss.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv, gammaln

# σ is kept at least so many times as large as the spacing of float32 numbers near θ: θ ± τ is
# rounded to these, and 1/σ would raise the rounding to the gradient's own size. 2^-9 of σ is left.
_ROUNDINGS = 256
_SPACING = float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class Pair:
    """Two places and a weight, all ``(D,) float64``: Σ ``weight * (f(θ + plus) - f(θ + minus))``
    over the pairs of one drawing, divided by their ``count``, estimates ∂F/∂θ."""

    plus: np.ndarray
    minus: np.ndarray
    weight: np.ndarray

    def spread(self, among: np.ndarray) -> "Pair":
        """Of more entries: these are ``among`` (bool) them, and the others stay where they are."""
        if among.all():
            return self
        whole = np.zeros((3, among.size))
        whole[:, among] = self.plus, self.minus, self.weight
        return Pair(*whole)


def joint(σ: np.ndarray, count: int, rng: np.random.Generator) -> list[Pair]:
    """``count`` pairs, each for all D unknowns at once: two values of f, whatever D is.

    With τ = σ ∘ r u, u uniform on the unit sphere of R^D and r > 0, the integrand's known factor
    |∇κ| is, in units of σ, proportional to r · r^(D-1) exp(-r²/2) dr du: r has the χ distribution
    of D + 1 degrees of freedom. Drawn so, by the inverse CDF, and with -τ beside τ (∇κ is odd, its
    sign goes into the difference: Owen and Zhou 2000),

        ∂F/∂θ_k = E[c_D u_k / σ_k (f(θ + τ) - f(θ - τ)) / 2],  c_D = √2 Γ((D+1)/2) / Γ(D/2).

    Unbiased for F for every D: the density of r under κ is χ_D, and r χ_D(r) = c_D χ_{D+1}(r).
    For D = 1 this is the paper's: r = √(-2 log ξ), u = ±1, c_1 / 2 = 1 / √(2π), the constant that
    its Algorithm 1 leaves out. The variance grows with D, as one number tells of D slopes.

    The radii of the pairs of one call are stratified; each pair by itself is distributed as said.
    """
    unknowns = σ.size
    directions = rng.standard_normal((count, unknowns))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    radii = _radii(unknowns, count, rng)
    constant = math.sqrt(2) * math.exp(gammaln((unknowns + 1) / 2) - gammaln(unknowns / 2))
    return [Pair(r * σ * u, -r * σ * u, constant / 2 * u / σ) for r, u in zip(radii, directions)]


def separate(σ: np.ndarray, count: int, rng: np.random.Generator) -> list[Pair]:
    """``count`` pairs for each of the D unknowns: 2 D values of f per count.

    For unknown k, τ_k is drawn from |∂κ/∂τ_k| and the others from κ, and the second of the pair
    has -τ_k and the same others:

        ∂F/∂θ_k = E[(f(θ + τ) - f(θ + τ - 2 τ_k e_k)) / (σ_k √(2π))].

    Unbiased for F. (Weighting every unknown by its own derivative kernel while all are drawn from
    |∂κ|, as the paper's public code does, is not: the blur of the others is not κ then.) The
    difference holds what unknown k does and little else, so it has less variance than ``joint``
    per pair, at D times its price.
    """
    pairs = []
    for k, weight in enumerate(np.diag(1 / (σ * math.sqrt(2 * math.pi)))):
        others = σ * rng.standard_normal((count, σ.size))
        for offset, r in zip(others, _radii(1, count, rng)):
            plus, minus = offset.copy(), offset.copy()
            plus[k], minus[k] = r * σ[k], -r * σ[k]
            pairs.append(Pair(plus, minus, weight))
    return pairs


def central(steps: np.ndarray) -> list[Pair]:
    """Central finite differences of f itself: θ ± h_k e_k for each unknown k.

    Not of F: where f is flat so is this, and its truncation error is O(h²) where f is smooth.
    """
    return [Pair(p, -p, weight) for p, weight in zip(np.diag(steps), np.diag(0.5 / steps))]


def blurred(σ: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """τ ~ κ, ``(D,)``: f(θ + τ) estimates F(θ)."""
    return σ * rng.standard_normal(σ.size)


def _radii(unknowns: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """χ-distributed radii of ``unknowns`` + 1 degrees of freedom by the inverse CDF, stratified.

    r²/2 has the Gamma distribution of shape (D+1)/2; for D = 1 its inverse CDF is -log(1 - ξ).
    """
    ξ = (rng.permutation(count) + rng.random(count)) / count
    return np.sqrt(2 * gammaincinv((unknowns + 1) / 2, ξ))


def width(start: float, end: float, hold: float, until: float, spent: float) -> float:
    """σ at the share ``spent`` of the budget, in [0, 1]: ``start`` up to ``hold``, then linearly to
    ``end`` at ``until`` (PRDPT A.1, where this is 1; its formula lacks the division by the number
    of steps)."""
    if spent <= hold:
        return start
    return start + (end - start) * min(1.0, (spent - hold) / (until - hold))


def stable(σ: np.ndarray, values: np.ndarray, scale: np.ndarray | float = 1.0) -> np.ndarray:
    """``σ`` raised to what single precision can resolve (all ``(D,)``, in the unknown's unit).

    θ ± τ is rounded to numbers 2^-23 |θ| apart, and so is what it is added to in the scene, whose
    size is ``scale``: 1 for a reflectance, the coordinates of what is moved, a radian's degrees, a
    lamp's own.
    """
    return np.maximum(σ, _ROUNDINGS * _SPACING * np.maximum(scale, np.abs(values)))
