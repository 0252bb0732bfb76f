"""Whether what a scene has can be seen by way of another surface at all."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mitsuba as mi
import numpy as np

if TYPE_CHECKING:
    from ..scene.problem import Problem

_CONVEX = ("Sphere", "Cube", "Rectangle", "Disk")


def alone(problem: "Problem") -> bool:
    """Whether one convex object is all there is, wherever its unknowns move it: what leaves its
    surface does not meet it again, so that silhouettes are seen by the camera alone, and none in a
    shadow or a reflection."""
    shapes = problem.scene.shapes()
    if len(shapes) != 1:
        return False
    kinds = [u.kind for u in problem.unknowns]
    if any(kind.moves_geometry and not kind.affine for kind in kinds):
        return False
    return shapes[0].class_name() in _CONVEX or (shapes[0].is_mesh() and _is_convex(shapes[0]))


def _is_convex(mesh: mi.Mesh) -> bool:
    import trimesh

    positions = np.array(mesh.vertex_positions_buffer()).reshape(-1, 3)
    faces = np.array(mesh.faces_buffer()).reshape(-1, 3)
    welded = trimesh.Trimesh(positions, faces)
    # Edge by edge, of one closed body; two that touch at a vertex have another Euler number.
    return bool(welded.is_convex and welded.euler_number == 2)
