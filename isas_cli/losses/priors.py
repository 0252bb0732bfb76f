"""Priors: a term on the unknowns themselves beside the loss of the images.

    ℒ'(θ) = ℒ(θ) + weight R(θ),    R = Σ_keys f/K Σ_k ρ(differences of entry k to its neighbours)

f the unknown's own factor (``Unknown.weighed``, 1), over the K entries of each key that has
neighbours: texels along both sides of a texture, of an environment map (which closes on itself
sideways), channels each by itself. An entry at an open end has no neighbour there. Differences are
those over the distance of two entries of the whole unknown: where it is coarser for now, they are
divided by how much farther its entries are apart, so that the weight means the same at every level.
R is a function of θ alone, so its gradient has no noise and no bias; it is billed with the step.
Entries that no pixel touched move as well, towards their neighbours: where
``optimizer.mask_updates`` would have left them, they are touched now.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..rendering.kernels import recorded
from ..runtime.errors import InputError, nearest
from ..unknowns.parameters import flat, unflat
from ..unknowns.unknowns import Unknowns


class OnUnknowns:
    """A prior on the unknowns of one problem. ``unheeded``: settings that no unknown follows, in
    words."""

    unheeded: Sequence[str] = ()

    def value(self, values: dict) -> float:
        """R at ``values``, weighed. Waits."""
        raise NotImplementedError

    def add(self, values: dict, gradients: dict) -> dict:
        """``gradients`` with ∂R/∂θ, weighed, added, by key."""
        raise NotImplementedError


@dataclass(frozen=True)
class Prior:
    """Base of the priors' settings; ``on`` gives the prior at work."""

    def on(self, unknowns: Unknowns) -> OnUnknowns | None:
        """The prior of these unknowns, None for none. Raises InputError where it has nothing to say
        of them, and for a factor on one that it has no part of."""
        raise NotImplementedError


@dataclass(frozen=True)
class Nothing(Prior):
    """No prior: R = 0."""

    def on(self, unknowns: Unknowns) -> None:
        check_factors(unknowns, [])


@dataclass(frozen=True)
class OfNeighbours(Prior):
    """Base of priors on neighbours.

    ``weight``: of R beside ℒ, at least 0; ``keys``: of which unknowns, None for all that have
    neighbours. Raises InputError for a weight that is no such number.
    """

    weight: float = 0.01
    keys: list[str] | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.weight < np.inf:
            raise InputError(f"prior.weight={self.weight}: must be a finite number, at least 0")

    def on(self, unknowns: Unknowns) -> "OnNeighbours":
        """Raises InputError where none of them has neighbours, for a key that is no unknown or has
        none, and for a factor on one that is not chosen."""
        found = self.over(unknowns)
        check_factors(unknowns, list(found.laid_out))
        return found

    def over(self, unknowns: Unknowns) -> "OnNeighbours":
        """The same, whatever factors the others have."""
        axes = {u.key: u.kind.axes for u in unknowns}
        valid = [key for key in axes if axes[key]]
        for key in self.keys or []:
            if key not in valid:
                raise InputError(
                    f"prior.keys: '{key}' is no unknown with neighbouring entries; "
                    f"{nearest(key, valid)}"
                )
        if not valid:
            raise InputError(
                "prior: no unknown has neighbouring entries, as the texels of a texture have: say "
                "prior=none"
            )
        chosen = self.keys or valid
        laid_out = {key: (unknowns[key].start.shape, axes[key]) for key in chosen}
        return OnNeighbours(self, laid_out, {key: unknowns[key].weighed for key in chosen})

    def energy(self, steps: list[mi.Float]) -> mi.Float:
        """ρ of every entry from its steps to the next entry along each axis. Traced."""
        raise NotImplementedError

    def slopes(self, steps: list[mi.Float]) -> list[mi.Float]:
        """∂ρ/∂step of every entry along each axis. Traced."""
        raise NotImplementedError


def check_factors(unknowns: Unknowns, keys: list[str]) -> None:
    """Raises InputError for an unknown with a factor on a prior that has no part of it: all but
    those of ``keys``."""
    for unknown in unknowns:
        if unknown.prior != 1 and unknown.key not in keys:
            raise InputError(
                f"scene.unknowns['{unknown.key}'].prior={unknown.prior:g}: the prior has no part "
                "of this unknown: leave it out, or choose another prior"
            )


@dataclass(frozen=True)
class Smoothness(OfNeighbours):
    """ρ = Σ_a d_a²: the gradient of R is, but for its scale, the grid's Laplacian."""

    def energy(self, steps: list[mi.Float]) -> mi.Float:
        return sum((dr.square(d) for d in steps), mi.Float(0))

    def slopes(self, steps: list[mi.Float]) -> list[mi.Float]:
        return [2 * d for d in steps]


@dataclass(frozen=True)
class TotalVariation(OfNeighbours):
    """ρ = √(Σ_a d_a² + ε²) - ε: one large step costs no more than many small ones that make it.

    ``epsilon``: ε, in the unknown's unit; below it ρ is quadratic, so that it has a derivative.
    """

    weight: float = 0.001
    epsilon: float = 0.001

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.epsilon < np.inf:
            raise InputError(f"prior.epsilon={self.epsilon}: must be a finite number above 0")

    def _length(self, steps: list[mi.Float]) -> mi.Float:
        return dr.sqrt(sum((dr.square(d) for d in steps), mi.Float(self.epsilon**2)))

    def energy(self, steps: list[mi.Float]) -> mi.Float:
        return self._length(steps) - self.epsilon

    def slopes(self, steps: list[mi.Float]) -> list[mi.Float]:
        length = self._length(steps)
        return [d / length for d in steps]


@dataclass
class Neighbours:
    """For each entry of a flat array, along each axis: the next one and the one before, itself at
    an open end. ``(K,) uint32`` each. ``closer``: along each axis, how many times closer the
    entries of the whole unknown are, opaque."""

    following: list
    preceding: list
    closer: list
    count: int

    @staticmethod
    def of(
        shape: tuple[int, ...], axes: tuple[tuple[int, bool], ...], whole: tuple[int, ...]
    ) -> "Neighbours":
        """``axes``: (axis, whether it closes on itself) of an array of this shape; ``whole``: the
        unknown's own."""
        index = np.arange(np.prod(shape), dtype=np.uint32).reshape(shape)
        following, preceding, closer = [], [], []
        for axis, wraps in axes:
            after, before = np.roll(index, -1, axis), np.roll(index, 1, axis)
            if not wraps:
                last = [slice(None)] * index.ndim
                last[axis] = slice(-1, None)
                after[tuple(last)] = index[tuple(last)]
                last[axis] = slice(0, 1)
                before[tuple(last)] = index[tuple(last)]
            following.append(mi.UInt32(after.ravel()))
            preceding.append(mi.UInt32(before.ravel()))
            closer.append(dr.opaque(mi.Float, whole[axis] / shape[axis]))
        return Neighbours(following, preceding, closer, index.size)


class OnNeighbours(OnUnknowns):
    """``laid_out``: shape and axes by key; ``factors``: on the weight, by key."""

    def __init__(self, prior: OfNeighbours, laid_out: dict[str, tuple], factors: dict[str, float]):
        self.prior, self.laid_out, self.factors = prior, laid_out, factors
        self._slope = recorded(self._traced_slope, None)
        self._found: dict[tuple, Neighbours] = {}

    def _around(self, key: str, value) -> Neighbours:
        whole, axes = self.laid_out[key]
        shape = tuple(value.shape)
        if (key, shape) not in self._found:
            self._found[key, shape] = Neighbours.of(shape, axes, whole)
        return self._found[key, shape]

    def value(self, values: dict) -> float:
        total = 0.0
        for key in self.laid_out:
            x, around = flat(values[key]), self._around(key, values[key])
            found = self.prior.energy(_steps(x, around.following, around.closer))
            total += self.factors[key] * float(dr.sum(mi.Float64(found))[0]) / around.count
        return self.prior.weight * total

    def add(self, values: dict, gradients: dict) -> dict:
        result = dict(gradients)
        for key in self.laid_out:
            around = self._around(key, values[key])
            # Opaque: weights differ between runs that share a recording.
            scale = dr.opaque(mi.Float, self.prior.weight * self.factors[key] / around.count)
            places = around.following, around.preceding, around.closer
            slope = self._slope(flat(values[key]), *places, scale)
            result[key] = unflat(gradients[key], flat(gradients[key]) + slope)
        return result

    def _traced_slope(self, x, following, preceding, closer, scale):
        slopes = self.prior.slopes(_steps(x, following, closer))
        slopes = [slope / times for slope, times in zip(slopes, closer)]
        dr.eval(slopes)
        total = mi.Float(0)
        own = dr.arange(mi.UInt32, dr.width(x))
        for slope, before in zip(slopes, preceding):
            # An entry ends the step of the one before it and begins its own. (At an open end a
            # step is 0, and so is its slope.)
            ends = dr.gather(mi.Float, slope, before)
            total += dr.select(before == own, 0, ends) - slope
        return total * scale


def _steps(x: mi.Float, following: list, closer: list) -> list[mi.Float]:
    pairs = zip(following, closer)
    return [(dr.gather(mi.Float, x, after) - x) / times for after, times in pairs]
