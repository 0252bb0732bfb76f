"""What is said of unknowns by which no derivative is taken."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from .integrators import Integrator

if TYPE_CHECKING:
    from ..scene.problem import Problem
    from ..unknowns.unknowns import Unknown

_FEW = 64  # numbers for which differences of renderings are affordable


def missed(problem: "Problem") -> list["Unknown"]:
    """Those whose derivative the scene's integrator ``misses``."""
    keys = {*problem.integrator.misses}
    return [each for each in problem.unknowns if keys.intersection(each.kind.writes)]


def refusal(integrator: Integrator, unknowns: list["Unknown"]) -> str:
    """Of a run: which ``integrator`` misses, and the ``reason``."""
    keys = named(each.key for each in unknowns)
    return f"scene.unknowns: {keys}: {reason(integrator, unknowns)}"


def reason(integrator: Integrator, unknowns: list["Unknown"]) -> str:
    """Why ``integrator`` misses them, and what helps."""
    way = "find these in a run of their own"
    if not integrator.moves:
        way = f"leave {named_causes(integrator)} out of the scene"
    where = "while meshes move" if integrator.moves else f"with {named_causes(integrator)}"
    if sum(each.start.size for each in unknowns) <= _FEW:
        way += ", or take sampler=finite_differences, with a blur"
    return f"no derivative by what mirrors, clear glass and gaps pass on is taken {where}: {way}"


def named_causes(integrator: Integrator) -> str:
    """What a scene has that an integrator's misses come of."""
    media = ["media"] if "media" in integrator.simulates else []
    return " and ".join(media + ["hide_emitters"] * integrator.hide_emitters)


def named(keys: Iterable[str]) -> str:
    return ", ".join(f"'{key}'" for key in keys)
