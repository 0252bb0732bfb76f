"""Measuring where a run stands, with pixels, seeds and samples of its own."""

from __future__ import annotations

import math
from functools import cached_property

import drjit as dr
import mitsuba as mi
import numpy as np

from ..records import KEY_PREFIX, VALUE_PREFIX
from ..rendering import contours, rays
from ..rendering.renderer import Renderer
from ..runtime import streams
from ..runtime.errors import InputError
from ..scene.problem import Problem
from . import floor
from .floor import Floor

# How far the outline is from alpha or masks, where shapes or poses are unknown.
OUTLINE = f"{VALUE_PREFIX}outlines/apart"
_TOGETHER = 64


class Evaluator:
    """Loss, image error and parameter error at given values; never billed.

    Renders a fixed stratified set of ``pixels`` (all of them where there are fewer, else drawn by
    what they count) with ``spp`` paths each, in two independent halves A and B, with the same seeds
    every time.

    ``image_rmse`` is √mean_j,c (A - A*)(B - B*). Where the truth is known, A* and B* are the
    truth rendered with the very same random numbers: the expectation of the product is the
    squared difference of the *mean* images, its noise vanishes as the images agree, and neither
    the evaluation's noise nor the targets' passes for error. For photographs A* and B* are both
    the photograph, whose noise remains. (Clamped at 0 where noise makes the mean negative,
    which the latest one was where it is ``unresolved``.)
    ``loss`` is ℒ from A and B against the targets, whose noise it contains, and A's and B's own
    only where the loss is not quadratic.
    """

    def __init__(
        self,
        problem: Problem,
        loss,
        pixels: int,
        spp: int,
        seed: int,
        renderer: Renderer | None = None,
    ):
        self.problem, self.loss, self.spp, self.seed = problem, loss, spp, seed
        self.unresolved = False
        windows = loss.windows
        if windows is not None:
            pixels = max(1, pixels // windows.count)
        counting = np.arange(problem.views.total, dtype=np.uint32)
        # Of what all pixels count, what their windows do.
        self._whole = 1.0
        if problem.mask is not None:
            counted = mask = np.array(problem.mask)
            if windows is not None:
                counted = windows.weights(mask, problem.views)
                self._whole = counted.sum(dtype=np.float64) / mask.sum(dtype=np.float64)
                if not self._whole:
                    raise InputError(
                        f"no window of {windows.side} × {windows.side} pixels has a weight "
                        "throughout: take a smaller loss.side"
                    )
            counting = counting[counted > 0]
        count = min(pixels, counting.size)
        # Those drawn by what they count then count alike: in an even draw a single pixel that
        # counts as much as another view's thousands would be all or nothing.
        self._weighed = problem.mask is not None and count == counting.size
        rng = np.random.default_rng(streams.seed(seed, 0, "evaluation_place"))
        strata = (np.arange(count) + rng.random(count)) * (counting.size / count)
        if count < counting.size and problem.mask is not None:
            ends = np.cumsum(counted[counting], dtype=np.float64)
            strata *= ends[-1] / counting.size
            counting = counting[np.searchsorted(ends[:-1], strata, "right")]
        elif count < counting.size:
            counting = counting[np.minimum(strata.astype(np.int64), counting.size - 1)]
        self.pixels = mi.UInt32(counting)
        if windows is not None:
            middle = problem.views.locate(self.pixels)
            *place, _ = windows.spread(problem.views, *middle, counting.size)
            self.pixels = problem.views.index(*place)
            dr.eval(self.pixels)
        self.renderer = Renderer(problem, renderer)
        self.target = dr.gather(mi.Color3f, problem.targets, self.pixels)
        self.references = (self.target, self.target)
        unknowns, self._moved_in_truth = problem.unknowns, None
        if problem.truth_known:
            self.references = self._halves(unknowns.truths())
            if unknowns.moving:
                self._moved_in_truth = self._shown()

    def apart(self, problem: Problem, values: dict) -> float:
        """Root mean square difference of the mean images of ``problem``, the same with another
        integrator, from this one's; pixels count as in ``image_rmse``. Of means over pixels that
        follow each other, where those differ by more: what few paths meet, as light of a small lamp
        by way of glass, hardly ever comes twice in a pixel."""
        own, other = self._halves(values), self._halves(values, Renderer(problem))
        (a, b), (c, d) = own, other
        weight = np.array(self._weight() + dr.zeros(mi.Float, dr.width(self.pixels)), np.float64)
        first, second = (weight * np.array(each, np.float64) for each in (a - c, b - d))
        squared = [0.0]
        for size in (1, _TOGETHER):
            starts = np.arange(0, weight.size, size)
            one, two = (np.add.reduceat(each, starts, axis=1) for each in (first, second))
            counts = np.add.reduceat(weight, starts)
            counted = counts > 0
            products = (one * two).mean(axis=0)[counted] / counts[counted]
            squared.append(float(products.sum() / counts.sum()))
        return math.sqrt(max(squared))

    def _halves(
        self, values: dict, renderer: Renderer | None = None
    ) -> tuple[mi.Color3f, mi.Color3f]:
        """Two independent renderings of the chosen pixels at ``values``. Evaluates."""
        self.problem.unknowns.write(values)
        half = self.spp // 2
        renderer = renderer or self.renderer
        halves = tuple(
            renderer.pixels(
                self.pixels,
                half,
                lambda s, h=h: streams.seed(self.seed, h * half + s, "evaluation"),
            )
            for h in (0, 1)
        )
        dr.eval(halves)
        return halves

    def products(self, values: dict) -> np.ndarray:
        """(A - A*)(B - B*) of the chosen pixels, their channels' mean, ``(n,) float32``."""
        (first, second), (a, b) = self._halves(values), self.references
        return np.array(dr.mean((first - a) * (second - b)), np.float32)

    @cached_property
    def floor(self) -> Floor | None:
        """What fitting the targets' noise leaves."""
        return floor.measure(self.problem, self.pixels, self.products, self.seed)

    def __call__(self, values: dict) -> dict[str, float]:
        """``loss``, ``image_rmse``, ``parameter_rmse``, ``parameter_rmse/<key>``, and ``value/…``:
        ``_outlines``, ``_scaled`` and ``few``."""
        first, second = self._halves(values)
        weight = self._weight()
        squared = dr.sum((first - self.references[0]) * (second - self.references[1])) * weight
        loss = dr.sum(self.loss.measured(first, second, self.target))
        counted, windows = weight, self.loss.windows
        if windows is not None and self.problem.mask is not None:
            counted = windows.least(weight)
        mean = _mean(squared, weight)
        self.unresolved = mean < 0
        result = {
            "loss": self._whole * _mean(loss * counted, counted),
            "image_rmse": math.sqrt(max(0.0, mean)),
        }
        known = self._outlines() | self.parameter_errors(values) | self._scaled(values)
        return result | known | self.few(values)

    def _weight(self) -> mi.Float:
        """What each of the chosen pixels counts, or 1 for all; of drawn windows, over what the
        window does, by which it was drawn."""
        windows, mask = self.loss.windows, self.problem.mask
        if mask is None or not (self._weighed or windows is not None):
            return mi.Float(1)
        own = dr.gather(mi.Float, mask, self.pixels)
        return own if self._weighed else own / dr.repeat(windows.least(own), windows.count)

    def _outlines(self) -> dict[str, float]:
        """``value/outlines/overlap``, where objects move and the truth is known: of the pixels
        whose middles show what moves, now or in truth, the share that do both; or ``OUTLINE``,
        where alpha or masks are known (``contours.apart``). At the present values."""
        if self.problem.part is not None and self.problem.unknowns.moving:
            return {OUTLINE: contours.apart(self.problem)}
        if self._moved_in_truth is None:
            return {}
        now, truth, weight = self._shown(), self._moved_in_truth, self._weight()
        either = float(dr.sum(mi.Float(now | truth) * weight)[0])
        both = float(dr.sum(mi.Float(now & truth) * weight)[0])
        return {f"{VALUE_PREFIX}outlines/overlap": both / either} if either else {}

    def _shown(self) -> mi.Bool:
        p = self.problem
        view, column, row = p.views.locate(self.pixels)
        middle = mi.Point2f(0.5)
        ray, _ = rays.through(p.sensors, p.views, view, column, row, middle, middle)
        hit = p.scene.ray_intersect_preliminary(ray)
        found, moved = mi.Bool(False), p.unknowns.moved
        for shape in p.scene.shapes():
            if shape.id() in moved:
                found |= hit.shape == mi.ShapePtr(shape)
        found &= hit.is_valid()
        dr.eval(found)
        return found

    def _scaled(self, values: dict) -> dict[str, float]:
        """``value/<key>/scaled``, of textures and maps whose brightness another unknown can make up
        for: the error after a factor a channel."""
        if not self.problem.truth_known:
            return {}
        traded = [self.problem.unknowns[key] for key in self.problem.unknowns.traded]
        return {
            f"{VALUE_PREFIX}{u.key}/scaled": u.scaled_error(u.kind.whole(values[u.key]))
            for u in traded
            if u.start.ndim > 1  # of a single colour nothing would be left
        }

    def few(self, values: dict) -> dict[str, float]:
        """What each kind says of its value: ``value/<key>``, or ``value/<key>/<name>``."""
        return {
            f"{VALUE_PREFIX}{u.key}/{name}".rstrip("/"): number
            for u in self.problem.unknowns
            for name, number in u.kind.numbers(u.kind.whole(values[u.key]), u.truth).items()
        }

    def parameter_errors(self, values: dict) -> dict[str, float]:
        """The error of each unknown over the entries that some view sees, and of all together.

        ``parameter_rmse`` is the root of the mean over *unknowns* of the squared errors: a scalar
        weighs as much as a texture. Where units differ, each error is first divided by the
        unknown's own at the start, so that 1 is the start; by ``Unknown.scale`` where it starts at
        its truth. Where they are alike it is in that unit. The manifest says which.
        """
        if not self.problem.truth_known:
            return {}
        unknowns = self.problem.unknowns
        errors = {u.key: u.error(u.kind.whole(values[u.key])) for u in unknowns}
        squares = [(error / self._sizes[key]) ** 2 for key, error in errors.items()]
        together = math.sqrt(sum(squares) / len(squares))
        return {"parameter_rmse": together} | {f"{KEY_PREFIX}{k}": e for k, e in errors.items()}

    @cached_property
    def _sizes(self) -> dict[str, float]:
        """What each unknown's error is divided by before a mean is taken."""
        unknowns = self.problem.unknowns
        if unknowns.unit is not None:
            return dict.fromkeys(unknowns.keys, 1.0)
        return {u.key: u.error(u.start) or u.scale for u in unknowns}


def _mean(sums: mi.Float, weight: mi.Float) -> float:
    """Over pixels and their three channels; ``weight``: what each counts, or one for all."""
    total = dr.sum(weight + dr.zeros(mi.Float, dr.width(sums)))
    return float(dr.sum(sums)[0]) / (3.0 * float(total[0]))
