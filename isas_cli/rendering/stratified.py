"""Images of many views with little noise: stratified paths, more of them where it is noisy.

A pixel's paths come in sequences of correlated multi-jittered numbers (Kensler 2013, Mitsuba's
``multijitter``), each with a scramble of its own, so that means are unbiased. A pilot of few pixels
tells how noisy each block of pixels is, and blocks get sequences in proportion to their standard
deviation, which for a given number of paths makes the mean squared error least (Neyman 1934). What
the pilot saw is not used again: numbers of paths that hang on the paths themselves would bend the
means. A pixel's sequences are alike and independent: their differences tell the noise of its mean.
Where there is much to render, a few pixels tell whether paths are to have several light samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import interrupt, memory, streams
from ..scene.problem import Problem
from ..unknowns.parameters import own
from . import rays
from .integrators import Surfaces
from .kernels import recorded

# Lanes per pass: large enough to fill the cores, small enough for a few hundred MB.
_LANES = 1 << 20
# Paths of a sequence at most, a square, so that strata are; of a given number of paths, fewer, so
# that a pixel has several sequences in the mean.
_LONGEST, _SEVERAL = 64, 8
# Sides of blocks that share a number of sequences, and of the squares of which each has a pilot.
_BLOCK, _SQUARE = 4, 2
# Parts of a sequence, of which a pilot is one.
_PARTS = 4
# Of the mean standard deviation: what a block is taken to have at least, as pilots miss rare bright
# paths, and a half costs them no more than twice the variance of equal shares; and at most.
_LEAST, _MOST = 0.5, 32.0
# Rounds that there are at least, so that each pixel has several sequences; of a given noise, paths
# a pixel at most.
_FEWEST, _DEAREST = 2, 4096
# The share of pixels whose noise is the images': a few with rare bright paths would else be all of
# it, and no number of paths would do.
_SHARE = 0.99
# Light samples at the first vertex that a path can have instead of one: the share of the variance
# of a sequence's mean that must be left, as such a path takes up to twice the time; asked where
# there are so many paths to trace that whole sequences of both kinds, through one in so many of the
# pilots' pixels, and a second kernel, cost next to nothing. (Single paths do not tell: strata take
# from one sample much of what several would.)
_LIGHTS, _PAYS, _MANY, _ONE_IN = 4, 0.55, 1 << 22, 16
# Before any round: the number of the pilot's first pass, for its seed.
_PILOT = 1 << 26
# What strata are taken to gain, before there is a measurement.
_GAIN = 4.0


@dataclass
class Sums:
    """What has been found of ``n`` pixels. Of the means of sequences, ``float64``: ``first``, their
    sum ``(n, 3)``, and ``second``, of their squares and all channels ``(n,)``. ``sequences``: how
    many ``(n,)``; ``counts``: how many in a round ``(n,)``. ``foretold``: rounds that the pilot
    thinks there will be; ``rounds`` that are whole, the next pass ``at`` in the one that runs;
    ``paths``, and those ``lost``, which were not finite. ``lights``: samples of a path at its first
    vertex, where it can have several."""

    first: np.ndarray
    second: np.ndarray
    sequences: np.ndarray
    counts: np.ndarray
    foretold: int = 0
    rounds: int = 0
    at: int = 0
    paths: int = 0
    lost: int = 0
    lights: int = 1

    @classmethod
    def none(cls, counts: np.ndarray, foretold: int, lights: int = 1) -> "Sums":
        n = counts.size
        zeros = np.zeros((n, 3)), np.zeros(n), np.zeros(n, np.int32)
        return cls(*zeros, counts, foretold, lights=lights)

    def arrays(self) -> dict[str, np.ndarray]:
        return {name: np.asarray(value) for name, value in vars(self).items()}

    @classmethod
    def of(cls, arrays: dict[str, np.ndarray]) -> "Sums":
        return cls(**{n: a if a.ndim else int(a) for n, a in arrays.items()})

    @property
    def images(self) -> np.ndarray:
        """``(n, 3) float32``"""
        found = np.empty(self.first.shape, np.float32)
        for part in memory.parts(len(found)):
            found[part] = self.first[part] / np.maximum(self.sequences[part], 1)[:, None]
        return found

    @property
    def variance(self) -> np.ndarray:
        """Of a mean, its channels' mean, ``(n,) float32``; NaN of less than two sequences."""
        found = np.empty(self.second.shape, np.float32)
        for part in memory.parts(len(found)):
            n = self.sequences[part].astype(np.int64)
            squared = (self.first[part] ** 2).sum(1)
            spread = np.maximum(self.second[part] - squared / np.maximum(n, 1), 0)
            mean = spread / (3 * np.maximum(n * (n - 1), 1))
            found[part] = np.where(n > 1, mean, np.nan)
        return found


def noise(images: np.ndarray, variance: np.ndarray) -> float:
    """The standard deviation of pixels, as a share of the images' mean, root mean square over the
    99 in 100 with the least of it; 0 of black images, NaN where no pixel's is known."""
    known = variance[np.isfinite(variance)]
    if not known.size:
        return math.nan
    known.sort()
    kept = known[: math.ceil(_SHARE * known.size)]
    brightness = float(np.mean(images, dtype=np.float64))
    return math.sqrt(float(np.mean(kept, dtype=np.float64))) / brightness if brightness else 0.0


def render(
    problem: Problem,
    wanted: float | None,
    spp: int | None,
    seed: int,
    told: Callable[[int, int], None],
    kept: Sums | None = None,
    keep: Callable[[Sums], None] = lambda sums: None,
) -> Sums:
    """All pixels of ``problem`` at the scene's present values, to the ``noise`` that is ``wanted``,
    or with ``spp`` paths a pixel in the mean.

    ``told(done, total)`` counts paths. ``keep(sums)`` is given what there is after every pass;
    with that as ``kept`` a rendering goes on, and ends in the same bits. Waits.
    """
    return _Rendering(problem, wanted, spp, seed, told, keep).sums(kept)


class _Rendering:
    def __init__(self, problem: Problem, wanted, spp, seed, told, keep):
        self.problem, self.wanted, self.spp, self.seed = problem, wanted, spp, seed
        self.told, self.keep = told, keep
        self.pixels = problem.views.total
        most = _LONGEST if spp is None else max(1, min(_LONGEST, spp // _SEVERAL))
        self.length = max(1, (math.isqrt(most) // 2 * 2) ** 2)
        # Of which a pilot has the paths of one, so that one kernel does for both.
        self.parts = _PARTS if self.length >= 4 * _PARTS else 1
        self.width = max(1, min(self.pixels, _LANES // self.length))
        self._kernels = {}

    def _recorded(self, lights: int):
        if lights not in self._kernels:
            way = _lit(self.problem.integrator, lights)
            made = _kernel(way, self.length, self.parts, self.width)
            self._kernels[lights] = recorded(made, self.problem)
        return self._kernels[lights]

    def sums(self, kept: Sums | None) -> Sums:
        found = self._begun() if kept is None else kept
        while found.rounds < (aim := self._rounds(found)):
            self._round(found, max(aim, found.foretold))
        self.told(found.paths, found.paths)
        return found

    def _rounds(self, found: Sums) -> int:
        """Of how many rounds there are to be, as far as those so far tell."""
        if self.wanted is None:
            return min(_FEWEST, self.spp)
        if found.rounds < _FEWEST:
            return _FEWEST
        has = noise(found.images, found.variance)
        if not has > self.wanted:
            return found.rounds
        most = max(_FEWEST, _DEAREST * self.pixels // int(found.counts.sum() * self.length))
        return min(most, math.ceil(found.rounds * (has / self.wanted) ** 2))

    def _begun(self) -> Sums:
        """Without any path: with the sequences of each pixel in a round, at least one, and the
        rounds and light samples that pilots call for."""
        if self.length == 1:
            return Sums.none(np.full(self.pixels, -(-self.spp // _FEWEST), np.int32), _FEWEST)
        where = _blocks(self.problem.film_sizes, streams.seed(self.seed, 0, "target"))
        lights, (deviation, brightness) = 1, self._piloted(*where, 1)
        whole = float(deviation.mean())
        many = self._needed(whole, brightness) * self.pixels >= _MANY
        if many and self._several_pay(where[1][::_ONE_IN]):
            lights, (deviation, _) = _LIGHTS, self._piloted(*where, _LIGHTS)
            whole = float(deviation.mean())
        weight = np.clip(deviation / whole, _LEAST, _MOST) if whole > 0 else np.ones(self.pixels)
        needed = self._needed(whole, brightness) / self.length
        # Of a given noise no more than blocks need to share them out: there can be more rounds.
        most = 1 / _LEAST if self.spp is None else math.inf
        each = min(max(needed / _FEWEST, 1.0), most)
        low, high = 0.0, 2 * each / weight.min() + 1
        for _ in range(40):  # so that the mean is what is wanted, where none has less than one
            middle = (low + high) / 2
            few = np.maximum(np.rint(weight * middle), 1).mean() < each
            low, high = (middle, high) if few else (low, middle)
        counts = np.maximum(np.rint(weight * high), 1).astype(np.int32)
        return Sums.none(counts, math.ceil(needed / counts.mean()), lights)

    def _several_pay(self, pixels: np.ndarray) -> bool:
        """Whether several light samples leave so little of the variance of a sequence's mean, by
        two sequences of both kinds through each of ``pixels``."""
        if _lit(self.problem.integrator, _LIGHTS) is self.problem.integrator:
            return False
        left = []
        for lights in (1, _LIGHTS):
            spread, number = [], _PILOT + (1 << 20)
            for first in range(0, pixels.size, self.width // 2):
                part = np.repeat(pixels[first : first + self.width // 2], 2 * self.parts)
                sums, _, finite = self._traced(part, number, lights)
                pairs = (each.reshape(-1, self.parts).sum(1) for each in (*sums, finite))
                *sums, finite = (each.reshape(-1, 2) for each in pairs)
                apart = [np.diff(each / np.maximum(finite, 1), axis=1)[:, 0] for each in sums]
                spread.append(np.mean(np.square(apart), axis=0))
                number += 1
            spread = np.sort(np.concatenate(spread))
            left.append(spread[: math.ceil(_SHARE * spread.size)].mean())
        return left[1] < _PAYS * left[0]

    def _piloted(self, blocks: np.ndarray, pilots: np.ndarray, lights: int):
        """The standard deviation of a path through each pixel, ``(n,)``, that of its block; how
        bright the pilots are."""
        sums, squares = np.zeros((2, 3, pilots.size))
        finite = np.zeros(pilots.size)
        width = self.width * self.parts
        for number, first in enumerate(range(0, pilots.size, width)):
            part = slice(first, first + width)
            found = self._traced(pilots[part], _PILOT + number, lights)
            sums[:, part], squares[:, part], finite[part] = found
        means = sums / np.maximum(finite, 1)
        spread = np.maximum(squares / np.maximum(finite, 1) - means**2, 0).mean(0)
        counted = np.maximum(np.bincount(blocks[pilots], minlength=blocks.max() + 1), 1)
        deviation = np.sqrt(np.bincount(blocks[pilots], spread, counted.size) / counted)
        return deviation[blocks], float(means.mean())

    def _needed(self, deviation: float, brightness: float) -> float:
        """Paths a pixel in the mean, whose mean standard deviation is ``deviation``."""
        if self.wanted is None:
            return self.spp
        if not brightness > 0:
            return 0.0
        return min((deviation / (self.wanted * brightness)) ** 2 / _GAIN, _DEAREST)

    def _round(self, found: Sums, aim: int) -> None:
        """What is left of the round that runs. ``aim``: of how many there will be."""
        ends = np.cumsum(found.counts)
        sequences = int(ends[-1])
        passes = -(-sequences // self.width)
        total = aim * sequences * self.length
        while found.at < passes:
            begin = found.at * self.width
            part = np.arange(begin, min(begin + self.width, sequences))
            chosen = np.searchsorted(ends, part, side="right")  # the pixels whose these are
            number = 1 + found.rounds * passes + found.at
            traced = self._traced(np.repeat(chosen, self.parts), number, found.lights)
            with interrupt.held():
                self._add(found, chosen, traced)
                found.at += 1
            self.told(min(found.paths, total), total)
            self.keep(found)
        found.rounds, found.at = found.rounds + 1, 0

    def _add(self, found: Sums, chosen: np.ndarray, traced: tuple[np.ndarray, ...]) -> None:
        """``traced``: of ``_traced``, ``parts`` for each pixel ``chosen``."""
        sums, _, finite = (
            each.reshape(*each.shape[:-1], chosen.size, self.parts).sum(-1) for each in traced
        )
        means = sums / np.maximum(finite, 1)
        first, last = chosen[0], chosen[-1] + 1  # in order
        place = chosen - first
        for channel in range(3):
            found.first[first:last, channel] += np.bincount(place, means[channel])
        found.second[first:last] += np.bincount(place, (means**2).sum(0))
        found.sequences[first:last] += np.bincount(place, finite > 0).astype(np.int64)
        found.paths += chosen.size * self.length
        found.lost += chosen.size * self.length - int(finite.sum())

    def _traced(self, chosen: np.ndarray, number: int, lights: int) -> tuple[np.ndarray, ...]:
        """Of a part of a sequence through each pixel ``chosen``: sums of radiance and of its square
        ``(3, n)``, and how many paths were finite ``(n,)``, all ``float64``."""
        p = self.problem
        pixel = own(mi.UInt32, np.resize(chosen, self.width * self.parts).astype(np.uint32))
        drawn = dr.opaque(mi.UInt32, streams.seed(self.seed, number, "target"))
        radiance, finite = self._recorded(lights)(*p.traced, pixel, drawn)
        parts = [*map(mi.Float64, radiance), *(dr.square(mi.Float64(c)) for c in radiance)]
        parts.append(dr.select(finite, mi.Float64(1), 0))
        sums = [dr.block_sum(each, self.length // self.parts) for each in parts]
        dr.eval(sums)
        sums = [np.array(each)[: chosen.size] for each in sums]
        return np.stack(sums[:3]), np.stack(sums[3:6]), sums[6]


def _lit(integrator, lights: int):
    """``integrator`` with so many light samples at the first vertex, where it can have them."""
    if not isinstance(integrator, Surfaces):
        return integrator
    if (lights, lights) == integrator.paths.lights:
        return integrator
    return integrator.cut(replace(integrator.paths, lights=(lights, lights), directions=1))


def _kernel(integrator, length: int, parts: int, width: int):
    def kernel(scene, sensors, views, leaves, pixel, seed):
        with dr.suspend_grad():
            lane = dr.arange(mi.UInt32, width * length)
            place = views.locate(dr.gather(mi.UInt32, pixel, lane // (length // parts)))
            stream = mi.load_dict({"type": "multijitter", "sample_count": length})
            stream.set_samples_per_wavefront(length)
            stream.seed(seed, width * length)
            radiance = rays.radiance(integrator, scene, sensors, views, place, stream)
            finite = dr.all(dr.isfinite(radiance))
            radiance = dr.select(finite, radiance, 0)
            dr.eval(radiance, finite)
            return radiance, finite

    return kernel


def _blocks(sizes: list[tuple[int, int]], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The block of every pixel of films of ``sizes``, ``(n,)``, and the pilots among the pixels, in
    order: one of each square."""
    rng, blocks, pilots, before, pixels = np.random.default_rng(seed), [], [], 0, 0
    for width, height in sizes:
        row, column = np.divmod(np.arange(width * height), width)
        across = -(-width // _BLOCK)
        own = row // _BLOCK * across + column // _BLOCK
        blocks.append(before + own)
        before += across * -(-height // _BLOCK)
        wide, high = -(-width // _SQUARE), -(-height // _SQUARE)
        at = np.indices((high, wide)) * _SQUARE + rng.integers(0, _SQUARE, (2, high, wide))
        at = np.minimum(at, np.array([height - 1, width - 1])[:, None, None])
        pilots.append(pixels + np.unique(at[0] * width + at[1]))
        pixels += width * height
    return np.concatenate(blocks), np.concatenate(pilots)
