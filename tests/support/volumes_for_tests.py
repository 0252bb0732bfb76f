"""One medium in a box under a grey sky, seen by one camera."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from isas_cli.scenes.cameras import perspective
from isas_cli.scenes.smoke import medium
from scenes_for_tests import without_targets

from isas_cli.config.schema import UnknownConfig
from isas_cli.rendering import rays
from isas_cli.rendering.integrators import Medium
from isas_cli.unknowns.parameters import flat

DENSITY, ALBEDO = "box.interior_medium.sigma_t.data", "box.interior_medium.albedo.data"
N = 1 << 16
SKY = 0.7


def description(density, albedo, integrator: str = "prbvolpath", depth: int = 64) -> dict:
    """``density``: a number, of a grid of 4³, or ``(Z, Y, X)``; ``albedo``: what fits to it."""
    kind = {"type": integrator}
    if integrator == "prbvolpath":
        kind |= {"max_depth": depth, "rr_depth": depth}
    shape = np.shape(density) or (4, 4, 4)
    density = np.broadcast_to(np.asarray(density, np.float32), shape)
    albedo = np.broadcast_to(np.asarray(albedo, np.float32), (*shape, 3))
    return {
        "type": "scene",
        "integrator": kind,
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": SKY}},
        "box": {"type": "cube", "bsdf": {"type": "null"}, "interior": medium(density, albedo)},
        "sensor": perspective([3.0, 2.0, 3.5], (0.0, 0.0, 0.0), 35.0, 16),
    }


def uneven(side: int = 4) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    return rng.uniform(0.2, 3.0, (side,) * 3), rng.uniform(0.3, 0.95, (side,) * 3 + (3,))


def problem(density, albedo, /, *more, levels=1, **starts):
    made = without_targets(
        description(density, albedo, *more),
        {
            DENSITY: UnknownConfig(start=starts.get("density", 1.0), levels=levels),
            ALBEDO: UnknownConfig(start=starts.get("albedo", 0.6), levels=levels),
        },
    )
    assert isinstance(made.integrator, Medium)
    return made


def through_the_middle(p) -> mi.Ray3f:
    return mi.Ray3f(dr.full(mi.Point3f, 0, N) + [0.1, 0.2, 5], mi.Vector3f(0, 0, -1))


def backward(p, values: dict, ray, seed: int = 1, adjoint=(1.0, 1.0, 1.0)) -> dict[str, np.ndarray]:
    """Gradients of the mean radiance."""
    p.unknowns.attach(values)
    with dr.suspend_grad():
        weights = mi.Color3f(*[dr.full(mi.Float, a / N, N) for a in adjoint])
        p.integrator.backward(p.scene, rays.stream(mi.UInt32(seed), N), ray, weights)
    found = {k: np.array(flat(g), np.float64) for k, g in p.unknowns.gradients().items()}
    p.unknowns.write(values)
    return found


def forward(p, values: dict, tangents: dict, ray, adjoint=(1.0, 1.0, 1.0)) -> float:
    """The mean radiance's derivative along ``tangents``, channels weighted by ``adjoint``."""
    p.unknowns.push_tangent(values, p.unknowns.values_of(tangents))
    with dr.suspend_grad():
        moved = p.integrator.forward(p.scene, rays.stream(mi.UInt32(1), N), ray)
    return float(np.array(moved, np.float64).mean(axis=1) @ adjoint)


def smooth_rays(p) -> mi.Ray3f:
    """Through all of the camera's pixels, at random within them."""
    pixel = dr.tile(dr.arange(mi.UInt32, p.views.total), N // p.views.total)
    stream = rays.stream(mi.UInt32(7), N)
    return rays.spawn(p.sensors, p.views, *p.views.locate(pixel), stream)[0]
