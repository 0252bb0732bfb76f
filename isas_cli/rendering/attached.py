"""Short paths differentiated in one go, without a replay."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

# Paths up to this many edges are unrolled. Longer ones would cost compile time, and Russian
# roulette, which starts at depth 5, is not unrolled.
LONGEST = 5


def handles(integrator) -> bool:
    """Whether ``radiance`` estimates what this integrator does: surface paths short enough to
    unroll and to need no roulette, with emitters visible."""
    return (
        type(integrator).__name__ == "PRBIntegrator"
        and 1 <= integrator.max_depth <= min(LONGEST, integrator.rr_depth)
        and not integrator.hide_emitters
    )


def mis_weight(a: mi.Float, b: mi.Float) -> mi.Float:
    """Power heuristic of two densities."""
    a, b = dr.square(a), dr.square(b)
    w = a / (a + b)
    return dr.select(dr.isfinite(w), w, 0)


def radiance(scene: mi.Scene, sampler: mi.Sampler, ray: mi.Ray3f, max_depth: int) -> mi.Spectrum:
    """Radiance of one path per ray, its derivative with respect to materials and lights attached.

    The estimator of path replay backpropagation (Vicini et al. 2021): next-event estimation,
    detached sampling, attached BSDF and emitter values. PRB traces every path twice, first for
    the radiance that each vertex passes on and then for the derivatives, because memory for a
    long path's graph is dear. Unrolled, a short path's graph lives in registers and every ray is
    traced once; values and derivatives agree with ``prb`` path by path.

    Call it with derivatives on (``dr.resume_grad``) and propagate from or to the result. Geometry
    is not differentiated. Traced.

    β: throughput so far, with the derivatives of all earlier BSDF values; L: radiance so far.
    """
    context = mi.BSDFContext()
    L, β = mi.Spectrum(0), mi.Spectrum(1)
    active, delta = mi.Bool(True), mi.Bool(True)
    pdf = mi.Float(1)
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
                mis = mis_weight(pdf, scene.pdf_emitter_direction(previous, ds, ~delta))
        L += β * mis * ds.emitter.eval(si, active)
        active &= si.is_valid()
        if depth + 1 == max_depth:
            break

        # ---------------------- Emitter sampling ----------------------
        with dr.suspend_grad():
            lit = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            ds, emitted = scene.sample_emitter_direction(si, sampler.next_2d(), True, lit)
            lit &= ds.pdf != 0
            wo = si.to_local(ds.d)
        emitted_again = scene.eval_emitter_direction(si, ds, lit)
        inverse = dr.select(ds.pdf != 0, dr.rcp(ds.pdf), 0)
        emitted = dr.replace_grad(emitted, emitted_again * inverse)
        value, value_pdf = bsdf.eval_pdf(context, si, wo, lit)
        mis = dr.select(ds.delta, 1, mis_weight(ds.pdf, dr.detach(value_pdf)))
        L += dr.select(lit, β * mis * value * emitted, 0)

        # ------------------ Detached BSDF sampling -------------------
        with dr.suspend_grad():
            sample, weight = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
            # The roulette's number, unused: the stream stays in step with prb's.
            sampler.next_1d()
            next_ray = si.spawn_ray(si.to_world(sample.wo))
            active &= dr.any(dr.detach(β) * weight != 0)
        # The sampled weight, with the derivative of the BSDF's value.
        β *= weight * dr.relative_grad(bsdf.eval(context, si, sample.wo, active))

        with dr.suspend_grad():
            previous, pdf, ray = si, sample.pdf, next_ray
            delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
            hit = scene.ray_intersect_preliminary(ray, coherent=False, reorder=False, active=active)
    return L
