"""Gradients of parts whose influence on the images is local, without the others' noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import rays
from .blur import Blur
from .smoothing import Pair

if TYPE_CHECKING:
    from ..poses import Pose
    from ..problem import Problem


@dataclass(frozen=True)
class _Local:
    """One unknown with a ``reach``: a pose's parts, at ``first`` and after among all entries."""

    pose: "Pose"
    first: int
    middles: np.ndarray  # (parts, 3), in the world, of the parts as they were loaded
    reach: float

    def at(self, θ: np.ndarray) -> np.ndarray:
        """The parts' middles at ``θ (D,)``: ``(parts, 3)``."""
        own = θ[self.first : self.first + self.pose.size] - self.pose.at
        return self.middles + own.reshape(self.pose.parts, -1) @ self.pose.spec.directions


class Locality:
    """What each entry's slope is estimated from.

    A pair (θ + τ, θ - τ) moves all parts at once; a part's slope, estimated from the whole image,
    has all other parts' differences as noise. A pixel that part k reaches from neither side's place
    has the same value whichever of ± τ_k it is given, and ± are equally likely: what it adds to
    part k's estimate is 0 in the mean. Such pixels are left out of it, which changes the variance
    (by about the number of parts that do not touch each other) and not the mean, if the part's
    influence ends at its ``reach``: pixels whose camera ray passes farther from the part's middle
    than that, at θ + τ and at θ - τ, are taken to be unreached. Shadows and light thrown on others
    are influence as well. Too short a reach is a bias, too long a one is noise.
    """

    def __init__(self, problem: "Problem", blur: Blur, batch: int, freeze: bool = True):
        self.problem, self.blur = problem, blur
        self._items = list(_items(problem, blur))
        wrap = dr.freeze if freeze else (lambda f: f)
        self._kernels = [wrap(_kernel(batch, item.pose.parts, item.reach)) for item in self._items]

    def __bool__(self) -> bool:
        return bool(self._items)

    def differences(
        self, θ: np.ndarray, pair: Pair, place: tuple, terms: mi.Float
    ) -> float | np.ndarray:
        """Σ of ``terms (N,)`` over the drawn pixels, for every entry, ``(D,)``: of unknowns with a
        reach over those near its part. ``place``: view, column, row of each term. Waits."""
        p = self.problem
        found = np.full(θ.size, float(dr.sum(terms)[0]))
        for item, kernel in zip(self._items, self._kernels):
            sides = [item.at(self.blur.ends(θ + offset)) for offset in (pair.plus, pair.minus)]
            middles = [mi.Point3f(np.ascontiguousarray(side.T, np.float32)) for side in sides]
            sums = np.array(kernel(p.sensors, p.views, place, terms, middles), float)
            own = slice(item.first, item.first + item.pose.size)
            found[own] = np.repeat(sums, item.pose.each)
        return found


def _items(problem: "Problem", blur: Blur):
    first = 0
    for unknown in problem.unknowns:
        if unknown.blur.reach is not None:
            where = f"scene.unknowns['{unknown.key}'].blur.reach={unknown.blur.reach:g}"
            pose, middles = problem.unknowns.place(unknown.key, where)
            yield _Local(pose, first, middles, unknown.blur.reach)
        first += unknown.start.size


def _kernel(batch: int, parts: int, reach: float):
    def kernel(sensors, views, place, terms, middles):
        ray, _ = rays.through(sensors, views, *place, mi.Point2f(0.5), mi.Point2f(0.5))
        lane = dr.arange(mi.UInt32, parts * batch)
        part = lane // dr.opaque(mi.UInt32, batch)
        pixel = lane - part * batch
        origin = dr.gather(mi.Point3f, ray.o, pixel)
        direction = dr.gather(mi.Vector3f, ray.d, pixel)

        def near(side):
            to = dr.gather(mi.Point3f, side, part) - origin
            return dr.squared_norm(to - direction * dr.dot(to, direction)) < reach * reach

        value = dr.gather(mi.Float, terms, pixel)
        value = dr.select(near(middles[0]) | near(middles[1]), value, 0)
        sums = dr.block_sum(value, batch)
        dr.eval(sums)
        return sums

    return kernel
