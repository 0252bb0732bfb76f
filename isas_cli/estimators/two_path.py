"""The two-path replay estimator of the loss gradient (ISAS Algorithm 1, stage 2)."""

from __future__ import annotations

import functools
import operator
from dataclasses import dataclass, replace
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from ..rendering import derivative_sampling, rays, undone
from ..rendering.kernels import recorded
from ..rendering.pixels import PixelDistribution
from ..runtime import streams
from ..runtime.errors import InputError
from ..scene.problem import Problem
from ..unknowns import cameras, exposure, smoothing
from ..unknowns.blur import Blur
from ..unknowns.exposure import Exposure
from .aside import Aside
from .estimator import Estimator, Gradients


@dataclass(frozen=True)
class Settings(Estimator):
    """``TwoPath``. ``crossed``: where that pays (``Integrator.crosses``);
    ``derivative_sampling``: see the module of that name in ``rendering``."""

    name: ClassVar[str] = "two_path"
    gives: ClassVar[frozenset[str]] = frozenset(("forward", "backward", "moments"))
    replays: ClassVar[bool] = True
    of_windows: ClassVar[bool] = True

    freeze: bool = True
    crossed: bool = True
    blurred: bool = False
    derivative_sampling: bool = False

    @property
    def whole(self) -> bool:
        return self.blurred

    @property
    def own_lights(self) -> bool:
        return self.derivative_sampling

    def differentiated(self, problem: Problem) -> Problem:
        if self.derivative_sampling:
            return derivative_sampling.sampled(problem)
        integrator = problem.integrator
        if self.crossed or not integrator.crosses:
            return problem
        one_way = integrator.cut(replace(integrator.paths, crossed=False))
        return replace(problem, integrator=one_way)

    def made(self, problem: Problem, loss) -> "TwoPath":
        return TwoPath(problem, loss, self.batch, self.freeze, blurred=self.blurred)

    def derivatives(self, problem: Problem) -> str:
        return problem.integrator.derivatives


class TwoPath(Gradients):
    """Estimates dℒ/dθ from N pixels drawn from any distribution, two independent paths a pixel.

    ISAS Eq. (4), averaged over N draws j_i ~ p:

        ⟨dℒ/dθ⟩ = 1/N Σ_i  ⟨∂ℒ/∂I⟩_{j_i} ⟨dI/dθ⟩_{j_i} / p_{j_i}

    The first path's radiance gives ⟨∂ℒ/∂I⟩ through the loss, a second, independent path gives
    ⟨dI/dθ⟩ as ``problem.integrator`` estimates it. One path for both would be biased for L2: its
    noise is correlated with itself. Where the integrator ``crosses`` the same is done the other way
    round as well, and the estimate is the mean of both: each path tells its radiance and its
    derivative anyway. With residuals r and derivatives J of two paths, of means μ, let V be the
    variance of r₁J₂ and c the covariance of a path's own r and J: that of (r₁J₂ + r₂J₁)/2 is
    (V + c² + 2 c μ_r μ_J)/2.

    By a photograph's exposure e, where I = k e L with a known k (``Views.given``), the derivative
    is ⟨∂ℒ/∂I⟩ k ⟨L⟩, with L from the other path, or from a third one where that does not tell it.
    By a camera's pose and lens it is a blurred difference, of two more paths
    (``unknowns.cameras``), and by numbers that Mitsuba does not differentiate by a plain one
    (``aside``).

    Of a loss of windows, a draw is the window around a pixel: all of its pixels have both paths.

    Symbols: N → ``batch`` (pixels a step; 2 N light paths, more with derivative sampling);
    p → ``PixelDistribution``; θ → ``problem.unknowns``, whose gradients receive the estimate.
    Bias: none for losses with linear derivative (``loss.linear``) and p > 0 wherever
    ∂ℒ/∂I · dI/dθ ≠ 0; other losses as their docstrings say. Visibility is not differentiated:
    unknowns that move geometry are refused, unless the integrator follows them (``moves``).
    Everything here is traced once and frozen (``dr.freeze``); ``params.update()`` stays outside,
    and the gradients are read outside, after the call.
    """

    def __init__(
        self, problem: Problem, loss, batch: int, freeze: bool = True, along=None, blurred=False
    ):
        """``along(integrator, scene, streams, rays, adjoints)``: what is done along both paths, for
        measurements; None for the integrator's ``pair``; ``adjoints`` takes ``finite=False`` to
        send back what is not finite as well. ``blurred``: as in ``Settings``.

        Raises InputError where an unknown moves objects."""
        if problem.unknowns.moving and not problem.integrator.moves:
            raise InputError(
                f"scene.unknowns: '{problem.unknowns.moving[0]}' moves objects, and path replay "
                "does not differentiate visibility: take estimator=silhouettes for meshes, or "
                "sampler=plateau (or the baselines sampler=mitsuba and sampler=finite_differences)"
            )
        windows = loss.windows
        drawn = batch
        if windows is not None:
            drawn = batch // windows.count
            if not drawn:
                raise InputError(
                    f"estimator.batch={batch}: less than the {windows.count} pixels of a window"
                )
            batch = drawn * windows.count
        self.problem, self.loss, self.batch = problem, loss, batch
        integrator = problem.integrator
        if missed := undone.missed(problem):
            raise InputError(undone.refusal(integrator, missed))
        exposed = problem.unknowns.of(Exposure)
        self._moved = cameras.unknown(problem.unknowns)
        moved = [(each.key, each.kind.field, each.kind.each) for each in self._moved]
        self.blur = Blur(problem, "estimator.blurred=true") if blurred else None
        self.blurs = blurred
        self._aside = Aside(problem, loss, batch, freeze)
        # Beside that whose derivative is counted.
        third = exposed is not None and not integrator.crosses
        self._paths = 1 + third + 2 * bool(moved)

        # Paths whose residual was not finite so far: without a count nobody would know.
        self._lost = [dr.opaque(mi.UInt32, 0)]
        # Opaque, or every batch would compile a kernel of its own.
        self._count = dr.opaque(mi.Float, drawn)

        def kernel(
            scene, sensors, views, leaves, distribution, targets, mask, seeds, share, count, lost,
            jitter,
        ):  # fmt: skip
            with dr.suspend_grad():
                view, column, row, probability = distribution.draw(drawn, seeds[0])
                if windows is not None:
                    dr.eval(view, column, row, probability)
                    view, column, row, window = windows.spread(views, view, column, row, drawn)
                    probability = dr.gather(mi.Float, probability, window)
                pixel = views.index(view, column, row)
                # Once for all kernels that follow: each would search the CDF again.
                dr.eval(view, column, row, pixel, probability)

                target = dr.gather(mi.Color3f, targets, pixel)
                scale = share / (probability * count)
                random = [rays.stream(seed, batch) for seed in seeds[1:3]]
                spawned, weights = zip(
                    *(rays.spawn(sensors, views, view, column, row, each) for each in random)
                )
                shown, residuals, missed = [], [], []

                def adjoints(radiances: list, finite: bool = True) -> list:
                    shown.extend(radiances)
                    for radiance, weight in zip(radiances, weights):
                        seen = radiance * weight
                        if windows is not None:
                            dr.eval(seen)
                        residual = rays.sound(loss.derivative(seen, target), seen)
                        residual = rays.masked(residual, mask, pixel, windows)
                        residuals.append(residual)
                        missed.append(~dr.all(dr.isfinite(residual)))
                    # One that is not finite would spoil the sums that gradients are, by its own
                    # derivative as well: a path along which nothing is sent back adds none.
                    if finite:
                        spoiled = functools.reduce(operator.or_, missed)
                        residuals[:] = [dr.select(spoiled, 0, each) for each in residuals]
                    # With the next kernel: counted in one of its own, the paths would be traced
                    # again.
                    dr.schedule(residuals, missed)
                    part = scale / len(residuals)
                    return [r * w * part for r, w in zip(residuals, reversed(weights))]

                done = along or type(integrator).pair
                done(integrator, scene, random, spawned, adjoints)
                residual = residuals[0]
                if exposed is not None:
                    if len(shown) < 2:
                        # A path of its own: the second one's radiance is inside the integrator.
                        third = rays.stream(seeds[3], batch)
                        ray, _ = rays.spawn(sensors, views, view, column, row, third)
                        shown.append(integrator.primal(scene, third, ray)[0])
                    # Not its own: what is noise in it is so in the residual as well.
                    slopes = [r * other for r, other in zip(residuals, reversed(shown))]
                    slope = sum(slopes[1:], slopes[0]) * (scale / len(slopes))
                    if views.given is not None:
                        slope *= dr.gather(mi.Color3f, views.given, view)
                    slope = dr.select(dr.all(dr.isfinite(slope)), slope, 0)
                    dr.eval(slope)
                    exposure.add(leaves[exposed.key], view, slope)
                if moved:
                    where = scene, sensors, views, (view, column, row)
                    placed = {field: at for (_, field, _), (_, at, _) in zip(moved, jitter)}
                    # A single view's number is one entry, not one for each pixel.
                    stream = seeds[4], batch
                    step = _half_difference(integrator, *where, stream, placed)
                    slope = dr.sum(residual * step) * scale
                    slope = dr.select(dr.isfinite(slope), slope, 0)
                    dr.eval(slope)
                    for (key, _, each), (offset, _, table) in zip(moved, jitter):
                        cameras.add(leaves[key], view, each, slope, offset, table)
                lost[0] += sum(dr.count(each) for each in missed)

        self._kernel = recorded(kernel, problem, freeze)

    @property
    def stages(self) -> tuple[float, ...]:
        """Shares of the budget at which kernels differ: differences begin where one first moves."""
        begins = min((unknown.during[0] for unknown in self._aside.unknowns), default=0.0)
        return (0.0, begins) if begins else (0.0,)

    @property
    def paths_per_step(self) -> int:
        """Light paths of one estimate, the latest."""
        paths = self._paths + self.problem.integrator.paths_per_derivative
        return paths * self.batch + self._aside.paths_per_step

    @property
    def nonfinite(self) -> int:
        """Paths so far whose residual was not finite. Waits for what was launched."""
        return int(self._lost[0][0]) + self._aside.nonfinite

    def estimate(self, values: dict, distribution, seed: int, iteration: int, spent: float) -> dict:
        """The gradient at ``values``, by key; where it is blurred, at values that are off by
        Gaussian offsets of the widths at the share ``spent`` of the budget, else the same at all.

        Without bias for ∂(κ ⋆ ℒ)/∂θ (PRDPT Eq. 8 in the space of the loss), with 0 outside an
        unknown's range, where values are clamped. Waits where it is blurred."""
        if self.blur is None:
            return self.gradients(values, distribution, seed, iteration, spent)
        θ = self.blur.vector(values)
        rng = np.random.default_rng(streams.seed(seed, iteration, "offset"))
        σ = self.blur.widths(θ, spent) * self.blur.moving(spent)
        at = θ + smoothing.blurred(σ, rng)
        found = self.gradients(self.blur.clamped(at), distribution, seed, iteration, spent)
        found = self.blur.vector(found)
        return self.blur.values(np.where(self.blur.inside(at), found, 0))

    def gradients(
        self,
        values: dict,
        distribution: PixelDistribution,
        seed: int,
        iteration: int,
        spent: float,
    ) -> dict:
        """The estimate at ``values``, by key, without blur."""
        drawn = distribution, seed, iteration
        sides = self._aside.sides(values, *drawn, spent)
        self.problem.unknowns.attach(values)
        aside = self._aside.gradients(sides, *drawn)
        self.accumulate(*drawn)
        return self.problem.unknowns.gradients() | aside

    def accumulate(self, distribution: PixelDistribution, seed: int, iteration: int) -> None:
        """Add what paths carry to the gradients of the unknowns' leaves (``Unknowns.attach``
        first)."""
        p, purposes = self.problem, ("draw", "primal", "adjoint", "exposure", "pose")
        given = distribution, p.targets, p.mask, rays.seeds(seed, iteration, *purposes)
        jitter = self._jitter(seed, iteration)
        self._kernel(*p.traced, *given, p.share, self._count, self._lost, jitter)

    def _jitter(self, seed: int, iteration: int) -> list[tuple[mi.Float, mi.Float, mi.Int]]:
        """Offsets of the cameras, of each kind of numbers independent ones."""
        drawn = streams.seed(seed, iteration, "pose_offset")
        return [each.kind.offsets([drawn, n]) for n, each in enumerate(self._moved)]


def _half_difference(integrator, scene, sensors, views, place, drawn, offsets: dict) -> mi.Color3f:
    """Half of what the drawn pixels' radiance differs by with all cameras changed by ``offsets``,
    by their field of ``views``, and against them, along paths of the same random numbers;
    ``drawn``: their seed, and how many pixels there are. Evaluates."""
    sides = []
    for sign in (1, -1):
        stream = rays.stream(*drawn)
        moved = {field: getattr(views, field) + at * sign for field, at in offsets.items()}
        there = replace(views, **moved)
        sides.append(rays.radiance(integrator, scene, sensors, there, place, stream))
        dr.eval(sides[-1])
    return (sides[0] - sides[1]) / 2
