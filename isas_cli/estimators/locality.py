"""Gradients of parts whose influence on the images is local, without the others' noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..rendering import rays
from ..rendering.kernels import recorded
from ..runtime.errors import InputError
from ..scene import lenses
from ..scene.problem import Problem
from ..unknowns.blur import Blur
from ..unknowns.smoothing import Pair

if TYPE_CHECKING:
    from ..unknowns.poses import Pose

_MOST_LANES = 1 << 28  # a few gigabytes
# Whose pixels each see along one ray, or nearly.
_SHARP = {"PerspectiveCamera", "OrthographicCamera", "RadianceMeter"}


@dataclass(frozen=True)
class _Local:
    """One unknown with a ``reach``: a pose's parts, at ``first`` and after among all entries."""

    pose: "Pose"
    first: int
    middles: np.ndarray  # (parts, 3), in the world, of the parts as they were loaded
    reach: float

    def at(self, θ: np.ndarray) -> np.ndarray:
        """The parts' middles at ``θ (D,)``: ``(parts, 3)``."""
        own = θ[self.first : self.first + self.pose.size] - self.pose.present
        return self.middles + own.reshape(self.pose.parts, -1) @ self.pose.ways


class Locality:
    """What each entry's slope is estimated from.

    A pair (θ + τ, θ - τ) of the scheme ``joint`` moves all parts at once; a part's slope, estimated
    from the whole image, has all other parts' differences as noise. A pixel is left out of part k's
    estimate if its camera ray passes farther than ``reach`` from the part's middle at θ + τ and at
    θ - τ. This lowers the variance (by about the number of parts that do not touch each other) and
    keeps the mean if the part's influence ends at its reach: turn the sign of all of τ_k and of no
    other part's offset. The offset is as likely as before; which pixels are left out stays, as both
    sides' places are asked; what those show stays, as they see the part from neither place; and the
    weight of every entry of the part changes its sign. So what they add is 0 in the mean. (With
    ``separate`` nothing but the part differs between the sides, and little is won.) It holds for
    images and for losses, and for any pmf of the pixels that does not depend on this τ.

    Shadows, light that the part throws on others and light that it keeps from them are influence as
    well; and ``reach`` has to hold half a pixel more, as a pixel is judged by the ray through its
    middle. Too short a reach is a bias, too long a one is noise. It costs parts × ``batch`` lanes.
    """

    def __init__(self, problem: Problem, blur: Blur, batch: int, freeze: bool = True):
        self.problem, self.blur = problem, blur
        self._items = list(_items(problem, blur, batch))
        self._kernels = [
            recorded(_kernel(batch, item.pose.parts, item.reach), problem, freeze)
            for item in self._items
        ]

    def differences(self, θ: np.ndarray, pair: Pair, place: tuple, terms: mi.Float) -> np.ndarray:
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


def _items(problem: Problem, blur: Blur, batch: int):
    first = 0
    for unknown in problem.unknowns:
        if unknown.blur.reach is not None:
            where = f"scene.unknowns['{unknown.key}'].blur.reach={unknown.blur.reach:g}"
            pose, middles = problem.unknowns.place(unknown.key, where)
            ids = {sensor.id() for sensor in problem.scene.sensors()}
            # A batch's name comes before those of its cameras.
            if any(f"{m}.".startswith(f"{id}.") for m in problem.unknowns.moved for id in ids):
                # Near on one side of a pair would not be near on the other.
                raise InputError(f"{where}: only where no pose moves a camera")
            for number, sensor in enumerate(problem.scene.sensors()):
                if not {each.class_name() for each in lenses.side_by_side(sensor)} <= _SHARP:
                    raise InputError(
                        f"{where}: one ray does not tell what a pixel of sensor {number} sees: "
                        "leave reach out"
                    )
            lanes = pose.parts * batch
            if lanes > _MOST_LANES:
                raise InputError(
                    f"{where}: {pose.parts} parts times estimator.batch={batch} are more than "
                    f"{_MOST_LANES} sums at once; take a smaller batch"
                )
            yield _Local(pose, first, middles, unknown.blur.reach)
        first += unknown.start.size


def _kernel(batch: int, parts: int, reach: float):
    def kernel(sensors, views, place, terms, middles):
        ray, _ = rays.through(sensors, views, *place, mi.Point2f(0.5), mi.Point2f(0.5))
        # Part after part, so that sums are over blocks.
        part = dr.repeat(dr.arange(mi.UInt32, parts), batch)
        pixel = dr.tile(dr.arange(mi.UInt32, batch), parts)
        origin = dr.gather(mi.Point3f, ray.o, pixel)
        direction = dr.gather(mi.Vector3f, ray.d, pixel)

        def near(side):
            to = dr.gather(mi.Point3f, side, part) - origin
            return dr.squared_norm(to - direction * dr.dot(to, direction)) < reach * reach

        value = dr.gather(mi.Float, terms, pixel)
        value = dr.select(near(middles[0]) | near(middles[1]), value, 0)
        # Not by atomic additions, whose order would change the last bits.
        sums = dr.block_sum(value, batch, mode="evaluated")
        dr.eval(sums)
        return sums

    return kernel
