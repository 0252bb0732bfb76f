"""Derivatives of what a pixel shows of surfaces that move, silhouettes left out."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..runtime.errors import InputError
from ..scene.problem import Problem
from .integrators import Integrator, Twice, sampled
from .light import shapes_with


class Attached(Twice):
    """Radiance by the scene's own integrator, its derivatives by one of Mitsuba's projective ones,
    whose ray hits follow surfaces that move: of direct light in one go, of longer paths replayed.

    Without bias for the derivative at fixed visibility (Zhang et al. 2023, 'Projective Sampling
    for Differentiable Rendering of Geometry': its interior term), which lacks what silhouettes
    add: ``silhouettes`` of this package, for those that a camera sees. But not where what moves has
    discrete lobes (``sharp``): Mitsuba differentiates a direction that was drawn from one like one
    of a smooth lobe.
    """

    has_forward, moves = True, True
    derivatives = "paths that follow moving surfaces, and samples of the silhouettes in the images"

    def __init__(self, base: Integrator):
        self.mitsuba, self.simulates = base.mitsuba, base.simulates
        self.max_depth, self.rr_depth = base.max_depth, base.rr_depth
        self.hide_emitters, self.paths = base.hide_emitters, base.paths
        self.primal = base.primal
        self.misses = base.lobes.keys if base.lobes else base.misses
        self.direct = base.max_depth == 2
        self.projective = without_film(base)

    def backward(self, scene, sampler, ray, adjoint: mi.Color3f) -> None:
        if not self.direct:
            return super().backward(scene, sampler, ray, adjoint)
        radiance = self.once(dr.ADMode.Backward, scene, sampler, ray, True)
        with dr.resume_grad():
            if dr.grad_enabled(radiance):
                dr.backward_from(adjoint * radiance)

    def forward(self, scene, sampler, ray) -> mi.Color3f:
        if not self.direct:
            return super().forward(scene, sampler, ray)
        derivative = dr.zeros(mi.Color3f, dr.width(ray.o))
        radiance = self.once(dr.ADMode.Forward, scene, sampler, ray, True)
        with dr.resume_grad():
            if dr.grad_enabled(radiance):
                derivative = mi.Color3f(dr.forward_to(radiance))
        dr.eval(derivative)
        return derivative

    def once(self, mode, scene, sampler, ray, differentiated, *more) -> mi.Color3f:
        # Derivatives are suspended: the integrator resumes them by itself where directions are not
        # drawn. Attached as a whole, drawn directions would be differentiated as well.
        return sampled(self.projective, mode, scene, sampler, ray, *more)[0]


def projective(base: Integrator, name: str = "prb_projective", **settings) -> mi.Integrator:
    """Mitsuba's projective integrator ``name`` for the paths of ``base``."""
    if name == "prb_projective":
        depth = -1 if base.max_depth >= 2**32 - 1 else int(base.max_depth)
        settings |= {"max_depth": depth, "rr_depth": base.rr_depth}
    found = mi.load_dict({"type": name, "hide_emitters": base.hide_emitters, **settings})
    # On standard output, where the record's path is all that is printed.
    found.sample_border_warning = False
    return found


def without_film(base: Integrator) -> mi.Integrator:
    """The same, to be asked for samples: the cheapest for the depth, no shadows' silhouettes."""
    name = "direct_projective" if base.max_depth == 2 else "prb_projective"
    return projective(base, name, sppi=0)


def sharp(problem: Problem) -> list[str]:
    """The names of shapes that move and mirror, let through or leave out what falls on them, by a
    discrete lobe: their derivative by ``Attached`` is wrong. Where paths end on them there are
    none."""
    moved = problem.unknowns.moved if problem.integrator.max_depth > 1 else ()
    return [name for name in shapes_with(problem.scene, "Delta") if name in moved]


def check_lamps(problem: Problem, where: str) -> None:
    """Raises InputError, naming ``where``, for lamps that a camera is not to see: those of surfaces
    are in the way of Mitsuba's projective integrators, which hide nothing but the sky."""
    emitters = problem.scene.emitters() if problem.integrator.hide_emitters else ()
    surfaces = [each for each in emitters if mi.has_flag(each.flags(), mi.EmitterFlags.Surface)]
    if surfaces:
        names = ", ".join(f"'{each.get_shape().id()}'" for each in surfaces)
        raise InputError(
            f"{where}: hide_emitters hides {names} in the images, and Mitsuba's projective "
            "integrators, by which what moves is followed, see it: leave hide_emitters out, or "
            "take sampler=plateau"
        )
