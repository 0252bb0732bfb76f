"""What steps and normals need of a mesh, at one of its resolutions."""

from __future__ import annotations

from functools import cached_property

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from ..scene.subdivision import Coarser
from ..scene.topology import Topology
from .parameters import own

# λ of I + λL for a mesh of 10,000 vertices, as the paper's authors take it. Derivatives are spread
# over about √λ edges; in proportion to the count it is the same part of the surface.
_STIFFNESS = 19.0 / 10_000


class Mesh:
    """``faces (F, 3)``: of the scene's vertices; ``topology``: of the welded ones."""

    def __init__(self, topology: Topology, faces: np.ndarray):
        self.topology, self.stiffness = topology, _STIFFNESS * topology.count
        self.faces = own(mi.UInt32, faces.ravel().astype(np.uint32))
        self._place = own(mi.UInt32, topology.place.astype(np.uint32))
        self._corners = [own(mi.UInt32, corner.astype(np.uint32)) for corner in topology.faces.T]

    def arrays(self, leaf: mi.TensorXf) -> tuple[mi.Float, mi.Float]:
        """Positions and normals of the scene's vertices, those of welded ones at ``leaf (V, 3)``.
        Traced and differentiable."""
        points = dr.unravel(mi.Point3f, leaf.array)
        a, b, c = (dr.gather(mi.Point3f, points, index) for index in self._corners)
        across = dr.cross(b - a, c - a)
        sums = [dr.zeros(mi.Float, self.topology.count) for _ in range(3)]
        for index in self._corners:
            for total, part in zip(sums, across):
                dr.scatter_add(total, part, index)
        normals = mi.Vector3f(*sums)
        length = dr.norm(normals)
        # Where the faces around a vertex cancel, any direction; the division has a derivative.
        normals = dr.select(length > 0, normals / dr.maximum(length, 1e-30), mi.Vector3f(0, 0, 1))
        return tuple(
            dr.ravel(dr.gather(type(each), each, self._place)) for each in (points, normals)
        )

    @cached_property
    def solve(self):
        """(I + λL)⁻¹, by cholespy where it is installed, which is faster on large meshes."""
        matrix = sparse.identity(self.topology.count) + self.stiffness * self.topology.laplacian()
        try:
            import cholespy
        except ImportError:
            # Symmetric and positive definite: without pivots, in an order for such, far less fills.
            return linalg.splu(
                matrix.tocsc(), "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True}
            ).solve
        entries = matrix.tocoo()
        solver = cholespy.CholeskySolverD(
            *(self.topology.count, entries.row, entries.col, entries.data),
            cholespy.MatrixType.COO,
        )

        def solve(right: np.ndarray) -> np.ndarray:
            found = np.zeros_like(right)
            solver.solve(np.ascontiguousarray(right), found)
            return found

        return solve


class Halved:
    """What leads from a coarser mesh to the one whose vertices halve its edges."""

    def __init__(self, before: Coarser):
        self.kept = before.kept
        self._ends = [own(mi.UInt32, end.astype(np.uint32)) for end in before.parents.T]

    def finer(self, leaf: mi.TensorXf) -> mi.TensorXf:
        """The same surface ``(V', 3)`` by the finer mesh. Traced and differentiable."""
        points = dr.unravel(mi.Point3f, leaf.array)
        a, b = (dr.gather(mi.Point3f, points, end) for end in self._ends)
        return mi.TensorXf(dr.ravel((a + b) * 0.5), (dr.width(self._ends[0]), 3))
