"""Radiance and derivatives of paths along given rays: the three passes that everything uses.

In one place, because the order of events matters: a replay must see the random numbers of the
primal pass again (the sampler is cloned before it), nothing may track derivatives but the
integrator itself, and results are evaluated before anyone reduces them (otherwise each channel's
reduction renders again). Short paths are differentiated in one go (``attached``), roughnesses on
request with directions of their own (``derivative_sampling``), all else by path replay
backpropagation.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from . import attached
from .derivative_sampling import DerivativeSampling, plain


def _attached(integrator, scene, sampler, ray):
    """What to differentiate in one go, derivatives attached; None where paths are replayed."""
    if isinstance(integrator, DerivativeSampling):
        return integrator.radiance(scene, sampler, ray)
    if attached.handles(integrator):
        return attached.radiance(scene, sampler, ray, integrator.max_depth)
    return None


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
    return _sample(plain(integrator), dr.ADMode.Primal, scene, sampler, ray)


def backward(integrator, scene, sampler, ray, adjoint: mi.Color3f) -> None:
    """Trace one path per ray and add ⟨adjoint, dL/dθ⟩ to the gradients of the scene.

    ``adjoint (3, N)``: ∂ℒ/∂L per path, importance weights included.
    """
    with dr.resume_grad():
        radiance = _attached(integrator, scene, sampler, ray)
        # Paths too short to reach any unknown have no derivative.
        if radiance is not None and dr.grad_enabled(radiance):
            dr.backward_from(adjoint * radiance)
    if radiance is not None:
        return
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
    derivative = dr.zeros(mi.Color3f, dr.width(ray.o))
    with dr.resume_grad():
        radiance = _attached(integrator, scene, sampler, ray)
        if radiance is not None and dr.grad_enabled(radiance):
            derivative = mi.Color3f(dr.forward_to(radiance))
    if radiance is None:
        replayed = sampler.clone()
        _, state = primal(integrator, scene, sampler, ray)
        dr.eval(state)
        derivative, _ = _sample(integrator, dr.ADMode.Forward, scene, replayed, ray, None, state)
    dr.eval(derivative)
    return derivative
