"""What each pixel contributes to the variance of the gradient, by brute force."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from ...rendering import rays
from ...rendering.kernels import recorded
from ...rendering.pixels import PixelDistribution, Tiles
from ...runtime import streams
from ...samplers.stage1.cell_moments import random_signs
from ...scene.problem import Problem

_LANES = 1 << 20
# Tangents at least: of many unknowns, one tangent tells little, however many paths follow it.
_TANGENTS = 64
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_TWICE = np.array([1, 1, 1, 2, 2, 2])  # pairs off the diagonal stand for two entries


class Moments:
    """A_j = E‖Σ_c ⟨∂ℒ/∂I⟩_jc ⟨dI_jc/dθ⟩‖² of every pixel j, from two independent halves of paths.

    That is the second moment of what one draw of pixel j contributes to the two-path estimate that
    goes one way (``Paths.crossed``), before it is divided by p_j. Residual r and derivative J come
    from independent paths, so

        A_j = Σ_cc' E[r_c r_c'] E[Σ_k J_ck J_c'k],

    and both matrices are averaged over ``paths`` paths each before they are multiplied: each path
    of one kind meets all of the other, which is much less noisy than ``paths`` products, whose
    tails are long. With a tangent ε of random signs E_ε[(J_c ε)(J_c' ε)] = Σ_k J_ck J_c'k; every
    pass has new signs.

    Of films of more than 2^20 pixels in all, tiles of several pixels are measured, as distributions
    have them (``Tiles``): A is then the product of both factors' means over a tile's pixels, too
    small where large residuals and large derivatives share pixels.

    ``halves (2, T) float64``: by slot, in the unit of (∂ℒ/∂θ)², noise may make it negative;
    ``paths``: paths per tile of each kind, both halves together.
    """

    def __init__(self, problem: Problem, tiles: Tiles, halves: np.ndarray, paths: int):
        self.problem, self.tiles, self.halves, self.paths = problem, tiles, halves, paths
        slot = dr.arange(mi.UInt32, tiles.count)
        view, column, row, width, height = tiles.corner(slot)
        self._middle = view, column + width // 2, row + height // 2
        dr.eval(self._middle)
        self.pixels = np.array(width * height, np.float64)

    @property
    def mean(self) -> np.ndarray:
        return self.halves.mean(axis=0)

    def sum_over(self, probability: np.ndarray, contributions: np.ndarray) -> float:
        """Σ_j A_j / p_j over all pixels, both by slot. Pixels that contribute nothing need no p."""
        reached = np.zeros_like(contributions)
        with np.errstate(divide="ignore"):
            np.divide(contributions, probability, out=reached, where=contributions != 0)
        return float(np.sum(self.pixels * reached))

    def probability(self, distribution: PixelDistribution) -> np.ndarray:
        """p_j of every tile's middle pixel, ``(T,) float64``."""
        return np.array(distribution.probability(*self._middle), np.float64)

    def second_moment(self, distribution: PixelDistribution) -> float:
        """E‖g‖² of an estimate from a single draw: Σ_j A_j / p_j (ISAS Eq. 7, 11).

        N independent draws have the variance (this - ‖∇‖²)/N. Stratified ones, as estimates here
        use, have less: how far a stratum's pixels differ in their mean does not count.
        """
        return self.sum_over(self.probability(distribution), self.mean)


def measure(
    problem: Problem,
    loss,
    values: dict,
    paths: int,
    seed: int,
    freeze: bool = True,
    done: Callable[[int, int], None] = lambda paths, total: None,
) -> Moments:
    """``Moments`` at ``values`` from ``paths`` (at least 2) paths of each kind per tile.

    ``done(paths, total)`` is called after every pass. Evaluates.
    """
    tiles = Tiles.over(problem.views)
    half = max(1, paths // 2)
    copies = max(1, min(_LANES // tiles.count, half // _TANGENTS))
    passes = -(-half // copies)
    kernel = recorded(_kernel(problem, loss, copies), problem, freeze)
    halves = []
    for which in (0, 1):
        sums = [dr.zeros(mi.Float, tiles.count) for _ in range(2 * len(_PAIRS))]
        dr.make_opaque(sums)
        for number in range(which * passes, (which + 1) * passes):
            seeds = [streams.seed(seed, 4 * number + i, "variance") for i in range(4)]
            problem.unknowns.push_tangent(values, random_signs(values, seeds[3]))
            opaque = [dr.opaque(mi.UInt32, drawn) for drawn in seeds[:3]]
            given = tiles, problem.targets, problem.mask, opaque, sums
            sums = kernel(*problem.traced, *given)
            dr.sync_thread()
            done((number + 1) * copies, 2 * passes * copies)
        products = np.array([np.array(s, np.float64) for s in sums]) / (passes * copies)
        residual, derivative = products.reshape(2, len(_PAIRS), -1)
        halves.append(np.einsum("i,it,it->t", _TWICE, residual, derivative))
    problem.unknowns.write(values)
    share = float(problem.share[0])
    return Moments(problem, tiles, np.array(halves) * share**2, 2 * passes * copies)


def _kernel(problem: Problem, loss, copies: int):
    """Adds the products of ``copies`` paths per tile to the sums: residuals', derivatives'."""
    integrator = problem.integrator

    def kernel(scene, sensors, views, leaves, tiles, targets, mask, seeds, sums):
        with dr.suspend_grad():
            count = tiles.count * copies
            view, column, row, width, height = tiles.corner(dr.arange(mi.UInt32, count) // copies)
            rng = mi.PCG32(size=count, initstate=mi.UInt64(seeds[0]))
            column += dr.minimum(mi.UInt32(rng.next_float32() * mi.Float(width)), width - 1)
            row += dr.minimum(mi.UInt32(rng.next_float32() * mi.Float(height)), height - 1)
            pixel = views.index(view, column, row)
            dr.eval(view, column, row, pixel)

            first = rays.stream(seeds[1], count)
            place = view, column, row
            radiance = rays.radiance(integrator, scene, sensors, views, place, first)
            residual = loss.derivative(radiance, dr.gather(mi.Color3f, targets, pixel))
            residual = rays.masked(residual, mask, pixel)

            second = rays.stream(seeds[2], count)
            ray, weight = rays.spawn(sensors, views, *place, second)
            derivative = integrator.forward(scene, second, ray) * weight
            dr.eval(residual, derivative)
            found = []
            for factor in (residual, derivative):
                finite = dr.all(dr.isfinite(factor))
                for a, b in _PAIRS:
                    product = dr.select(finite, factor[a] * factor[b], 0)
                    found.append(dr.block_reduce(dr.ReduceOp.Add, product, copies))
            found = [total + more for total, more in zip(sums, found)]
            dr.eval(found)
            return found

    return kernel
