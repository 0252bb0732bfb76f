"""Whether a problem fits into memory, said before anything is rendered."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from ..runtime import memory
from ..runtime.errors import InputError

if TYPE_CHECKING:
    from ..scene.problem import Problem

# Bytes that are surely needed at the same time. A pixel's target: as it is compared with, and as it
# was read or rendered. An unknown's entry: value, gradient, Adam's two moments and its count of
# steps; start, truth and whether it is seen. What a step makes anew of one, while the old is there:
# value, moments, count. A drawn pixel: which it is, its probability, two random streams, radiance
# and adjoint. A path more of a drawn pixel, in the same launch: its radiance. An edge in a view,
# where silhouettes are drawn: its weight and their sum so far (``outline.draw``).
_TARGET, _ENTRY, _ANEW, _LANE, _PATH, _EDGE = 24, 29, 16, 90, 12, 16


def check(problem: "Problem", lanes: int, outlines: bool = False, paths: int = 0) -> None:
    """Raises InputError where ``problem`` with ``lanes`` pixels a step needs more memory than is
    free, with an estimate from below and what to reduce. ``outlines``: whether silhouettes of what
    moves are drawn; ``paths``: of the largest launch, where a pixel has several. On a CPU: what a
    GPU has free is not known."""
    if not mi.variant().startswith("llvm"):
        return
    entries = sum(u.start.size for u in problem.unknowns)
    largest = max(problem.unknowns, key=lambda u: u.start.size)
    size = f"the size of the {largest.kind.name} '{largest.key}', {largest.start.shape}"
    parts = {
        "targets": (problem.views.total * _TARGET, "the resolution of the views"),
        # Not all need move in the same step.
        "unknowns": (entries * _ENTRY + largest.start.size * _ANEW, size),
        "a step": (lanes * _LANE + max(0, paths - lanes) * _PATH, "estimator.batch"),
    }
    if outlines:
        params = mi.traverse(problem.scene)
        faces = {id: f"{id}.faces" for id in sorted(problem.unknowns.moved)}
        sizes = {id: dr.width(params[key]) // 3 for id, key in faces.items() if key in params}
        id = max(sizes, key=sizes.get, default="")
        # Three to two triangles, more where it is open; one mesh after the other.
        edges = sizes.get(id, 0) * 3 // 2 * len(problem.film_sizes)
        told = f"the number of triangles of '{id}', which moves (simplify the mesh), or of views"
        parts["silhouettes"] = edges * _EDGE, told
    needed, most = sum(size for size, _ in parts.values()), memory.available()
    if needed <= most:
        return
    told = ", ".join(f"{name} {memory.gib(size)}" for name, (size, _) in parts.items())
    raise InputError(
        f"needs at least {memory.gib(needed)} of memory ({told}), and {memory.gib(most)} are free: "
        f"lower {max(parts.values())[1]}"
    )
