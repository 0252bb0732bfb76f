"""Short paths, unrolled: radiance, and derivatives in one go, without a replay."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi

from .light import by_chance, density_toward, gathered, mis_weight, sky_for
from .lobes import Lobes, scattered
from .roulette import chance, scaled

# Paths up to this many edges are unrolled. Longer ones would cost compile time.
LONGEST = 8


def handles(max_depth: int) -> bool:
    """Whether paths are short enough to unroll."""
    return 1 <= max_depth <= LONGEST


def radiance(
    scene: mi.Scene,
    sampler: mi.Sampler,
    ray: mi.Ray3f,
    max_depth: int,
    rr_depth: int,
    draws: tuple[int, int] = (1, 1),
    caustics: bool = True,
    differentiated: int | None = None,
    lobes: Lobes | None = None,
) -> mi.Spectrum:
    """Radiance of one path per ray, the derivative by materials and lights attached.

    The estimator of path replay backpropagation (Vicini et al. 2021): next-event estimation,
    detached sampling, attached BSDF and emitter values. PRB traces every path twice, first for
    the radiance that each vertex passes on and then for the derivatives, because memory for a
    long path's graph is dear. Unrolled, a short path's graph lives in registers and every ray is
    traced once; values and derivatives agree with ``prb`` path by path, but for ``mis_weight``.

    ``draws``: samples of emitters at the first vertex, and directions that each is picked from; at
    later ones it is one. ``caustics``: with the light of ``light.by_chance``.
    ``differentiated``: edges of the longest paths whose derivatives are attached (None: all; 0: the
    radiance alone): call it with derivatives on (``dr.resume_grad``) and propagate from or to the
    result. Geometry is not differentiated. ``lobes``: of materials with discrete lobes whose
    parameters are differentiated by. Traced.

    β: throughput so far, with the derivatives of all earlier BSDF values; L: radiance so far;
    used: β as far as where paths go on is concerned, above 0 where only a derivative is left; κ: by
    what roulette multiplies that.
    """
    L, β, κ = mi.Spectrum(0), mi.Spectrum(1), mi.Float(1)
    sky = sky_for(scene, math.prod(draws))
    active, delta = mi.Bool(True), mi.Bool(True)
    spread, used = mi.Bool(False), mi.Spectrum(1)
    pdf, count = mi.Float(1), 1
    differentiated = max_depth if differentiated is None else differentiated
    previous = dr.zeros(mi.SurfaceInteraction3f)
    with dr.suspend_grad():
        ray = mi.Ray3f(ray)
        hit = scene.ray_intersect_preliminary(ray, coherent=True, reorder=False, active=active)

    for depth in range(max_depth):
        # ---------------------- Direct emission ----------------------
        with dr.suspend_grad():
            si = hit.compute_surface_interaction(ray, ray_flags=mi.RayFlags.All, active=active)
            bsdf = si.bsdf(ray)
            ds = mi.DirectionSample3f(scene, si=si, ref=previous)
            mis = mi.Float(1)  # nothing else could have sampled what the camera sees
            if depth > 0:
                of_light = density_toward(scene, sky, previous, ds, ~delta)
                mis = mis_weight(pdf, count * of_light)
        with dr.suspend_grad(when=depth + 1 > differentiated):
            emitted = β * mis * ds.emitter.eval(si, active)
        L += emitted if caustics else dr.select(by_chance(spread, delta), 0, emitted)
        active &= si.is_valid()
        if depth + 1 == max_depth:
            break

        # ---------------------- Emitter sampling ----------------------
        samples = draws if depth == 0 else (1, 1)
        count = math.prod(samples)
        attach = depth + 2 <= differentiated
        β = β if attach else dr.detach(β)
        with dr.suspend_grad(when=not attach):
            lit = β * gathered(scene, sky, sampler, si, bsdf, active, *samples, attach)
        L += dr.select(active, lit, 0)

        # ------------------ Detached BSDF sampling -------------------
        with dr.suspend_grad():
            drawn = scattered(lobes if differentiated else None, bsdf, si, sampler, active, attach)
            next_ray = si.spawn_ray(si.to_world(drawn.wo))
            κ = scaled(κ, drawn.used, drawn.eta)
            used *= drawn.used
            active &= dr.max(used) != 0
            # Used or not: the stream stays in step with prb's.
            number, survival = sampler.next_1d(), mi.Float(1)
            if depth >= rr_depth:
                lives = chance(used, κ)
                active &= number < lives
                survival = dr.select(active, dr.rcp(lives), 0)
                used *= survival
        β *= drawn.weight * survival + drawn.used * survival * (drawn.factor - 1)

        with dr.suspend_grad():
            previous, pdf, ray = si, drawn.pdf, next_ray
            delta = drawn.delta
            spread |= ~delta
            hit = scene.ray_intersect_preliminary(ray, coherent=False, reorder=False, active=active)
    return L
