"""Light that emitters send to a surface point, by several stratified samples."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..unknowns import routes
from .sky import Sky, of_map

# How often one of several directions is picked by what they bring, instead of by chance alone.
_SURE = 0.9


def mis_weight(a: mi.Float, b: mi.Float) -> mi.Float:
    """Balance heuristic (Veach 1995) of two densities, each times the number of its samples.

    Mitsuba has the power heuristic; benchmarks/sharing.py compares them."""
    w = a / (a + b)
    return dr.select(dr.isfinite(w), w, 0)


def every_shape(scene: mi.Scene) -> list[mi.Shape]:
    """Also those in groups, which instances show; some of them twice."""
    grouped = (each for each in mi.traverse(scene).hierarchy if isinstance(each, mi.Shape))
    return [*scene.shapes(), *grouped]


def shapes_with(scene: mi.Scene, *flags: str) -> list[str]:
    """The names of shapes whose BSDF has one of ``flags``, names of ``mi.BSDFFlags``; also of those
    in groups."""
    wanted = [getattr(mi.BSDFFlags, flag) for flag in flags]
    bsdfs = ((shape.id(), shape.bsdf()) for shape in every_shape(scene))
    own = ((name, routes.flags(bsdf)) for name, bsdf in bsdfs if bsdf is not None)
    found = (name for name, has in own if any(mi.has_flag(has, flag) for flag in wanted))
    return list(dict.fromkeys(found))


def by_chance(scattered: mi.Bool, delta: mi.Bool) -> mi.Bool:
    """Whether a path met a light as only chance finds it: by a mirror or clear glass (``delta``)
    after a surface that scatters, as in a caustic. Light samples do not go through them."""
    return scattered & delta


def toward(
    scene: mi.Scene,
    sky: Sky | None,
    sampler: mi.Sampler,
    si: mi.SurfaceInteraction3f,
    active: mi.Bool,
    part: tuple[int, int],
    within: tuple[int, int] = (0, 1),
) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
    """A direction from ``si`` to an emitter, and its radiance over its density, whatever is in its
    way. Uniform over a part of all that can be drawn, ``(number, count)`` of equal ones, and within
    that over a part of it. By ``sky``, if given, else as Mitsuba draws it. Traced."""
    point, (number, parts), (inner, count) = sampler.next_2d(), part, within
    if sky is None:
        # The first number chooses between emitters: each part is of few of them.
        point = mi.Point2f((number + point.x) / parts, (inner + point.y) / count)
        return scene.sample_emitter_direction(si, point, False, active)
    ds = dr.zeros(mi.DirectionSample3f)
    # The first number runs through neighbours, the second is one's place in a rectangle.
    ds.d, ds.pdf = sky.draw(mi.Point2f((number + (inner + point.x) / count) / parts, point.y))
    there = dr.zeros(mi.SurfaceInteraction3f)
    there.wi = -ds.d
    # Without a mask, as a GPU can record it: see ``volume._coefficients``.
    return ds, scene.environment().eval(there) / ds.pdf


def _hidden(
    scene: mi.Scene,
    sky: Sky | None,
    si: mi.SurfaceInteraction3f,
    ds: mi.DirectionSample3f,
    active: mi.Bool,
) -> mi.Bool:
    """Whether something is in the way of a direction that ``toward`` gave."""
    ray = si.spawn_ray_to(ds.p) if sky is None else si.spawn_ray(ds.d)
    return scene.ray_test(ray, active)


def density_toward(
    scene: mi.Scene,
    sky: Sky | None,
    previous: mi.SurfaceInteraction3f,
    ds: mi.DirectionSample3f,
    active: mi.Bool,
) -> mi.Float:
    """Of ``toward`` at ``previous``, by solid angle, for what a path met. Traced."""
    if sky is None:
        return scene.pdf_emitter_direction(previous, ds, active)
    return sky.pdf(ds.d, active)


def prepare(scene: mi.Scene, stays: bool) -> None:
    """Let directions to the map of ``scene``'s sky be drawn as ``sky`` does it, where it is the
    only light and ``sky_for`` says so; ``stays``: whether the light is as it was loaded."""
    if scene.integrator() is not None:
        # It lies with the integrator: frozen kernels take what hangs on the scene as inputs, and
        # Mitsuba's C++ objects cannot hold it.
        scene.integrator().sky = of_map(scene) if stays else None


def sky_for(scene: mi.Scene, drawn: int) -> Sky | None:
    """By what directions to lights are drawn, if not as Mitsuba does it, on paths that draw so many
    at the first vertex. Where that is one, Mitsuba's way pays: it is slower, and closer to the
    radiance (benchmarks/sharing.py)."""
    return None if drawn == 1 else getattr(scene.integrator(), "sky", None)


def gathered(
    scene: mi.Scene,
    sky: Sky | None,
    sampler: mi.Sampler,
    si: mi.SurfaceInteraction3f,
    bsdf: mi.BSDFPtr,
    active: mi.Bool,
    count: int,
    each: int,
    attach: bool,
) -> mi.Spectrum:
    """BSDF × radiance at ``si``, from ``count`` samples of emitters, each picked from ``each``
    directions, that share the work with one sample of the BSDF: of the n directions in all each
    counts by ``mis_weight(n p_emitter, p_BSDF)`` / n.

    They are stratified: each is uniform over a part of its own, equal to the others, so that their
    mean is unbiased whatever n. A shadow ray costs more than a direction, so that a sample traces
    one of those that it draws, see ``_picked``. ``attach``: with the derivatives of BSDF and
    emitters (on, as by ``dr.resume_grad``); directions are detached. Traced.
    """
    total = mi.Spectrum(0)
    context = mi.BSDFContext()
    smooth = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    for index in range(count):
        with dr.suspend_grad():
            if each == 1:
                ds, emitted = toward(scene, sky, sampler, si, smooth, (index, count))
                lit = smooth & (ds.pdf != 0)
                lit &= ~_hidden(scene, sky, si, ds, lit)
            else:
                part = index, count
                ds, emitted, weight = _picked(scene, sky, sampler, si, bsdf, smooth, part, each)
                lit = weight != 0
            wo = si.to_local(ds.d)
        if attach and sky is None:
            again = scene.eval_emitter_direction(si, ds, lit)
            emitted = dr.replace_grad(emitted, again * dr.select(lit, dr.rcp(ds.pdf), 0))
        value, pdf = bsdf.eval_pdf(context, si, wo, lit)
        if each == 1:
            weight = dr.select(ds.delta, 1, mis_weight(count * ds.pdf, dr.detach(pdf)))
        total += dr.select(lit, weight * value * emitted, 0)
    return total * (1 / (count * each)) if count * each > 1 else total


def _picked(
    scene: mi.Scene,
    sky: Sky | None,
    sampler: mi.Sampler,
    si: mi.SurfaceInteraction3f,
    bsdf: mi.BSDFPtr,
    active: mi.Bool,
    part: tuple[int, int],
    each: int,
) -> tuple[mi.DirectionSample3f, mi.Spectrum, mi.Float]:
    """One of ``each`` directions to emitters, its radiance over its density, and what it counts.
    That is its ``mis_weight`` over the probability that it is picked, so that it stands for the sum
    over all of them; 0 where something is in its way.

    Picked in proportion to what each would bring if nothing were in its way (resampled importance
    sampling: Talbot et al. 2005), now and then by chance alone: what brings nothing may have a
    derivative, as a lamp that is off has."""
    found, brings = [], []
    for number in range(each):
        ds, emitted = toward(scene, sky, sampler, si, active, part, (number, each))
        lit = active & (ds.pdf != 0)
        value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, si.to_local(ds.d), lit)
        weight = dr.select(ds.delta, 1, mis_weight(part[1] * each * ds.pdf, pdf))
        found.append((ds, emitted, dr.select(lit, weight, 0)))
        brought = dr.maximum(dr.mean(weight * value * emitted), 0)
        # One that is not finite is as likely as one that brings nothing, and spoils no other.
        brings.append(dr.select(lit & dr.isfinite(brought), brought, 0))
    sure = _SURE * dr.rcp(sum(brings))
    sure = dr.select(dr.isfinite(sure), sure, 0)
    least = dr.select(sure > 0, 1 - _SURE, 1) / each
    point, end, picked, share = sampler.next_1d(), mi.Float(0), found[0], mi.Float(1)
    for one, brought in zip(found, brings):
        own = sure * brought + least
        here = point >= end
        picked = tuple(dr.select(here, b, a) for a, b in zip(picked, one))
        share, end = dr.select(here, own, share), end + own
    ds, emitted, weight = picked
    weight /= share
    return ds, emitted, dr.select(_hidden(scene, sky, si, ds, weight != 0), 0, weight)
