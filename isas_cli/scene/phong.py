"""BSDF "phong" of a scene's description: the PBDR paper's reflectance (Eq. 5).

    f_r = ρ_d / π + ρ_s (n + 2) / (2π) max(0, r · ω_o)^n,    n = 2 / α² - 2,

r the mirror direction of ω_i. The paper names a roughness α beside the exponent n and does not
connect them; here they are by the usual relation of a Phong lobe to a microfacet one, in which
α = 1 is n = 0. Parameters ``diffuse`` ρ_d, ``specular`` ρ_s and ``roughness`` α are textures,
colours or numbers, and can be unknown. Energy is conserved where ρ_d + ρ_s ≤ 1. It reflects on the
side of the normal alone. Importing it needs a variant (``backend.plugin``).
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

# Directions that the other lobe draws: without them a lobe of nothing would have no derivative.
_LEAST = 0.1


class Phong(mi.BSDF):
    """See the module. Directions are drawn from one of both lobes, by their mean albedos."""

    def __init__(self, props: mi.Properties):
        super().__init__(props)
        self.diffuse = props.get_texture("diffuse", 0.5)
        self.specular = props.get_texture("specular", 0.2)
        self.roughness = props.get_texture("roughness", 0.3)
        front = mi.BSDFFlags.FrontSide
        varying = mi.BSDFFlags.SpatiallyVarying
        self.m_components = [
            mi.BSDFFlags.GlossyReflection | front | varying,
            mi.BSDFFlags.DiffuseReflection | front | varying,
        ]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def traverse(self, callback: mi.TraversalCallback) -> None:
        for name in ("diffuse", "specular", "roughness"):
            callback.put(name, getattr(self, name), mi.ParamFlags.Differentiable)

    def sample(self, ctx, si, sample1, sample2, active=True):
        active = mi.Bool(active) & (mi.Frame3f.cos_theta(si.wi) > 0)
        n, share = self._exponent(si, active), self._share(si, active)
        glossy = sample1 < share
        # About the mirror direction, density ∝ cos^n.
        cosine = dr.power(sample2.y, dr.rcp(n + 1))
        sine = dr.safe_sqrt(1 - dr.square(cosine))
        y, x = dr.sincos(2 * dr.pi * sample2.x)
        lobe = mi.Frame3f(_mirrored(si.wi)).to_world(mi.Vector3f(sine * x, sine * y, cosine))
        sample = mi.BSDFSample3f()
        sample.wo = dr.select(glossy, lobe, mi.warp.square_to_cosine_hemisphere(sample2))
        sample.eta = 1
        sample.sampled_component = dr.select(glossy, mi.UInt32(0), mi.UInt32(1))
        kinds = (mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.DiffuseReflection)
        sample.sampled_type = dr.select(glossy, *(mi.UInt32(int(kind)) for kind in kinds))
        sample.pdf = self.pdf(ctx, si, sample.wo, active)
        active &= sample.pdf > 0
        value = self.eval(ctx, si, sample.wo, active)
        return sample, dr.select(active, value / dr.select(active, sample.pdf, 1), 0)

    def eval(self, ctx, si, wo, active=True):
        return self._both(si, wo, active)[0]

    def pdf(self, ctx, si, wo, active=True):
        return self._both(si, wo, active)[1]

    def eval_pdf(self, ctx, si, wo, active=True):
        return self._both(si, wo, active)

    def _both(self, si, wo, active):
        cosine = mi.Frame3f.cos_theta(wo)
        active = mi.Bool(active) & (mi.Frame3f.cos_theta(si.wi) > 0) & (cosine > 0)
        n, share = self._exponent(si, active), self._share(si, active)
        along = dr.dot(_mirrored(si.wi), wo)
        # x^n and its derivative by n are 0 at x = 0, which a power's own are not.
        inside = along > 1e-6
        lobe = dr.select(inside, dr.exp(n * dr.log(dr.select(inside, along, 1))), 0) / (2 * dr.pi)
        matt = self.diffuse.eval(si, active) / dr.pi
        value = (matt + self.specular.eval(si, active) * (n + 2) * lobe) * cosine
        pdf = share * (n + 1) * lobe + (1 - share) * cosine / dr.pi
        return dr.select(active, value, 0), dr.select(active, pdf, 0)

    def _exponent(self, si, active) -> mi.Float:
        α = dr.clip(self.roughness.eval_1(si, active), 1e-3, 1)
        return 2 / dr.square(α) - 2

    def _share(self, si, active) -> mi.Float:
        """Of directions, those drawn from the glossy lobe."""
        glossy, matt = (dr.mean(t.eval(si, active)) for t in (self.specular, self.diffuse))
        share = dr.detach(glossy / dr.maximum(glossy + matt, 1e-6))
        return dr.clip(share, _LEAST, 1 - _LEAST)

    def to_string(self) -> str:
        parts = f"diffuse={self.diffuse}, specular={self.specular}, roughness={self.roughness}"
        return f"Phong[{parts}]"


def _mirrored(wi: mi.Vector3f) -> mi.Vector3f:
    return mi.Vector3f(-wi.x, -wi.y, wi.z)


mi.register_bsdf("phong", Phong)
