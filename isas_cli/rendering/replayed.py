"""Long paths: traced once for the radiance, and replayed for its derivatives."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi

from .light import by_chance, density_toward, gathered, mis_weight, sky_for
from .lobes import Lobes, scattered
from .roulette import chance, scaled

_ONCE = dr.ADFlag.ClearEdges | dr.ADFlag.ClearInterior


def handles(integrator) -> bool:
    """Whether ``trace`` estimates what this one does: surface paths with visible emitters."""
    return type(integrator).__name__ == "PRBIntegrator" and not integrator.hide_emitters


def trace(
    mode: dr.ADMode,
    scene: mi.Scene,
    sampler: mi.Sampler,
    ray: mi.Ray3f,
    max_depth: int | mi.UInt32,
    rr_depth: int,
    draws: tuple[int, int] = (1, 1),
    caustics: bool | mi.Bool = True,
    adjoint: mi.Spectrum | None = None,
    radiance: mi.Spectrum | None = None,
    lobes: Lobes | None = None,
) -> mi.Spectrum:
    """Path replay backpropagation (Vicini et al. 2021, Alg. 2) of surfaces that do not move.

    Mitsuba's ``prb`` also differentiates where vertices lie, which costs a second look at every
    surface and light; here materials and lights are all that is unknown. Values and derivatives
    agree with ``prb``'s path by path where ``draws`` is one, but for ``mis_weight``.

    ``mode``: Primal, Backward (adds ⟨adjoint, dL/dθ⟩ to the gradients) or Forward. ``radiance``: of
    the same paths, from a primal pass with the same random numbers. ``draws``: samples of emitters
    at the first vertex, and directions that each is picked from; at later ones it is one.
    ``caustics``: with the light of ``light.by_chance``. This and ``max_depth`` may be opaque, so
    that one kernel does for all. ``lobes``: of materials with discrete lobes whose parameters are
    differentiated by; a pass that is to be replayed needs the same. Returns the radiance, or in
    forward mode its derivative, ``(3, N)``. Traced.

    L: radiance so far; in a replay, what the path still brings; β: throughput so far; κ: by what
    roulette multiplies it.
    """
    primal = mode == dr.ADMode.Primal
    max_depth = mi.UInt32(max_depth)
    ray, sky = mi.Ray3f(dr.detach(ray)), sky_for(scene, math.prod(draws))
    hit = scene.ray_intersect_preliminary(ray, coherent=True, reorder=False, active=True)

    # Whether the path met a surface that scatters; only where that counts, as it costs registers.
    spread = (mi.Bool(False),) if caustics is not True else ()

    def vertex(
        L, found, β, κ, depth, active, hit, ray, previous, pdf, delta, spread, sampler, count, here
    ):
        """One vertex: what it emits and reflects. ``count``: directions drawn to lights at the
        one before; ``here``: ``draws`` of this one."""
        si = hit.compute_surface_interaction(ray, ray_flags=mi.RayFlags.All, active=active)
        bsdf = si.bsdf(ray)
        ds = mi.DirectionSample3f(scene, si=si, ref=previous)
        # The camera's vertex, and what a mirror shows, no light sample could have found.
        mis = mis_weight(pdf, count * density_toward(scene, sky, previous, ds, ~delta))
        on = active & si.is_valid() & (depth + 1 < max_depth)
        with dr.resume_grad(when=not primal):
            emitted = β * mis * ds.emitter.eval(si, active)
            if spread:
                left_out = by_chance(*spread, delta) & ~mi.Bool(caustics)
                emitted = dr.select(left_out, 0, emitted)
            reflected = gathered(scene, sky, sampler, si, bsdf, on, *here, not primal)
            own = emitted + dr.select(on, β * reflected, 0)
        L = L + own if primal else L - dr.detach(own)

        drawn = scattered(lobes, bsdf, si, sampler, on, not primal)
        if not primal:
            with dr.resume_grad():
                total = own + L * drawn.factor
                if mode == dr.ADMode.Backward:
                    # Paths too short to reach any unknown have no derivative.
                    if dr.grad_enabled(total):
                        dr.backward_from(adjoint * total)
                elif dr.grad_enabled(total):
                    # Tangents stay where they are: other vertices are traced after this one.
                    found = found + dr.forward_to(total, flags=_ONCE)

        β = β * drawn.used
        κ = scaled(κ, drawn.used, drawn.eta)
        lives = chance(β, κ)
        late = depth >= rr_depth
        on &= (dr.max(β) != 0) & (~late | (sampler.next_1d() < lives))
        β = dr.select(late, β * dr.rcp(lives), β)
        next_ray = si.spawn_ray(si.to_world(drawn.wo))
        hit = scene.ray_intersect_preliminary(next_ray, coherent=False, reorder=False, active=on)
        delta = drawn.delta
        previous = dr.detach(si, True)
        spread = tuple(each | ~delta for each in spread)
        after = on, hit, next_ray, previous, drawn.pdf, delta, spread, sampler
        return L, found, β, κ, depth + 1, *after

    state = (
        mi.Spectrum(0 if primal else radiance),
        mi.Spectrum(0),
        mi.Spectrum(1),
        mi.Float(1),
        mi.UInt32(0),
        mi.Bool(True),
        hit,
        ray,
        dr.zeros(mi.SurfaceInteraction3f),
        mi.Float(1),
        mi.Bool(True),
        spread,
        sampler,
    )
    count = mi.Float(1)
    if math.prod(draws) > 1:
        # Once outside the loop, where the number of light samples is another.
        state = vertex(*state, count, draws)
        count = mi.Float(math.prod(draws))
    *state, _ = dr.while_loop(
        (*state, count),
        lambda *s: s[5],
        lambda *s: (*vertex(*s, (1, 1)), mi.Float(1)),
        label=f"paths ({mode.name})",
    )
    return state[1] if mode == dr.ADMode.Forward else state[0]
