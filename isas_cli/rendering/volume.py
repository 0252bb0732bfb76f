"""One medium in a convex shell under a sky: paths through it, and their derivatives.

Distances are drawn by delta tracking (Woodcock 1965) with one majorant σ̄: a collision at x is real
with probability σ(x)/σ̄. Every factor of a path's weight is replayed with its derivative (path
replay, Vicini et al. 2021): a real collision has σ a / σ̄, a null one (σ̄ - σ) / σ̄, each over its own
probability.
"""

from __future__ import annotations

from collections.abc import Iterable

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import backend
from ..scene import stand_ins
from ..unknowns.parameters import held
from ..unknowns.ranges import fed

# σ̄ over the medium's largest σ. Were they equal, a constant grid would never have a null collision,
# and its derivative would lack these. And the least σ̄ times the shell's size, where a medium
# scatters and where it only emits: in a thin one every further collision makes the derivative's
# variance smaller, and costs less than it saves up to here. Beside 4, at the start of smoke 8 took
# 1.29 of the time for 0.48 of the variance, 16 1.82 for 0.33; of lego 25 2.2 for 0.033.
_MARGIN, _FEWEST = 1.1, {"scatters": 8.0, "emits": 25.0}

_EXTINCTION = "sigma_t"
# A sky has a sun where more than this share of its light comes from this share of the sphere.
_SUNNY, _SUN = 0.2, 1e-3

backend.plugin(f"{__package__}.emission")


def medium_of(scene: mi.Scene, keys: Iterable[str] = (), scatters: bool = True) -> mi.Medium | None:
    """The medium, where ``trace``, or ``emitted`` unless it ``scatters``, simulates all that there
    is: one shape, a convex shell without a surface of its own, of normals that point outwards,
    around one medium, which fills it and whose extinction is alike in all channels, and a sky.
    ``keys``: of the scene's parameters that are unknown. Where it scatters the sky has no sun,
    which no light sample would find, and no key is of the phase function, which is not
    differentiated. Nor may it be of microflakes: their extinction is another one in each direction,
    and Mitsuba draws directions otherwise than their density says, so that paths that go by that
    density show something else."""
    shapes = scene.shapes()
    if len(shapes) != 1 or scene.environment() is None or len(scene.emitters()) != 1:
        return None
    shell = shapes[0]
    convex = shell.class_name() in ("Cube", "Sphere")
    # Others have gaps as well, beside what they reflect.
    bare = shell.bsdf() is None or shell.bsdf().class_name() == "Null"
    inside = shell.interior_medium()
    if not (convex and bare) or inside is None or shell.exterior_medium() is not None:
        return None
    if stand_ins.inside_out(scene, shell):
        return None
    if mi.has_flag(inside.phase_function().flags(), mi.PhaseFunctionFlags.Microflake):
        return None
    params = mi.traverse(scene)
    ends = [(holder, word) for key in keys for holder, word, _ in fed(params, key)]
    if scatters and any(isinstance(holder, mi.PhaseFunction) for holder, _ in ends):
        return None
    unknown = any(isinstance(holder, mi.Medium) and word == _EXTINCTION for holder, word in ends)
    if not _grey(inside, unknown) or not _fills(inside, shell.bbox()):
        return None
    return None if scatters and _sunny(scene.environment()) else inside


def _sunny(sky: mi.Emitter) -> bool:
    """Whether it has a sun: a path that leaves meets one so rarely that means of few miss it."""
    values = mi.traverse(sky)
    if sky.class_name() == "SunskyEmitter":
        return values["sun_scale"] > 0
    if sky.class_name() != "EnvironmentMapEmitter":
        return False
    # Without the columns that Mitsuba repeats.
    radiance = np.array(values["data"], np.float64)[:, 1:-1].mean(axis=2).clip(0)
    sines = np.sin((np.arange(len(radiance)) + 0.5) / len(radiance) * np.pi)[:, None]
    order = np.argsort(-radiance, axis=None)
    areas, light = (
        np.insert(each.ravel()[order].cumsum(), 0, 0.0)
        for each in (np.broadcast_to(sines, radiance.shape), radiance * sines)
    )
    share = np.interp(_SUN * areas[-1], areas, light)
    return bool(share > _SUNNY * light[-1])


def _fills(medium: mi.Medium, shell: mi.BoundingBox3f) -> bool:
    """Whether it is all over the ``shell``: Mitsuba has nothing beyond the bounds of the volume
    that is the extinction, which of a constant one are those of its unit cube."""
    if medium.class_name() == "HomogeneousMedium":
        return True
    own = dict(held(medium))[_EXTINCTION].bbox()
    reach = 1e-4 * dr.max(shell.extents())
    low, high = own.min <= shell.min + reach, own.max >= shell.max - reach
    return bool(dr.all(low) and dr.all(high))


def _grey(medium: mi.Medium, unknown: bool) -> bool:
    """Whether extinction is, and stays, the same in all channels; ``unknown``: it is."""
    params = mi.traverse(medium)
    for name in (each for each in params.keys() if _EXTINCTION in each):
        value = params[name]
        if isinstance(value, mi.Color3f):
            channels = np.array(value).reshape(3, -1)
        elif isinstance(value, mi.TensorXf) and value.shape[-1] == 3:
            channels = np.array(value).reshape(-1, 3).T
        else:
            continue
        alike = (channels == channels[:1]).all()
        if not alike or unknown:
            return False
    return True


def trace(
    mode: dr.ADMode,
    scene: mi.Scene,
    medium: mi.Medium,
    sampler: mi.Sampler,
    ray: mi.Ray3f,
    max_depth: int,
    rr_depth: int,
    adjoint: mi.Spectrum | None = None,
    radiance: mi.Spectrum | None = None,
) -> tuple[mi.Spectrum, mi.UInt32]:
    """Radiance of a path that scatters until it leaves the shell: the light from there, times its
    weight; and its collisions, real or not. ``mode``, ``adjoint``, ``radiance`` and the first
    result as in ``replayed.trace``; edges count from the camera, the one to the light included.
    Traced.

    No light is sampled from collisions: a path finds it by leaving, which is the cheaper estimate
    under a sky without a sun.
    """
    primal, context = mode == dr.ADMode.Primal, mi.PhaseFunctionContext()
    majorant = _majorant(scene, medium, "scatters")
    start, far, active = _within(scene, ray)
    result = mi.Spectrum(0 if primal else radiance)

    def event(found, β, depth, met, active, origin, direction, t, far, sampler):
        t = t - dr.log(1 - sampler.next_1d()) / majorant
        active &= t < far
        met = met + dr.select(active, mi.UInt32(1), 0)
        mei = _at(origin, direction, t)
        chance = sampler.next_1d()
        with dr.resume_grad(when=not primal):
            scattering, _, total = _coefficients(medium, mei, active)
            share = dr.detach(total.x) / majorant
            real = active & (chance < share)
            # The branch that is not taken must be finite too: its derivative is multiplied by 0.
            weight = dr.select(
                real,
                scattering / dr.maximum(dr.detach(total.x), 1e-20),
                (majorant - total.x) / majorant / (1 - share),
            )
            found = _add(mode, found, dr.select(active, weight, 1), result, adjoint)
        β = dr.select(active, β * dr.detach(weight), β)
        out, _, _ = medium.phase_function().sample(
            context, mei, sampler.next_1d(), sampler.next_2d(), real
        )
        depth = dr.select(real, depth + 1, depth)
        most = dr.max(β)
        late = real & (depth >= rr_depth)
        chance = dr.minimum(most, 0.95)
        lost = late & (sampler.next_1d() >= chance)
        β = dr.select(late, β * dr.rcp(chance), β)
        lost |= real & (depth + 1 > max_depth)
        lost |= most == 0
        β = dr.select(active & lost, 0, β)
        active &= ~lost
        direction = dr.select(real, out, direction)
        origin, t = dr.select(real, mei.p, origin), dr.select(real, 0, t)
        ahead = scene.ray_intersect_preliminary(mi.Ray3f(origin, direction), active=active & real)
        far = dr.select(real, dr.select(ahead.is_valid(), ahead.t, 0), far)
        return found, β, depth, met, active, origin, direction, t, far, sampler

    state = (
        mi.Spectrum(0), mi.Spectrum(1), mi.UInt32(0), mi.UInt32(0), active, mi.Point3f(start),
        mi.Vector3f(ray.d), mi.Float(0), far, sampler,
    )  # fmt: skip
    state = dr.while_loop(state, lambda *s: s[4], event, label=f"medium ({mode.name})")
    found, β, _, met, _, _, direction = state[:7]
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(direction))
    si.wi = -direction
    with dr.resume_grad(when=not primal):
        light = β * scene.environment().eval(si)
        if primal:
            return light, met
        found = _add(mode, found, light, None, adjoint)
    return found, met


def _add(mode, found, weight, radiance, adjoint):
    """What a factor ``weight`` of a path that brought ``radiance`` adds to the derivative; None:
    ``weight`` is the radiance. Traced, with derivatives on."""
    if mode == dr.ADMode.Primal:
        return found
    part = weight if radiance is None else radiance * dr.relative_grad(weight)
    if dr.grad_enabled(part):
        if mode == dr.ADMode.Backward:
            dr.backward_from(adjoint * part)
        else:
            found = found + dr.forward_to(part)
    return found


def emitted(
    mode: dr.ADMode,
    scene: mi.Scene,
    medium: mi.Medium,
    sampler: mi.Sampler,
    ray: mi.Ray3f,
    adjoint: mi.Spectrum | None = None,
    radiance: mi.Spectrum | None = None,
) -> tuple[mi.Spectrum, mi.UInt32]:
    """Radiance of a medium that emits and absorbs, and scatters nothing: at x it emits σ(x) times
    what its albedo says, per length. By ratio tracking (Novák et al. 2014): every collision adds
    its emission and weakens what lies behind. Else as ``trace``. Traced.
    """
    primal = mode == dr.ADMode.Primal
    majorant = _majorant(scene, medium, "emits")
    start, far, active = _within(scene, ray)

    def event(L, found, β, met, active, t, sampler):
        t = t - dr.log(1 - sampler.next_1d()) / majorant
        active &= t < far
        met = met + dr.select(active, mi.UInt32(1), 0)
        with dr.resume_grad(when=not primal):
            emission, _, total = _coefficients(medium, _at(start, ray.d, t), active)
            own = dr.select(active, β * emission / majorant, 0)
            left = dr.select(active, 1 - total.x / majorant, 1)
            if primal:
                L = L + own
            else:
                L = L - dr.detach(own)
                found = _add(mode, found, own + L * dr.relative_grad(left), None, adjoint)
        β *= dr.detach(left)
        # Of a path that is weak already, one in so many goes on, for all of them.
        chance = dr.select(β < _WEAK, 0.5, 1)
        lost = sampler.next_1d() >= chance
        β = dr.select(active, dr.select(lost, 0, β / chance), β)
        active &= ~lost
        return L, found, β, met, active, t, sampler

    state = (
        mi.Spectrum(0 if primal else radiance), mi.Spectrum(0), mi.Float(1), mi.UInt32(0), active,
        mi.Float(0), sampler,
    )  # fmt: skip
    state = dr.while_loop(state, lambda *s: s[4], event, label=f"emission ({mode.name})")
    L, found, β, met = state[:4]
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(ray.d))
    si.wi = -ray.d
    with dr.resume_grad(when=not primal):
        behind = β * scene.environment().eval(si)
        if primal:
            return L + behind, met
        return _add(mode, found, behind, None, adjoint), met


_WEAK = 0.05  # throughput below which Russian roulette begins


def _coefficients(medium: mi.Medium, mei: mi.MediumInteraction3f, active: mi.Bool):
    """Of scattering, of null collisions and of extinction, where ``active``."""
    # Dr.Jit 1.5 aborts when it records a masked lookup in a texture of the hardware ("unknown
    # variable r0"): what the mask selects instead has no owner.
    hardware = dr.backend_v(mi.Float) == dr.JitBackend.CUDA
    return medium.get_scattering_coefficients(mei, mi.Bool(True) if hardware else active)


def _majorant(scene: mi.Scene, medium: mi.Medium, what: str) -> mi.Float:
    largest = dr.detach(medium.get_majorant(dr.zeros(mi.MediumInteraction3f), True)).x
    size = float(dr.max(scene.shapes()[0].bbox().extents()))
    return dr.maximum(largest * _MARGIN, _FEWEST[what] / size)


def _within(scene: mi.Scene, ray: mi.Ray3f) -> tuple[mi.Point3f, mi.Float, mi.Bool]:
    """Where a ray's way through the shell begins, its length, and whether there is one."""
    si = scene.ray_intersect(mi.Ray3f(dr.detach(ray)))
    hit = si.is_valid()
    outside = dr.dot(si.n, ray.d) < 0
    start = dr.select(hit & outside, si.p, ray.o)
    onward = mi.Ray3f(si.spawn_ray(ray.d))
    second = scene.ray_intersect_preliminary(onward, active=hit & outside)
    behind = dr.select(second.is_valid(), dr.norm(onward.o + ray.d * second.t - si.p), 0)
    return mi.Point3f(start), dr.select(outside, behind, si.t), mi.Bool(hit)


def _at(origin: mi.Point3f, direction: mi.Vector3f, t: mi.Float) -> mi.MediumInteraction3f:
    mei = dr.zeros(mi.MediumInteraction3f, dr.width(t))
    mei.t, mei.p = t, origin + direction * t
    mei.wi = -direction
    mei.sh_frame = mi.Frame3f(mei.wi)
    return mei
