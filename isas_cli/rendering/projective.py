"""Derivatives of what a pixel shows of surfaces that move, silhouettes left out."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from .integrators import Integrator


class Attached(Integrator):
    """Radiance by the scene's own integrator, its derivatives by one of Mitsuba's projective ones,
    whose ray hits follow surfaces that move: of direct light in one go, of longer paths replayed.

    Without bias for the derivative at fixed visibility (Zhang et al. 2023, 'Projective Sampling
    for Differentiable Rendering of Geometry': its interior term), which lacks what silhouettes
    add: ``silhouettes`` of this package, for those that a camera sees.
    """

    has_forward, moves = True, True
    derivatives = "paths that follow moving surfaces, and samples of the silhouettes in the images"

    def __init__(self, base: Integrator):
        self.mitsuba, self.simulates = base.mitsuba, base.simulates
        self.max_depth, self.rr_depth = base.max_depth, base.rr_depth
        self.hide_emitters, self.paths = base.hide_emitters, base.paths
        self.primal: Callable = base.primal
        self.direct = base.max_depth == 2
        self.projective = projective(base)

    def backward(self, scene, sampler, ray, adjoint: mi.Color3f) -> None:
        if self.direct:
            radiance = self._traced(dr.ADMode.Backward, scene, sampler, ray)
            with dr.resume_grad():
                if dr.grad_enabled(radiance):
                    dr.backward_from(adjoint * radiance)
            return
        again = sampler.clone()
        radiance = self._traced(dr.ADMode.Primal, scene, sampler, ray)
        dr.eval(adjoint, radiance)
        self._traced(dr.ADMode.Backward, scene, again, ray, adjoint, radiance)

    def forward(self, scene, sampler, ray) -> mi.Color3f:
        if self.direct:
            derivative = dr.zeros(mi.Color3f, dr.width(ray.o))
            radiance = self._traced(dr.ADMode.Forward, scene, sampler, ray)
            with dr.resume_grad():
                if dr.grad_enabled(radiance):
                    derivative = mi.Color3f(dr.forward_to(radiance))
        else:
            again = sampler.clone()
            radiance = self._traced(dr.ADMode.Primal, scene, sampler, ray)
            dr.eval(radiance)
            derivative = self._traced(dr.ADMode.Forward, scene, again, ray, None, radiance)
        dr.eval(derivative)
        return derivative

    def _traced(self, mode, scene, sampler, ray, adjoint=None, state=None) -> mi.Color3f:
        # Derivatives are suspended: the integrator resumes them by itself where directions are not
        # drawn. Attached as a whole, drawn directions would be differentiated as well.
        found, *_ = self.projective.sample(
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
        return found


def projective(base: Integrator) -> mi.Integrator:
    """Mitsuba's projective integrator for the paths of ``base``: without a film, for samples."""
    depth = -1 if base.max_depth >= 2**32 - 1 else int(base.max_depth)
    direct = base.max_depth == 2
    settings = {} if direct else {"max_depth": depth, "rr_depth": base.rr_depth}
    settings |= {"hide_emitters": base.hide_emitters, "sppi": 0}
    name = "direct_projective" if direct else "prb_projective"
    found = mi.load_dict({"type": name, **settings})
    # On standard output, where the record's path is all that is printed.
    found.sample_border_warning = False
    return found
