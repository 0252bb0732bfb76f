"""Which light transport is simulated, which is not, and what in the scene says so.

Read off the scene as it was loaded, nothing is measured: a statement for each effect and its
evidence, for the record. What a scene does not call for is not simulated.
"""

from __future__ import annotations

from collections import Counter

import mitsuba as mi

from ..rendering.light import every_shape, shapes_with
from ..scene.problem import Problem

UNLIMITED = 2**32 - 1  # what Mitsuba makes of max_depth=-1


def statements(problem: Problem, derivatives: str) -> dict[str, str]:
    """Effect → what is done about it, and why, in the order in which a reader asks.

    ``derivatives``: how the estimator gets them, in words."""
    depth = problem.integrator.max_depth
    told = {
        "light": _counted([e.class_name() for e in problem.scene.emitters()]),
        "paths": (_depth if problem.integrator.samples_lights else _scatterings)(depth),
        "refraction": _transmission(problem.scene),
        "caustics": _caustics(problem),
        "media": _media(problem.scene, problem.integrator.simulates),
        "moving silhouettes": _moving(problem.unknowns.moving),
        "colour": "linear RGB, no spectra, no polarisation",
        "derivatives": derivatives,
    }
    if problem.flat:
        told["pictures of one colour"] = _flat(problem.flat)
    return told


def _moving(keys: list[str]) -> str:
    if keys:
        return f"{', '.join(keys)} move objects: compared at several places, or sampled"
    return "not differentiated: no unknown moves geometry"


def _flat(keys: list[str]) -> str:
    return f"{', '.join(keys)}: held as few texels"


def longest(depth: int) -> str:
    return "of any length" if depth == UNLIMITED else f"up to {depth} edges"


def _depth(depth: int) -> str:
    """What a longest path of so many edges carries to the camera."""
    if depth == UNLIMITED:
        return "of any length, ended by Russian roulette: all interreflection"
    if depth <= 1:
        return "of 1 edge: emission only, no surface is lit"
    bounces = depth - 2
    indirect = f"interreflection of up to {bounces} bounces" if bounces else "no interreflection"
    return f"of up to {depth} edges: direct light, {indirect}"


def _scatterings(depth: int) -> str:
    """What a longest path of so many edges has in a medium."""
    if depth == UNLIMITED:
        return "of any length, ended by Russian roulette: all scattering"
    if depth <= 1:
        return "of 1 edge: nothing scatters"
    times = {2: "once", 3: "twice"}.get(depth, f"up to {depth - 1} times")
    return f"of up to {depth} edges: light scatters {times}"


def clear(problem: Problem) -> list[str]:
    """The shapes that mirror, bend or pass light in one direction alone, where paths are long
    enough for light to come by way of them to a surface that scatters."""
    integrator = problem.integrator
    if not integrator.samples_lights or integrator.max_depth < 3:
        return []
    return shapes_with(problem.scene, "Delta")


def _caustics(problem: Problem) -> str:
    if not clear(problem):
        return "not met: by way of no mirror and no clear glass"
    done = "simulated" if problem.integrator.paths.caustics else "left out"
    return f"{done}: light that surfaces get by way of {', '.join(clear(problem))}"


def _transmission(scene: mi.Scene) -> str:
    """Whether light passes through any surface."""
    if through := shapes_with(scene, "Transmission"):
        return f"simulated: light passes through {', '.join(through)}"
    return "not met: no surface lets light through"


def _media(scene: mi.Scene, simulated: tuple[str, ...]) -> str:
    if any(shape.is_medium_transition() for shape in every_shape(scene)):
        if "media" in simulated:
            return "simulated: shapes are filled"
        return "not simulated: what fills shapes is ignored"
    return "not met: no shape is filled"


def _counted(names: list[str]) -> str:
    return ", ".join(f"{count} × {name}" for name, count in sorted(Counter(names).items()))
