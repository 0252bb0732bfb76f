"""Light that emitters send to a surface point, by several stratified samples."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi


def mis_weight(a: mi.Float, b: mi.Float) -> mi.Float:
    """Balance heuristic (Veach 1995) of two densities, each times the number of its samples.

    Mitsuba has the power heuristic; benchmarks/sharing.py compares them."""
    w = a / (a + b)
    return dr.select(dr.isfinite(w), w, 0)


def shapes_with(scene: mi.Scene, *flags: str) -> list[str]:
    """The names of shapes whose BSDF has one of ``flags``, names of ``mi.BSDFFlags``."""
    wanted = [getattr(mi.BSDFFlags, flag) for flag in flags]
    bsdfs = ((shape.id(), shape.bsdf()) for shape in scene.shapes())
    own = ((name, bsdf.flags()) for name, bsdf in bsdfs if bsdf is not None)
    return [name for name, found in own if any(mi.has_flag(found, flag) for flag in wanted)]


def by_chance(scattered: mi.Bool, delta: mi.Bool) -> mi.Bool:
    """Whether a path met a light as only chance finds it: by a mirror or clear glass (``delta``)
    after a surface that scatters, as in a caustic. Light samples do not go through them."""
    return scattered & delta


def stratum(point: mi.Point2f, index: int, count: int) -> mi.Point2f:
    """A uniform ``point`` of the unit square, moved into one of ``count`` equal parts of it, which
    are as nearly square as rows of equal length allow. Traced."""
    rows = max(d for d in range(1, math.isqrt(count) + 1) if count % d == 0)
    columns = count // rows
    return mi.Point2f((index % columns + point.x) / columns, (index // columns + point.y) / rows)


def gathered(
    scene: mi.Scene,
    sampler: mi.Sampler,
    si: mi.SurfaceInteraction3f,
    bsdf: mi.BSDFPtr,
    active: mi.Bool,
    count: int,
    attach: bool,
) -> mi.Spectrum:
    """BSDF × radiance at ``si``, from ``count`` samples of emitters that share the work with one
    sample of the BSDF: a direction counts by ``mis_weight(count p_emitter, p_BSDF)`` / ``count``.

    The samples are stratified: each is uniform over a part of its own, so that their mean is
    unbiased whatever ``count``. ``attach``: with the derivatives of BSDF and emitters (on, as by
    ``dr.resume_grad``); directions are detached. Traced.
    """
    total = mi.Spectrum(0)
    context = mi.BSDFContext()
    smooth = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    for index in range(count):
        with dr.suspend_grad():
            point = stratum(sampler.next_2d(), index, count)
            ds, emitted = scene.sample_emitter_direction(si, point, True, smooth)
            lit = smooth & (ds.pdf != 0)
            wo = si.to_local(ds.d)
        if attach:
            again = scene.eval_emitter_direction(si, ds, lit)
            emitted = dr.replace_grad(emitted, again * dr.select(lit, dr.rcp(ds.pdf), 0))
        value, pdf = bsdf.eval_pdf(context, si, wo, lit)
        weight = dr.select(ds.delta, 1, mis_weight(count * ds.pdf, dr.detach(pdf)))
        total += dr.select(lit, weight * value * emitted, 0)
    return total * (1 / count) if count > 1 else total
