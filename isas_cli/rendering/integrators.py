"""One face for all integrators: radiance of paths along given rays, and their derivatives.

Everything that traces goes through an ``Integrator`` of this module, which says what it can do:

- ``primal``: radiance of one path per ray;
- ``backward``: adds ⟨adjoint, dL/dθ⟩ to the gradients of the scene;
- ``pair``: the same with adjoints from the radiance of another path of the same pixels;
- ``forward``: the derivative along a tangent, where ``has_forward``;
- ``work``: what a path's time grows with;
- ``simulates``: the effects that its paths have: 'surfaces', 'media';
- ``cut``: the same with other ``Paths``, shorter or with more light samples, where it can have
  them (``cuts``); ``deep``: with depths that only the traced program knows.

The order of events matters, so it is kept in one place: a replay must see the random numbers of
the primal pass again (the sampler is cloned before it), nothing may track derivatives but the
integrator itself, and results are evaluated before anyone reduces them (otherwise each channel's
reduction renders again).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..runtime.errors import InputError
from ..unknowns.ranges import only_emits
from . import attached, replayed, volume
from .lobes import Lobes, touched

# Mitsuba's class → what it simulates, and whether it differentiates in forward mode.
_REPLAYED = {
    "PRBIntegrator": (("surfaces",), True),
    "PRBVolpathIntegrator": (("surfaces", "media"), False),
    "Emission": (("media",), True),
}


# Points of a path at which its work is counted: beyond, the mean path of any scene has ended.
_MOST_VERTICES = 8


class Integrator:
    """Path replay backpropagation by an integrator of Mitsuba's, ``mitsuba``.

    ``moves``: whether derivatives by what moves surfaces are among its own, silhouettes left out.
    ``samples_lights``: whether light is sampled where a path scatters. ``crosses``: whether both
    paths of a ``pair`` are differentiated.
    ``lobes``: of materials whose parameters are unknown; ``misses``: keys of unknowns whose
    derivative is wrong, as Mitsuba does not take these lobes apart.
    ``max_depth``: edges of the longest path (2^32 - 1: no limit); ``paths_per_derivative``: light
    paths behind one estimate of a pixel's derivative.
    """

    paths_per_derivative = 1
    derivatives = "path replay backpropagation"
    cuts = False
    moves = False
    samples_lights = True
    crosses = False
    # Whether it is none that traces paths, but another renderer's pictures (``black_box``).
    black_box = False

    lobes: Lobes | None = None
    misses: tuple[str, ...] = ()

    def __init__(self, base: mi.Integrator):
        self.mitsuba = base
        self.simulates, self.has_forward = _REPLAYED[type(base).__name__]
        self.max_depth, self.rr_depth = base.max_depth, base.rr_depth
        self.hide_emitters = base.hide_emitters
        self.paths = Paths(self.max_depth, self.max_depth)

    @property
    def name(self) -> str:
        """Mitsuba's name of the class that renders."""
        return type(self.mitsuba).__name__

    def primal(self, scene, sampler, ray) -> tuple[mi.Color3f, mi.Color3f]:
        """Radiance of one path per ray, and the state that a replay of the same paths needs."""
        return self._sample(dr.ADMode.Primal, scene, sampler, ray)

    def backward(self, scene, sampler, ray, adjoint: mi.Color3f) -> None:
        """Trace one path per ray and add ⟨adjoint, dL/dθ⟩ to the gradients of the scene.

        ``adjoint (3, N)``: ∂ℒ/∂L per path, importance weights included.
        """
        replayed = sampler.clone()
        _, state = self.primal(scene, sampler, ray)
        dr.eval(adjoint, state)
        self._sample(dr.ADMode.Backward, scene, replayed, ray, adjoint, state)

    def pair(self, scene, samplers, rays, adjoints, mode=dr.ADMode.Backward) -> None:
        """Trace two independent paths of every pixel, along ``rays``, and add to the gradients of
        the scene ⟨adjoint, dL/dθ⟩ along the second, with the adjoint that the first one's radiance
        makes; where it ``crosses``, as well along the first, with the second one's.

        ``adjoints``: of radiances ``(3, N)``, of the first path or of both, makes as many
        ``(3, N)``: for the second path, and for the first. ``mode``: Forward for measurements,
        where derivatives along a tangent are evaluated and forgotten.
        """
        (adjoint,) = adjoints(self.radiances(scene, samplers, rays))
        if mode == dr.ADMode.Backward:
            self.backward(scene, samplers[1], rays[1], adjoint)
        else:
            dr.schedule(adjoint)  # evaluated with what comes next, as in a step
            self.forward(scene, samplers[1], rays[1])

    def radiances(self, scene, samplers, rays) -> list[mi.Color3f]:
        """Of a ``pair``, those that adjoints are made from."""
        paths = list(zip(samplers, rays))[: 1 + self.crosses]
        return [self.primal(scene, *path)[0] for path in paths]

    def forward(self, scene, sampler, ray) -> mi.Color3f:
        """Directional derivative of each path's radiance, ``(3, N)``; only where ``has_forward``.

        The direction is the tangent that was pushed into the scene's parameters beforehand
        (``Unknowns.push_tangent``). The result counts a parameter that a path meets at several
        bounces once per meeting, summed before anything is squared.
        """
        replayed = sampler.clone()
        _, state = self.primal(scene, sampler, ray)
        dr.eval(state)
        derivative, _ = self._sample(dr.ADMode.Forward, scene, replayed, ray, None, state)
        dr.eval(derivative)
        return derivative

    def work(self, scene, sampler, ray) -> mi.Float:
        """Surface points of each path at which light is gathered: there it samples an emitter,
        traces a shadow ray, evaluates the BSDF and samples where to go on, which is what its time
        grows with. Followed without Russian roulette, up to eight points. Traced."""
        met, active = dr.zeros(mi.Float, dr.width(ray.o)), mi.Bool(True)
        # The last edge of a path of greatest length only looks for emitters.
        for _ in range(min(self.max_depth - 1, _MOST_VERTICES)):
            si = scene.ray_intersect(ray, active)
            active &= si.is_valid()
            met += dr.select(active, mi.Float(1), 0)
            sample, weight = si.bsdf(ray).sample(
                mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), active
            )
            active &= dr.max(weight) > 0
            ray = si.spawn_ray(si.to_world(sample.wo))
        return met

    def _sample(self, mode, scene, sampler, ray, *replay):
        try:
            return sampled(self.mitsuba, mode, scene, sampler, ray, *replay)
        except RuntimeError as error:
            # Paths that read no unknown have no derivative.
            if not unattached(error):
                raise
            return dr.zeros(mi.Color3f, dr.width(ray.o)), None


def sampled(integrator: mi.Integrator, mode, scene, sampler, ray, adjoint=None, state=None):
    """Radiance, or its derivative, by one of Mitsuba's integrators, and the state of a replay."""
    radiance, _, _, state = integrator.sample(
        mode=mode,
        scene=scene,
        sampler=sampler,
        ray=ray,
        depth=mi.UInt32(0),
        δL=adjoint,
        δaovs=None,
        state_in=state,
        active=mi.Bool(True),
    )
    return radiance, state


def unattached(error: BaseException) -> bool:
    """Whether Mitsuba found that nothing which its paths meet has a derivative by an unknown."""
    return "not attached to the AD graph" in str(root(error))


def root(error: BaseException) -> BaseException:
    """What was raised first in a chain of errors."""
    while error.__cause__ is not None:
        error = error.__cause__
    return error


class InOneGo(Integrator):
    """Derivatives of what ``radiance`` computes with derivatives attached, without a replay.

    ``radiance(scene, sampler, ray)`` is called with derivatives on (``dr.resume_grad``).
    """

    def radiance(self, scene, sampler, ray) -> mi.Spectrum:
        raise NotImplementedError

    def backward(self, scene, sampler, ray, adjoint: mi.Color3f) -> None:
        with dr.resume_grad():
            radiance = self.radiance(scene, sampler, ray)
            # Paths too short to reach any unknown have no derivative.
            if dr.grad_enabled(radiance):
                dr.backward_from(adjoint * radiance)

    def forward(self, scene, sampler, ray) -> mi.Color3f:
        derivative = dr.zeros(mi.Color3f, dr.width(ray.o))
        with dr.resume_grad():
            radiance = self.radiance(scene, sampler, ray)
            if dr.grad_enabled(radiance):
                derivative = mi.Color3f(dr.forward_to(radiance))
        dr.eval(derivative)
        return derivative


@dataclass(frozen=True)
class Paths:
    """``depth``: edges of the longest path that brings radiance; ``derivative``: of the longest
    that is differentiated, at most ``depth``; ``lights``: samples of emitters at the first vertex,
    in a primal pass and in one that differentiates (one at later vertices); ``roulette``: vertices
    after which Russian roulette ends paths (None: as the scene's integrator has it);
    ``caustics``: with light that only chance finds (``light.by_chance``);
    ``crossed``: whether a ``pair`` may differentiate both of its paths; ``directions``: that each
    of ``lights`` is picked from."""

    depth: int
    derivative: int
    lights: tuple[int, int] = (1, 1)
    roulette: int | None = None
    caustics: bool | mi.Bool = True
    crossed: bool = True
    directions: int = 1

    def draws(self, differentiated: bool) -> tuple[int, int]:
        """Light samples at the first vertex, and directions that each is picked from."""
        return self.lights[differentiated], self.directions


class Surfaces(Integrator):
    """Paths between surfaces that do not move, by isas's own estimators, as ``paths`` says: what
    ``Unrolled`` and ``Replayed`` share."""

    cuts = True

    def __init__(self, base: mi.Integrator, paths: Paths, lobes: Lobes | None = None):
        super().__init__(base)
        self.paths, self.max_depth, self.lobes = paths, paths.depth, lobes
        self.rr_depth = _roulette(base, paths)

    def cut(self, paths: Paths) -> "Integrator":
        return _surfaces(self.mitsuba, paths, self.lobes)

    def deep(self, paths: Paths) -> "Integrator":
        return Replayed(self.mitsuba, paths, self.lobes)


class Unrolled(Surfaces, InOneGo):
    """Short paths, unrolled (``attached``)."""

    derivatives = "short paths unrolled and differentiated in one go"

    def __init__(self, base: mi.Integrator, paths: Paths, lobes: Lobes | None = None):
        super().__init__(base, paths, lobes)
        self.crosses = paths.crossed and paths.lights[0] == paths.lights[1]

    def primal(self, scene, sampler, ray) -> tuple[mi.Color3f, None]:
        own = self.paths.depth, self.rr_depth, self.paths.draws(False), self.paths.caustics
        return attached.radiance(scene, sampler, ray, *own, 0), None

    def pair(self, scene, samplers, rays, adjoints, mode=dr.ADMode.Backward) -> None:
        if not self.crosses:
            return super().pair(scene, samplers, rays, adjoints, mode)
        paths = self.paths
        whole = paths.depth, self.rr_depth, paths.draws(False), paths.caustics, paths.derivative
        with dr.resume_grad():
            found = [
                attached.radiance(scene, *path, *whole, self.lobes) for path in zip(samplers, rays)
            ]
            with dr.suspend_grad():
                weights = adjoints([dr.detach(radiance) for radiance in found])
            total = weights[1] * found[0] + weights[0] * found[1]
            if dr.grad_enabled(total) and mode == dr.ADMode.Backward:
                dr.backward_from(total)
            elif dr.grad_enabled(total):
                dr.eval(dr.forward_to(total))

    def radiance(self, scene, sampler, ray) -> mi.Spectrum:
        own = self.paths.derivative, self.rr_depth, self.paths.draws(True), self.paths.caustics
        return attached.radiance(scene, sampler, ray, *own, lobes=self.lobes)


class Twice(Integrator):
    """Derivatives by a second pass along the paths of a first one, as ``once`` traces them."""

    def once(self, mode, scene, sampler, ray, differentiated, *more) -> mi.Spectrum:
        """``differentiated``: whether for a derivative; ``more``: adjoint, radiance."""
        raise NotImplementedError

    def primal(self, scene, sampler, ray) -> tuple[mi.Color3f, None]:
        return self.once(dr.ADMode.Primal, scene, sampler, ray, False), None

    def backward(self, scene, sampler, ray, adjoint: mi.Color3f) -> None:
        self._twice(dr.ADMode.Backward, scene, sampler, ray, adjoint)

    def forward(self, scene, sampler, ray) -> mi.Color3f:
        derivative = self._twice(dr.ADMode.Forward, scene, sampler, ray)
        dr.eval(derivative)
        return derivative

    def _twice(self, mode, scene, sampler, ray, adjoint=None):
        again = sampler.clone()
        radiance = self.once(dr.ADMode.Primal, scene, sampler, ray, True)
        dr.eval(adjoint, radiance)
        return self.once(mode, scene, again, ray, True, adjoint, radiance)


class Replayed(Surfaces, Twice):
    """Long paths, replayed (``replayed``)."""

    def once(self, mode, scene, sampler, ray, differentiated, *more):
        depth = self.paths.derivative if differentiated else self.paths.depth
        own = depth, self.rr_depth, self.paths.draws(differentiated), self.paths.caustics
        lobes = self.lobes if differentiated else None
        return replayed.trace(mode, scene, sampler, ray, *own, *more, lobes=lobes)


class Mixed(Surfaces):
    """Long paths for the radiance, of which only a short beginning is differentiated."""

    derivatives = Unrolled.derivatives

    def __init__(self, base: mi.Integrator, paths: Paths, lobes: Lobes | None = None):
        super().__init__(base, paths, lobes)
        self._long, self._short = (kind(base, paths, lobes) for kind in (Replayed, Unrolled))
        self.primal = self._long.primal
        self.backward, self.forward = self._short.backward, self._short.forward


class Medium(Twice):
    """Paths through one medium and nothing else, by isas's own estimators (``volume``), which
    differentiate forwards as well."""

    derivatives = "path replay through the medium"
    samples_lights = False

    def __init__(self, base: mi.Integrator, medium: mi.Medium, paths: Paths | None = None):
        super().__init__(base)
        self.medium, self.has_forward = medium, True
        self.emits = only_emits(base)
        self.cuts = not self.emits
        self.paths = paths or self.paths
        self.max_depth, self.rr_depth = self.paths.depth, _roulette(base, self.paths)
        # As far as is known before a kernel runs. Without scattering a second replay costs more
        # than its derivative is worth (benchmarks/crossed.py).
        whole = isinstance(self.paths.depth, int) and self.paths.depth == self.paths.derivative
        self.crosses = self.paths.crossed and whole and not self.emits

    def cut(self, paths: Paths) -> "Integrator":
        return Medium(self.mitsuba, self.medium, paths)

    deep = cut

    def once(self, mode, scene, sampler, ray, differentiated, *more):
        depth = self.paths.derivative if differentiated else self.paths.depth
        return self._traced(mode, scene, sampler, ray, depth, *more)[0]

    def _traced(self, mode, scene, sampler, ray, depth, *more) -> tuple[mi.Spectrum, mi.UInt32]:
        if self.emits:
            return volume.emitted(mode, scene, self.medium, sampler, ray, *more)
        depths = depth, self.rr_depth
        return volume.trace(mode, scene, self.medium, sampler, ray, *depths, *more)

    def pair(self, scene, samplers, rays, adjoints, mode=dr.ADMode.Backward) -> None:
        if not self.crosses:
            return super().pair(scene, samplers, rays, adjoints, mode)
        again = [sampler.clone() for sampler in samplers]
        found = self.radiances(scene, samplers, rays)
        weights = adjoints(found)
        dr.eval(weights, found)
        for path, weight, radiance in zip(zip(again, rays), reversed(weights), found):
            derivative = self.once(mode, scene, *path, True, weight, radiance)
            if mode == dr.ADMode.Forward:
                dr.eval(derivative)

    def work(self, scene, sampler, ray) -> mi.Float:
        """Collisions of each path, real or not: at how many places it looks a density up, which
        is what its time grows with. Traced."""
        return mi.Float(self._traced(dr.ADMode.Primal, scene, sampler, ray, self.max_depth)[1])


def adapt(
    base: mi.Integrator | None,
    where: str = "the scene",
    scene: mi.Scene | None = None,
    keys: Iterable[str] = (),
) -> Integrator:
    """The face of a Mitsuba integrator, for ``scene`` where that is one's own to choose. ``keys``:
    of the scene's parameters that are unknown. Raises InputError, naming ``where``, for one whose
    paths cannot be replayed here, and for a material that cannot be taken apart (``lobes``)."""
    if type(base).__name__ not in _REPLAYED:
        named = "no integrator" if base is None else f"the integrator {base.class_name()}"
        raise InputError(
            f"{where} has {named}, and paths are replayed by prb (surfaces), prbvolpath or "
            "emission (media): give it one of these"
        )
    if getattr(base, "strange", None):
        raise InputError(
            f"{where}: the integrator emission has no {base.strange[0]}, as nothing scatters: "
            "leave it out"
        )
    keys, medium = tuple(keys), None
    if scene is not None and not base.hide_emitters:
        medium = volume.medium_of(scene, keys, scatters=not only_emits(base))
    if "media" in _REPLAYED[type(base).__name__][0] and medium is not None:
        return Medium(base, medium)
    if only_emits(base):
        raise InputError(
            f"{where}: the integrator emission is for one medium in a cube or sphere without a "
            "surface, of normals that point outwards (a to_world that mirrors turns a cube's), "
            "which the extinction's volume fills and where it is alike in all channels, under a "
            "sky, and nothing else"
        )
    lobes = touched(mi.traverse(scene), keys) if keys else None
    if replayed.handles(base):
        return _surfaces(base, Paths(base.max_depth, base.max_depth), lobes)
    found = Integrator(base)
    found.misses = lobes.keys if lobes else ()
    return found


def _roulette(base: mi.Integrator, paths: Paths) -> int:
    return base.rr_depth if paths.roulette is None else paths.roulette


def _surfaces(base: mi.Integrator, paths: Paths, lobes: Lobes | None) -> Surfaces:
    primal, derivative = (attached.handles(each) for each in (paths.depth, paths.derivative))
    return (Unrolled if primal else Mixed if derivative else Replayed)(base, paths, lobes)
