"""Short measurements that tell which light transport a gradient needs, and what it costs.

All at the start values, dark lights lit, with uniform pixels. **Depth**: one kernel traces paths of
any length; with the same random numbers a longer path begins as the shorter one, so the difference
of two gradients is what the longer paths add, free of the noise that both share. **Caustics**: the
same with and without them. **Light samples**: how the noise of a gradient and the time of a step
change with their number, and with picking them. The residual that a run is left with in the end is
noise, so the residual here is the difference of two renderings of the same pixels.
"""

from __future__ import annotations

import dataclasses
import math
import time
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..rendering import rays
from ..rendering.integrators import Paths
from ..rendering.kernels import recorded
from ..rendering.pixels import PixelDistribution, Tiles
from ..runtime import streams
from ..runtime.backend import sync
from ..scene.problem import Problem
from ..unknowns.parameters import as_numpy
from . import structure

_LANES, _LONG = 1 << 13, 1.0  # pixels of an estimate; of half as many where there are less seconds
# A kind of path is measured for so many seconds, or for its part of what is allowed (about as many
# kinds as are usual), by estimates of the gradient between these numbers.
_SECONDS, _PARTS = 0.25, 9
_LEAST_BATCHES, _MOST_BATCHES = 8, 64
# For each view, and for one that shows no unknown by so many, at most and at least; but no more for
# all in one look, and then in no more than half of the time that is left.
_PATHS_A_VIEW, _SURE, _MOST_PATHS = (1 << 9, 1 << 16), 1 << 12, 1 << 20
# Numbers of the probe's streams, which no iteration of a run reaches.
_FAR = (1 << 27) - (1 << 18)
_WARM_UP = 4  # recordings are steady from the fourth call on
_BLOCKS, _MOST_ENTRIES = 8, 1 << 16
# Neighbouring entries that are taken for equally noisy.
_ALIKE = 256
# One-sided, 95 %.
Z = 1.645


@dataclass(frozen=True)
class Share:
    """Of a whole that a part is: estimate, and the upper and the lower bound of it, either of
    which holds with 95 %."""

    value: float
    bound: float
    low: float = 0.0


@dataclass(frozen=True)
class Cut:
    """What paths of more than ``depth`` edges are, or their derivatives, or caustics: their share
    of the images (none, where only the derivative is cut) and of the gradient by each unknown;
    ``time``: of a gradient without them, over that with them; ``lost``: of the entries that a view
    sees, the share that has no other derivative, where that was asked."""

    depth: int
    image: Share | None
    gradient: dict[str, Share]
    time: float
    lost: float = 0.0


@dataclass(frozen=True)
class Lights:
    """``noise``: variance of a gradient's entry with so many light samples (residual, derivative),
    each picked from so many directions, over that of the first that was measured, see
    ``noise_ratio``; ``error``: its standard error; ``time``: of a step, likewise."""

    samples: tuple[int, int]
    directions: int
    noise: float
    error: float
    time: float


class Probe:
    """Measures on one problem and loss. ``allowed``: seconds at most; ``seconds``, ``paths``: taken
    so far; all without compiling."""

    def __init__(self, problem: Problem, loss, seed: int, allowed: float = math.inf):
        self.problem, self.seed, self.allowed = problem, seed, allowed
        self.loss = loss.pixelwise
        self.values = problem.unknowns.starts(lit=True)
        self.pixels = PixelDistribution.uniform(Tiles.over(problem.views))
        # A short look at each of several questions is worth more than a long one at the first.
        self.lanes = min(_LANES if allowed >= _LONG else _LANES // 2, problem.views.total)
        self.seconds, self.paths = 0.0, 0
        integrator = problem.integrator
        whole = integrator.max_depth
        self._all = Paths(whole, whole, caustics=integrator.paths.caustics)
        self._clear = bool(structure.clear(problem))
        self._any = self._kernel(None, True)
        self._whole = None

    def views(self) -> tuple[int, ...] | None:
        """The views that see an unknown, where some do not and there is time to be sure of it: of
        so many paths through random pixels of a view none has a derivative, along random signs of
        all entries."""
        views, rng = self.problem.views, np.random.default_rng(0)
        if views.count == 1 or views.altered or self.seconds >= self.allowed:
            return None
        unknowns = self.problem.unknowns
        signs = {u.key: rng.choice([-1.0, 1.0], u.start.shape).astype(np.float32) for u in unknowns}
        seen, most = np.zeros(views.count, bool), float(_MOST_PATHS)
        for paths, least in zip(_PATHS_A_VIEW, (1, _SURE)):
            unseen = np.flatnonzero(~seen)
            if not len(unseen):
                break
            each = int(min(paths, most / len(unseen)))
            if each < least:
                unknowns.write(unknowns.starts())
                return None
            times = []
            for _ in range(3):
                begun = time.perf_counter()
                unknowns.push_tangent(self.values, unknowns.values_of(signs))
                seen[unseen] = self._met(unseen, each)
                times.append(time.perf_counter() - begun)
            # The first one compiles, for so many lanes; another may have been suspended.
            spent = min(times[1:])
            self.seconds += spent
            self.paths += each * len(unseen)
            affordable = (self.allowed - self.seconds) / 2 / spent
            most = min(most, affordable * each * len(unseen))
        unknowns.write(unknowns.starts())
        return None if seen.all() or not seen.any() else tuple(np.flatnonzero(seen).tolist())

    def work(self) -> float:
        """Of a path through a random pixel, the mean (``Integrator.work``)."""
        p = self.problem
        p.unknowns.write(self.values)
        for compiled in (False, True):
            begun = time.perf_counter()
            with dr.suspend_grad():
                drawn = dr.opaque(mi.UInt32, streams.seed(self.seed, _FAR, "draw"))
                view, column, row, _ = self.pixels.draw(self.lanes, drawn)
                stream = rays.stream(streams.seed(self.seed, _FAR, "cost"), self.lanes)
                ray, _ = rays.spawn(p.sensors, p.views, view, column, row, stream)
                found = float(dr.mean(p.integrator.work(p.scene, stream, ray))[0])
            if compiled:
                self.seconds += time.perf_counter() - begun
                self.paths += self.lanes
        p.unknowns.write(p.unknowns.starts())
        return found

    def _met(self, among: np.ndarray, paths: int) -> np.ndarray:
        """Whether any of so many ``paths`` of each view ``among`` all has a derivative along the
        pushed tangent, as ``among``."""
        p, views = self.problem, self.problem.views
        with dr.suspend_grad():
            view = mi.UInt32(np.repeat(among, paths).astype(np.uint32))
            stream = rays.stream(streams.seed(self.seed, _FAR, "coverage"), dr.width(view))
            column, row = (
                mi.UInt32(stream.next_1d() * mi.Float(dr.gather(mi.UInt32, size, view)))
                for size in (views.width, views.height)
            )
            ray, _ = rays.spawn(p.sensors, views, view, column, row, stream)
            found = np.array(p.integrator.forward(p.scene, stream, ray))
        return np.any(found.reshape(3, len(among), -1) != 0, axis=(0, 2))

    def cut(self, depth: int, derivative: bool) -> Cut | None:
        """What is lost where paths (``derivative``: what is differentiated of them) have at most
        ``depth`` edges; None where measuring would take too long."""
        own = dataclasses.replace(self._all, derivative=depth)
        return self._with(own if derivative else dataclasses.replace(own, depth=depth))

    def caustics(self) -> Cut | None:
        """What is lost without caustics; None where measuring would take too long."""
        return self._with(dataclasses.replace(self._all, caustics=False))

    def _with(self, paths: Paths) -> Cut | None:
        """What is lost with ``paths`` instead of all."""
        if self._whole is None:
            self._whole = self._repeated(self._any, self._all)
        own = self._whole and self._repeated(self._any, paths)
        self.problem.unknowns.write(self.problem.unknowns.starts())
        if not own:
            return None
        # Batches of the same number have the same random numbers.
        count = min(len(own[0]), len(self._whole[0]))
        images, gradients = zip(*((i[:count], g) for i, g, _ in (own, self._whole)))
        shares = {}
        for key, every in gradients[1].items():
            every, some = every[:count], gradients[0][key][:count]
            shares[key] = gradient_share(every - some, every)
        alike = dataclasses.replace(paths, derivative=self._all.derivative) == self._all
        image = None if alike else _image_share(images[1] - images[0], images[1])
        return Cut(paths.derivative, image, shares, own[2] / self._whole[2])

    def lights(self, paths: Paths, candidates: list[tuple[tuple[int, int], int]]) -> list[Lights]:
        """For each of ``candidates``, (samples, directions), on ``paths``; those for which there
        is time."""
        found = []
        for samples, directions in candidates:
            own = dataclasses.replace(paths, lights=samples, directions=directions)
            kernel = self._kernel(self.problem.integrator.cut(own), False)
            measured = self._repeated(kernel, own, fixed=True)
            if not measured:
                break
            squares = {key: g.astype(np.float64) ** 2 for key, g in measured[1].items()}
            found.append(((samples, directions), squares, measured[2]))
        self.problem.unknowns.write(self.problem.unknowns.starts())
        return [
            Lights(*way, *noise_ratio(squares, found[0][1]), seconds / found[0][2])
            for way, squares, seconds in found
        ]

    def _repeated(self, kernel, paths: Paths, fixed: bool = False):
        """Mean radiances, gradients by key ``(batches, entries)``, median seconds of a batch; None
        where that would take longer than is allowed.

        ``fixed``: the same pixels in every batch, each of which is compared with the one before
        instead of the targets."""
        unknowns = self.problem.unknowns
        # An exposure's derivative is no path's.
        images, rows, seconds = [], {u.key: [] for u in unknowns if u.kind.carried}, []
        earlier = [dr.zeros(mi.Color3f, self.lanes) for _ in range(2)]
        dr.make_opaque(earlier)
        for batch in range(-_WARM_UP, _MOST_BATCHES):
            radiance, spent = self._estimate(kernel, paths, earlier, batch, fixed)
            earlier = radiance if fixed else earlier
            if batch < 0:
                seconds.append(spent)
                continue
            if batch == 0:
                # Of the warm-up only the last estimate compiled nothing.
                part = min(_SECONDS, self.allowed / _PARTS)
                wanted = max(_LEAST_BATCHES, min(_MOST_BATCHES, int(part / seconds[-1])))
                if self.seconds + wanted * seconds[-1] > self.allowed:
                    return None
                seconds = []
            seconds.append(spent)
            images.append(float(dr.mean(dr.mean(radiance[0]))[0]))
            for key, gradient in unknowns.gradients().items():
                if key in rows:
                    rows[key].append(_some(as_numpy(gradient).ravel()))
            if len(seconds) == wanted:
                break
        # As many times the median: a process that is suspended is not billed for it.
        self.seconds += len(seconds) * float(np.median(seconds))
        self.paths += 2 * self.lanes * len(seconds)
        return np.array(images), {k: np.array(r) for k, r in rows.items()}, np.median(seconds)

    def _estimate(self, kernel, paths: Paths, earlier, batch: int, fixed: bool):
        """One gradient, left in the unknowns' leaves; both paths' radiances, and seconds."""
        p = self.problem
        seeds = rays.seeds(self.seed, _FAR + (0 if fixed else batch), "draw")
        seeds += rays.seeds(self.seed, _FAR + batch, "primal", "adjoint")
        p.unknowns.attach(self.values)
        own = [dr.opaque(mi.UInt32, depth) for depth in (paths.depth, paths.derivative)]
        own.append(dr.opaque(mi.Bool, paths.caustics))
        sync()
        begun = time.perf_counter()
        arguments = self.pixels, p.targets, p.mask, earlier, own, seeds, p.share
        radiance = kernel(*p.traced, *arguments)
        sync()
        return radiance, time.perf_counter() - begun

    def _kernel(self, integrator, of_targets: bool):
        """One estimate of the gradient. ``integrator``: None for paths as are asked for;
        ``of_targets``: the residual is towards the targets, else towards an earlier rendering."""
        whole, loss, lanes = self.problem.integrator, self.loss, self.lanes
        clear = self._clear
        roulette = whole.paths.roulette

        def kernel(
            scene, sensors, views, leaves, pixels, targets, mask, earlier, own, seeds, share
        ):
            with dr.suspend_grad():
                *depths, caustics = own
                asked = Paths(*depths, roulette=roulette, caustics=caustics if clear else True)
                paths = integrator or whole.deep(asked)
                view, column, row, probability = pixels.draw(lanes, seeds[0])
                pixel = views.index(view, column, row)
                dr.eval(view, column, row, pixel, probability)
                target = dr.gather(mi.Color3f, targets, pixel)
                streams = [rays.stream(seed, lanes) for seed in seeds[1:]]
                spawned, weights = zip(
                    *(rays.spawn(sensors, views, view, column, row, each) for each in streams)
                )
                seen = []

                def adjoints(radiances: list) -> list:
                    found = []
                    for radiance, own, other in zip(radiances, weights, reversed(weights)):
                        shown = radiance * own
                        seen.append(shown)
                        if not of_targets:
                            shown = shown - earlier[len(found)] + target
                        residual = rays.masked(loss.derivative(shown, target), mask, pixel)
                        part = share / (probability * lanes * len(radiances))
                        found.append(residual * other * part)
                    return found

                paths.pair(scene, streams, spawned, adjoints)
                seen = [seen[0], seen[-1]]
                dr.eval(seen)
                return seen

        return recorded(kernel, self.problem)


def _some(entries: np.ndarray) -> np.ndarray:
    """Every so-many-th entry of a large texture, all channels among them: batches of gradients are
    held side by side."""
    stride = -(-entries.size // _MOST_ENTRIES)
    return entries[:: stride + (stride % 3 == 0)].copy()


def gradient_share(part: np.ndarray, whole: np.ndarray) -> Share:
    """‖E part‖/‖E whole‖ from independent rows ``(n, entries)`` of both, paired; the bounds by the
    jackknife. Squared norms of means are means of products of different rows: their noise does not
    add to them. But where rows hardly meet in an entry, as of a small lamp behind glass, all these
    products are 0, and so is the jackknife's error: no less than that of entries as noisy as they
    are counts then: of means that are 0, √(2 Σ σ⁴ / n (n - 1)). At most, ‖E part‖² ≤ E ‖part‖²."""
    (own, own_error), (all_, error) = map(_squared_norm, (part, whole))
    if all_ <= 0:
        return Share(float("nan"), float("inf"))
    energy = np.sum(part.astype(np.float64) ** 2, axis=1)
    n, starts = len(part), np.arange(0, part.shape[1], _ALIKE)
    spread = np.add.reduceat(np.var(part, axis=0, ddof=1, dtype=np.float64), starts)
    counts = np.diff([*starts, part.shape[1]])
    rarely = math.sqrt(2 / (n * (n - 1)) * np.sum(spread**2 / counts))
    most = max(own, 0.0) + Z * max(own_error, rarely)
    most = min(most, energy.mean() + Z * energy.std(ddof=1) / math.sqrt(n))
    least = all_ - Z * error
    bound = np.sqrt(most / least) if least > 0 else float("inf")
    low = np.sqrt(max(own - Z * own_error, 0.0) / (all_ + Z * error))
    return Share(float(np.sqrt(max(own, 0.0) / all_)), float(bound), float(low))


def _squared_norm(rows: np.ndarray) -> tuple[float, float]:
    """‖E row‖² from independent ``rows (n, entries)``, and the jackknife's standard error."""
    gram, n = rows.astype(np.float64) @ rows.astype(np.float64).T, len(rows)
    products = gram - np.diag(np.diag(gram))
    value = products.sum() / (n * (n - 1))
    # Without a row: all products but its own, on either side.
    left = (products.sum() - 2 * products.sum(axis=0)) / ((n - 1) * (n - 2))
    return float(value), float(np.sqrt((n - 1) / n * np.sum((left - left.mean()) ** 2)))


def _image_share(part: np.ndarray, whole: np.ndarray) -> Share:
    if whole.mean() <= 0:
        return Share(float("nan"), float("inf"))
    value, error = part.mean() / whole.mean(), part.std(ddof=1) / len(part) ** 0.5 / whole.mean()
    low, bound = max(abs(value) - Z * error, 0.0), abs(value) + Z * error
    return Share(float(value), float(bound), float(low))


def noise_ratio(squares: dict, usual: dict) -> tuple[float, float]:
    """How the noise of two gradients compares, and the standard error of that: by key, squared
    estimates ``(batches, entries)`` of gradients whose mean is zero.

    The geometric mean over entries of the ratio of mean squares, then over keys. Adam divides each
    entry by the root of its own mean square, so that each counts alike, and rare bright paths,
    which rule a plain mean, do not rule this one. Of entries that half of the batches meet, where
    there are any: the mean of a few squares among zeros is mostly too small, the more so the rarer
    they are, and what is met less often would look quieter. The error by the jackknife over blocks
    of batches."""
    count = min(_BLOCKS, *(len(next(iter(of.values()))) for of in (squares, usual)))
    blocks = [
        {
            key: np.array([part.sum(axis=0) for part in np.array_split(rows, count)])
            for key, rows in of.items()
        }
        for of in (squares, usual)
    ]

    often = {}
    for key in squares:
        met = np.minimum(*((of[key] > 0).mean(axis=0) for of in (squares, usual)))
        often[key] = met >= 0.5 if met.max() >= 0.5 else met > 0

    def ratio(left_out: int | None = None) -> float:
        logs = []
        for key, known in often.items():
            own, first = (
                (of[key].sum(axis=0) - (0 if left_out is None else of[key][left_out]))[known]
                for of in blocks
            )
            known = (own > 0) & (first > 0)  # a block may have had all that there was
            if known.any():
                logs.append(np.mean(np.log(own[known] / first[known])))
        return float(np.mean(logs)) if logs else float("nan")

    whole = ratio()
    left = np.array([ratio(i) for i in range(count)])
    error = np.sqrt((count - 1) / count * np.sum((left - left.mean()) ** 2))
    counts = [len(next(iter(of.values()))) for of in (squares, usual)]
    value = float(np.exp(whole)) * counts[1] / counts[0]
    return value, float(error) * value
