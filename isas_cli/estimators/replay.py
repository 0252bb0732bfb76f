"""The three passes of a path replay integrator over given rays.

Thin and in one place, because the order of events matters: the replay must see the random
numbers of the primal pass again (the sampler is cloned before it), nothing may track derivatives
but the integrator's own loop, and results are evaluated before anyone reduces them (otherwise
each channel's reduction renders again).
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def _sample(integrator, mode, scene, sampler, ray, adjoint=None, state=None):
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


def primal(integrator, scene, sampler, ray) -> tuple[mi.Color3f, mi.Color3f]:
    """Radiance of one path per ray, and the state that a replay of the same paths needs."""
    return _sample(integrator, dr.ADMode.Primal, scene, sampler, ray)


def backward(integrator, scene, sampler, ray, adjoint: mi.Color3f) -> None:
    """Trace one path per ray and add ⟨adjoint, dL/dθ⟩ to the gradients of the scene (PRB).

    ``adjoint (3, N)``: ∂ℒ/∂L per path, importance weights included.
    """
    replayed = sampler.clone()
    _, state = primal(integrator, scene, sampler, ray)
    dr.eval(adjoint, state)
    _sample(integrator, dr.ADMode.Backward, scene, replayed, ray, adjoint, state)


def forward(integrator, scene, sampler, ray) -> mi.Color3f:
    """Directional derivative of each path's radiance, ``(3, N)``.

    The direction is the tangent that was pushed into the scene's parameters beforehand
    (``Unknowns.push_tangent``). The result counts a parameter that a path meets at several
    bounces once per meeting, summed before anything is squared.
    """
    replayed = sampler.clone()
    _, state = primal(integrator, scene, sampler, ray)
    dr.eval(state)
    derivative, _ = _sample(integrator, dr.ADMode.Forward, scene, replayed, ray, None, state)
    dr.eval(derivative)
    return derivative
