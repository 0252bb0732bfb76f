"""Pairs of plain renderings at two places of parameter space, and what they differ by."""

from __future__ import annotations

from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np

from ..rendering import rays
from ..rendering.kernels import recorded
from ..rendering.pixels import PixelDistribution
from ..scene.problem import Problem
from ..unknowns.blur import Blur
from ..unknowns.smoothing import Pair
from .locality import Locality


class Renderings:
    """Drawn pixels and their radiance. Nothing is differentiated.

    N = ``batch`` pixels j_i ~ p, the same for all renderings of a difference: Σ_j over all pixels
    is 1/N Σ_i (…)_{j_i} / p_{j_i}, unbiased where p > 0 wherever the sum is not zero. A rendering
    is the mean of ``spp`` paths a pixel, of ``half`` in each of a residual's two. Where noise times
    noise outweighs the rest (beside the truth, where the residual has no mean, with narrow blurs),
    the variance falls with spp² N: for the same paths of a pair, spp N, fewer pixels with more
    paths each are better (benchmarks/plateau_variance.py).

    A launch traces one state of the scene, as Mitsuba holds one: two a pair, and in image space two
    more for the residual, however many objects move. The scene is updated between them, outside the
    frozen kernels.
    """

    def __init__(
        self,
        problem: Problem,
        loss,
        batch: int,
        blur: Blur,
        freeze: bool = True,
        spp: int = 1,
        half: int = 1,
    ):
        self.problem, self.blur = problem, blur
        wrap = partial(recorded, problem=problem, freeze=freeze)
        self._draw = wrap(draw_kernel(batch))
        self.spp, self.half = spp, half
        # Of another renderer, what one call traces is of one picture.
        kernel = _apart if problem.integrator.black_box else _trace_kernel
        self._trace = {
            (count, paths): wrap(kernel(problem.integrator, batch, count, paths))
            for count, paths in ((1, spp), (2, spp), (1, half))
        }
        self._adjoints = wrap(_adjoint_kernel(loss))
        self._images = wrap(_image_kernel(batch))
        self._losses = wrap(_loss_kernel(loss, batch))
        self._locality = Locality(problem, blur, batch, freeze)
        self._lost = [dr.opaque(mi.UInt32, 0)]

    @property
    def nonfinite(self) -> int:
        """Pixels so far, of all differences, that were left out as theirs was not finite. Waits."""
        return int(self._lost[0][0])

    def of_images(
        self,
        θ: np.ndarray,
        pairs: list[Pair],
        others: tuple[np.ndarray, np.ndarray],
        distribution: PixelDistribution,
        seeds: np.ndarray,
    ) -> list[np.ndarray]:
        """Estimates Σ_j ∂ℒ/∂I_j(M) · (P(θ + ``plus``) - P(θ + ``minus``))_j of every pair, for
        every entry of the unknowns, ``(D,)``: the same for all that have no reach (``Locality``).
        M is the mean of P at θ + each of the two ``others``, one for all pairs.

        ``seeds (3 + 2 pairs,)``: of pixels, of M's two renderings, and of those of each pair.
        Without bias for losses of linear derivative, if M's differ from the others. Waits.
        """
        p = self.problem
        drawn = self._drawn(distribution, seeds[0])
        middle = [
            self._traced(θ + other, drawn, seed, 1, self.half)[0]
            for other, seed in zip(others, seeds[1:3])
        ]
        adjoint = self._adjoints(p.targets, drawn[3], middle)
        found = []
        for pair, own in zip(pairs, np.reshape(seeds[3:], (-1, 2))):
            offsets = (pair.plus, pair.minus)
            images = [self._traced(θ + o, drawn, s, 1, self.spp)[0] for o, s in zip(offsets, own)]
            terms = self._images(adjoint, p.mask, drawn[3:], images, p.share, self._lost)
            found.append(self._locality.differences(θ, pair, drawn[:3], terms))
        return found

    def of_losses(
        self, θ: np.ndarray, pair: Pair, distribution: PixelDistribution, seeds: np.ndarray
    ) -> np.ndarray:
        """Estimates ℒ(P(θ + ``plus``)) - ℒ(P(θ + ``minus``)), each from two renderings
        (``loss.measured``): without bias where the loss is quadratic. ``(D,)``, as ``of_images``.

        ``seeds (3,)``: of pixels, and of the two sides. Waits.
        """
        p = self.problem
        drawn = self._drawn(distribution, seeds[0])
        offsets = (pair.plus, pair.minus)
        sides = [self._traced(θ + o, drawn, s, 2, self.spp) for o, s in zip(offsets, seeds[1:])]
        terms = self._losses(p.targets, p.mask, drawn[3:], sides, p.share, self._lost)
        return self._locality.differences(θ, pair, drawn[:3], terms)

    def _drawn(self, distribution: PixelDistribution, seed: int) -> tuple:
        return self._draw(self.problem.views, distribution, dr.opaque(mi.UInt32, int(seed)))

    def _traced(self, θ: np.ndarray, drawn: tuple, seed: int, count: int, spp: int) -> list:
        """``count`` independent renderings of the drawn pixels at ``θ``, ``(3, N)`` each."""
        p = self.problem
        self.blur.write(θ)
        seed = dr.opaque(mi.UInt32, int(seed))
        return self._trace[count, spp](*p.traced, drawn[:3], seed)


def draw_kernel(batch: int):
    def kernel(views, distribution, seed):
        view, column, row, probability = distribution.draw(batch, seed)
        pixel = views.index(view, column, row)
        dr.eval(view, column, row, pixel, probability)
        return view, column, row, pixel, probability

    return kernel


def _trace_kernel(integrator, batch: int, count: int, spp: int):
    """All first paths of the first rendering, pixel by pixel, then all second ones, and so on.
    (Paths of a pixel side by side, and a block sum of them, take twice the time.)"""
    paths = count * spp

    def kernel(scene, sensors, views, leaves, place, seed):
        with dr.suspend_grad():
            lane = dr.arange(mi.UInt32, batch)
            if paths > 1:
                drawn = dr.tile(lane, paths)
                place = [dr.gather(mi.UInt32, which, drawn) for which in place]
            stream = rays.stream(seed, batch * paths)
            radiance = rays.radiance(integrator, scene, sensors, views, place, stream)
            dr.eval(radiance)
            if paths == 1:
                return [radiance]
            means = []
            for first in range(0, paths, spp):
                found = [_part(radiance, lane + n * batch) for n in range(first, first + spp)]
                means.append(sum(found[1:], start=found[0]) / spp)
            dr.eval(means)
            return means

    return kernel


def _apart(integrator, batch: int, count: int, spp: int):
    """As ``_trace_kernel``, path after path in calls of its own."""

    def kernel(scene, sensors, views, leaves, place, seed):
        found = []
        for number in range(count * spp):
            # Within 32 bits, which Dr.Jit asks of a number beside such ones.
            stream = rays.stream(seed + (number * 0x9E3779B9 & 0xFFFFFFFF), batch)
            found.append(rays.radiance(integrator, scene, sensors, views, place, stream))
        parts = [found[first : first + spp] for first in range(0, len(found), spp)]
        means = [sum(part[1:], start=part[0]) / spp for part in parts]
        dr.eval(means)
        return means

    return kernel


def _part(radiance: mi.Color3f, lanes: mi.UInt32) -> mi.Color3f:
    return mi.Color3f(*[dr.gather(mi.Float, channel, lanes) for channel in radiance])


def _adjoint_kernel(loss):
    """∂ℒ/∂I at the mean of two renderings."""

    def kernel(targets, pixel, middle):
        mean = (middle[0] + middle[1]) / 2
        found = rays.sound(loss.derivative(mean, dr.gather(mi.Color3f, targets, pixel)), mean)
        dr.eval(found)
        return found

    return kernel


def _image_kernel(batch: int):
    def kernel(adjoint, mask, drawn, images, share, lost):
        pixel, probability = drawn
        plus, minus = images
        return _terms(adjoint * (plus - minus), pixel, probability, mask, share, batch, lost)

    return kernel


def _loss_kernel(loss, batch: int):
    def kernel(targets, mask, drawn, sides, share, lost):
        pixel, probability = drawn
        target = dr.gather(mi.Color3f, targets, pixel)
        plus, minus = (rays.sound(loss.measured(a, b, target), a + b) for a, b in sides)
        return _terms(plus - minus, pixel, probability, mask, share, batch, lost)

    return kernel


def _terms(
    values: mi.Color3f, pixel, probability, mask, share, batch: int, lost: list[mi.UInt32]
) -> mi.Float:
    """Of every drawn pixel: their sum estimates Σ_j w_j ``values``_j / (3 Σ w), without those that
    are not finite, one of which would spoil a whole step; they are counted in ``lost``. Evaluates.
    """
    terms = dr.sum(rays.masked(values, mask, pixel)) * share / (probability * batch)
    whole = dr.isfinite(terms)
    terms, bad = dr.select(whole, terms, 0), ~whole
    dr.eval(terms, bad)
    lost[0] += dr.count(bad)
    return terms
