"""Derivatives by roughness from directions that are drawn for them.

After Belhe et al., *Importance Sampling BRDF Derivatives* (2024), who draw from the positive and
the negative part of a BRDF's derivative apart; the shared random numbers follow the antithetic
sampling of Zeltner et al., *Monte Carlo Estimators for Differential Light Transport* (2021). The
closed forms below, and the choice of one vertex per path, are ours.

The derivative of a microfacet lobe by its roughness changes sign: rougher means less at the peak
and more around it. Directions drawn in proportion to the lobe lie where its derivative is small,
and give contributions of either sign that nearly cancel. Here the negative and the positive part
are each drawn in proportion to themselves, as one antithetic pair.

**The two parts.** With α = roughness² and t = tan²θ of the half-vector, GGX has the share
F(t) = t / (α² + t) of its projected normals within t, and ∂F/∂α = -2αt / (α² + t)², which is least
at t = α². So the normals within t < α² lose the mass 1/(2α), and those beyond gain as much. With
r = t/α², the lost part is distributed as 4r / (1 + r)², r ≤ 1, and the gained one as
1 - 4r / (1 + r)², r ≥ 1. Both are inverted in closed form,

    lost    r = (1 - √(1 - u))² / u,      gained    r = (1 + √u)² / (1 - u),

and both have the density 4α²|α² - t| / (α² + t)³ by t; by solid angle of h that is divided by
π cos³θ, and by solid angle of ω_o by 4⟨ω_i, h⟩ more. One u and one azimuth for both: as u grows
both move outwards, so that the mass is carried no further than it must be.

**The estimate.** dI/dα is the sum over a path's vertices of the derivative of that vertex's BSDF,
all others as they are. A path is traced by BSDF sampling, and of its vertices on unknown surfaces
one is drawn in proportion to the path's throughput there. From it three rays go out, lost, gained
and BSDF, and one to an emitter. What the rays carry is the radiance of ordinary paths, with the
same random numbers for all three: where the surroundings vary slowly, the pair's noise cancels
along with its value. The techniques are combined by the balance heuristic, the emitter's only for
the emission that the rays meet at once. The derivative itself comes from differentiating the
BSDF's value, with everything that depends on roughness: masking, and diffuse lobes too.

Bias: none, whatever the BSDF. Only the density of directions assumes GGX; BSDF sampling reaches
all that the two parts leave out.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..config.schema import ROUGHNESSES, roughness_of
from ..runtime.errors import InputError
from ..unknowns.ranges import fed
from ..unknowns.unknowns import Unknowns
from .integrators import InOneGo, Integrator
from .light import by_chance, mis_weight
from .roulette import chance, scaled

if TYPE_CHECKING:
    from ..scene.problem import Problem

# How α follows from each of the parameters.
_ALPHA = dict(zip(ROUGHNESSES, (dr.square, lambda x: x)))
_SMALLEST = 1e-12  # keeps quotients finite


def sampled(problem: "Problem") -> "Problem":
    """``problem`` with derivatives by roughness estimated like this; all else is shared with it."""
    integrator = DerivativeSampling(problem.integrator, problem.scene, problem.unknowns)
    return dataclasses.replace(problem, integrator=integrator)


class DerivativeSampling(InOneGo):
    """Stands where a path integrator does: the same radiance, other estimates of derivatives.

    ``base``: the integrator, whose radiance and depths are kept. Roulette begins at the same depth,
    beyond the chosen vertex by the throughput from there on.
    """

    paths_per_derivative = 4  # to the vertex, and three from it
    derivatives = "by roughness, directions drawn for the derivative's two parts"

    def __init__(self, base: Integrator, scene: mi.Scene, unknowns: Unknowns):
        """``unknowns``: roughnesses, which the configuration sees to. Raises InputError for an
        integrator that this estimate cannot follow, and for a roughness that it cannot reach."""
        if base.name != "PRBIntegrator" or base.hide_emitters:
            raise InputError(
                "estimator.derivative_sampling=true: works for the integrator 'prb' with visible "
                f"emitters, not for {base.name}; leave it out"
            )
        super().__init__(base.mitsuba)
        self.base, self.paths = base, base.paths
        self.max_depth, self.rr_depth = base.max_depth, base.rr_depth
        # Materials that outlive their scene break recordings of kernels for other scenes.
        self._scene = scene
        self._bsdfs = {word: [] for word in _ALPHA}
        for unknown in unknowns:
            key = unknown.key
            # A texture of its own may have any name: by what reads it, where something does.
            words = unknown.kind.words or {roughness_of(key)}
            if (word := next((each for each in _ALPHA if each in words), None)) is None:
                raise InputError(
                    f"estimator.derivative_sampling=true: '{key}' is no roughness; it draws for "
                    f"derivatives by {' or '.join(ROUGHNESSES)} alone: leave it out, or this "
                    "unknown"
                )
            found = _holding(scene, [holder for holder, _, _ in fed(unknowns.params, key)])
            # Mixed and masked materials do not tell the roughness of what they are made of.
            if not found or not all(np.all(bsdf.has_attribute(word)) for bsdf in found):
                raise InputError(
                    f"estimator.derivative_sampling=true: '{key}' lies inside a material or an "
                    "instance that does not pass it on; leave it out, or give the shape the "
                    "material itself"
                )
            self._bsdfs[word] += found

    def primal(self, scene, sampler, ray) -> tuple[mi.Color3f, object]:
        return self.base.primal(scene, sampler, ray)

    def _unknown(self, bsdf: mi.BSDFPtr) -> mi.Bool:
        return self._among([b for bsdfs in self._bsdfs.values() for b in bsdfs], bsdf)

    @staticmethod
    def _among(bsdfs: list, bsdf: mi.BSDFPtr) -> mi.Bool:
        found = mi.Bool(False)
        for one in bsdfs:
            found |= bsdf == mi.BSDFPtr(one)
        return found

    def _alpha(self, bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Float:
        """α of the GGX lobe that directions are drawn for."""
        alpha = mi.Float(1)
        for word, bsdfs in self._bsdfs.items():
            if bsdfs:
                mine = active & self._among(bsdfs, bsdf)
                value = bsdf.eval_attribute_1(word, si, mine)
                alpha = dr.select(mine, _ALPHA[word](value), alpha)
        return dr.maximum(alpha, 1e-3)

    def radiance(self, scene: mi.Scene, sampler: mi.Sampler, ray: mi.Ray3f) -> mi.Spectrum:
        """A number per ray whose *derivative* is the estimate of dI/dθ; it is no radiance itself.

        Call it with derivatives on (``dr.resume_grad``), like ``attached.radiance``. Traced.
        """
        context = mi.BSDFContext()
        with dr.suspend_grad():
            hit, ray, depth, β, active = self._vertex(scene, sampler, mi.Ray3f(ray))
            si = hit.compute_surface_interaction(ray, ray_flags=mi.RayFlags.All, active=active)
            active &= si.is_valid()
            bsdf = si.bsdf(ray)
            α = self._alpha(bsdf, si, active)

            lost, gained = _pair(si.wi, α, sampler.next_2d())
            sample, _ = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
            ds, emitted = scene.sample_emitter_direction(si, sampler.next_2d(), True, active)
            lit = active & (ds.pdf != 0)
            other = ~mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta) & (sample.pdf > 0)

            def density(wo, valid):
                return parts_pdf(si.wi, wo, α) + bsdf.pdf(context, si, wo, valid)

            terms = []
            for wo, valid in (lost, gained, (sample.wo, other)):
                valid = active & valid
                pdf = density(wo, valid)
                valid &= pdf > 0
                out = si.spawn_ray(si.to_world(wo))
                # The same random numbers for all three.
                at_once, pdf_light, later = self._incident(
                    scene, sampler.clone(), si, out, depth + 1, valid
                )
                carried = at_once / (pdf + pdf_light) + later / pdf
                terms.append((wo, valid, carried))

            wo = si.to_local(ds.d)
            share = dr.select(ds.delta, 1, ds.pdf / (ds.pdf + density(wo, lit)))
            terms.append((wo, lit, emitted * share))

        total = mi.Spectrum(0)
        for wo, valid, carried in terms:
            value = bsdf.eval(context, si, wo, valid)
            total += dr.select(valid, β * carried, 0) * value
        return total

    @dr.syntax
    def _vertex(self, scene, sampler, ray):
        """One vertex on an unknown surface, of a path that follows the BSDFs.

        Returns its intersection, the ray that found it, its number along the path, the throughput
        up to it over the probability of having been drawn, and whether there is one.
        """
        context = mi.BSDFContext()
        β, κ = mi.Spectrum(1), mi.Float(1)
        depth = mi.UInt32(0)
        total = mi.Float(0)
        chosen_hit = dr.zeros(mi.PreliminaryIntersection3f)
        chosen_ray = mi.Ray3f(ray)
        chosen_depth = mi.UInt32(0)
        chosen_β = mi.Spectrum(0)
        active = mi.Bool(True)
        hit = scene.ray_intersect_preliminary(ray, coherent=True, reorder=False, active=active)

        while dr.hint(active, max_iterations=self.paths.derivative, label="vertex"):
            si = hit.compute_surface_interaction(ray, ray_flags=mi.RayFlags.All, active=active)
            bsdf = si.bsdf(ray)
            active &= si.is_valid() & (depth + 1 < self.paths.derivative)

            # A reservoir of one, weighted by throughput.
            weight = dr.select(active & self._unknown(bsdf), dr.mean(β), 0)
            total += weight
            taken = sampler.next_1d() * total < weight
            chosen_hit[taken] = hit
            chosen_ray[taken] = ray
            chosen_depth = dr.select(taken, depth, chosen_depth)
            chosen_β = dr.select(taken, β / weight, chosen_β)

            sample, passed = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
            β *= passed
            κ = scaled(κ, passed, sample.eta)
            ray = si.spawn_ray(si.to_world(sample.wo))
            β, alive = self._roulette(sampler, β, κ, depth)
            # The vertices after the last one would be of no use.
            active &= alive & (depth + 2 < self.paths.derivative)
            depth += 1
            hit = scene.ray_intersect_preliminary(ray, coherent=False, reorder=False, active=active)

        return chosen_hit, chosen_ray, chosen_depth, chosen_β * total, total > 0

    def _roulette(self, sampler, β, κ, depth) -> tuple[mi.Spectrum, mi.Bool]:
        """Throughput after Russian roulette as path replay plays it, and who survives."""
        lives = chance(β, κ)
        late = depth >= self.rr_depth
        alive = (dr.max(β) != 0) & (~late | (sampler.next_1d() < lives))
        return dr.select(late, β * dr.rcp(lives), β), alive

    @dr.syntax
    def _incident(self, scene, sampler, origin, ray, number, active):
        """What one ordinary path brings back along ``ray`` from ``origin``.

        ``number``: of the vertex that the ray leads to. Returns the radiance emitted by what the
        ray meets, the density with which emitter sampling at ``origin`` draws this direction, and
        the radiance that comes from beyond.
        """
        context = mi.BSDFContext()
        at_once, pdf_light = mi.Spectrum(0), mi.Float(0)
        L, β, κ = mi.Spectrum(0), mi.Spectrum(1), mi.Float(1)
        depth = mi.UInt32(number)
        ray = mi.Ray3f(ray)
        active = mi.Bool(active)
        first, delta = mi.Bool(True), mi.Bool(False)
        pdf = mi.Float(1)
        previous = dr.detach(origin, True)
        hit = scene.ray_intersect_preliminary(ray, coherent=False, reorder=False, active=active)

        while dr.hint(active, max_iterations=self.paths.derivative, label="incident"):
            si = hit.compute_surface_interaction(ray, ray_flags=mi.RayFlags.All, active=active)
            bsdf = si.bsdf(ray)
            ds = mi.DirectionSample3f(scene, si=si, ref=previous)
            emission = ds.emitter.eval(si, active)
            by_light = scene.pdf_emitter_direction(previous, ds, active & ~delta)
            at_once = dr.select(first & active, emission, at_once)
            pdf_light = dr.select(first & active, by_light, pdf_light)
            mis = mis_weight(pdf, by_light)
            # The chosen vertex scatters.
            met = active & ~first & (mi.Bool(self.paths.caustics) | ~by_chance(active, delta))
            L += dr.select(met, β * mis * emission, 0)

            active &= si.is_valid() & (depth + 1 < self.paths.derivative)
            lit = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            ds, emitted = scene.sample_emitter_direction(si, sampler.next_2d(), True, lit)
            lit &= ds.pdf != 0
            value, value_pdf = bsdf.eval_pdf(context, si, si.to_local(ds.d), lit)
            mis = dr.select(ds.delta, 1, mis_weight(ds.pdf, value_pdf))
            L += dr.select(lit, β * mis * value * emitted, 0)

            sample, passed = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
            β *= passed
            κ = scaled(κ, passed, sample.eta)
            ray = si.spawn_ray(si.to_world(sample.wo))
            previous = dr.detach(si, True)
            pdf = sample.pdf
            delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
            first = mi.Bool(False)
            β, alive = self._roulette(sampler, β, κ, depth)
            active &= alive
            depth += 1
            hit = scene.ray_intersect_preliminary(ray, coherent=False, reorder=False, active=active)

        return at_once, pdf_light, L


def lost(u: mi.Float) -> mi.Float:
    """tan²θ/α² of a normal of the part that a rougher lobe loses; u uniform in [0, 1)."""
    # (1 - √(1 - u))² / u without the difference of two like numbers.
    return u / dr.square(1 + dr.sqrt(1 - u))


def gained(u: mi.Float) -> mi.Float:
    """tan²θ/α² of a normal of the part that a rougher lobe gains; u uniform in [0, 1)."""
    return dr.square(1 + dr.sqrt(u)) / dr.maximum(1 - u, _SMALLEST)


def _pair(wi: mi.Vector3f, alpha: mi.Float, uv: mi.Point2f) -> list[tuple[mi.Vector3f, mi.Bool]]:
    """A lost and a gained direction from the same random numbers, each with its validity."""
    side = dr.mulsign(mi.Float(1), wi.z)
    up = mi.Vector3f(wi.x, wi.y, dr.abs(wi.z))
    sin, cos = dr.sincos(dr.two_pi * uv.y)
    result = []
    for ratio in (lost(uv.x), gained(uv.x)):
        tan2 = ratio * dr.square(alpha)
        z = dr.rsqrt(1 + tan2)
        radius = dr.sqrt(tan2) * z
        h = mi.Vector3f(radius * cos, radius * sin, z)
        projected = dr.dot(up, h)
        wo = 2 * projected * h - up
        result.append((mi.Vector3f(wo.x, wo.y, wo.z * side), (projected > 0) & (wo.z > 0)))
    return result


def parts_pdf(wi: mi.Vector3f, wo: mi.Vector3f, alpha: mi.Float) -> mi.Float:
    """Density of ``wo`` by solid angle, in the part that it belongs to: the parts do not overlap.

    ``wi``, ``wo``: unit directions in the local frame, both on one side of the surface; else 0.
    """
    h = dr.normalize(wi + wo)
    cos = dr.abs(h.z)
    # Not 1 - cos², whose rounding exceeds α² where a lobe is sharp.
    tan2 = (dr.square(h.x) + dr.square(h.y)) / dr.maximum(dr.square(cos), _SMALLEST)
    a2 = dr.square(alpha)
    sum_ = a2 + tan2
    density = 4 * a2 * dr.abs(a2 - tan2) / (sum_ * sum_ * sum_)
    density /= dr.pi * cos * cos * cos * 4 * dr.abs(dr.dot(wi, h))
    valid = (wi.z * wo.z > 0) & dr.isfinite(density)
    return dr.select(valid, density, 0)


def _holding(scene: mi.Scene, takers: list) -> list[mi.BSDF]:
    """BSDFs of the scene's shapes that contain one of ``takers`` of a parameter, at any depth; none
    where others do that instances alone show, or where one is no BSDF."""
    if not all(isinstance(each, mi.BSDF) for each in takers):
        return []
    grouped = [each for each in mi.traverse(scene).hierarchy if isinstance(each, mi.Shape)]
    found, more = ([], [])
    for shapes, holding in ((scene.shapes(), found), (grouped, more)):
        for bsdf in (shape.bsdf() for shape in shapes):
            if bsdf is None or any(b is bsdf for b in (*found, *holding)):
                continue
            if any(each in mi.traverse(bsdf).hierarchy for each in takers):
                holding.append(bsdf)
    return [] if more else found
