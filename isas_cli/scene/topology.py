"""How the triangles of a mesh hang together: welded vertices, edges, the graph's Laplacian."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from .shape_error import enclosed

# Of a surface's area: holes up to this leave it an inside.
_HOLES = 0.05


@dataclass(frozen=True)
class Topology:
    """A mesh whose vertices at the same place are one.

    ``place (n,)``: of each of the file's vertices, the welded one; ``first (V,)``: of each welded
    one, the first of the file's; ``faces (F, 3)``: welded vertices.
    """

    place: np.ndarray
    first: np.ndarray
    faces: np.ndarray

    @staticmethod
    def of(positions: np.ndarray, faces: np.ndarray) -> "Topology":
        """``positions (n, 3)``, ``faces (F, 3)`` as in a file: a seam of texture coordinates or of
        normals repeats vertices, and an edge there would count as two borders."""
        _, first, place = np.unique(positions, axis=0, return_index=True, return_inverse=True)
        # In the file's order, so that what changes at one vertex leaves the others' numbers.
        order = np.argsort(first, kind="stable")
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        place = rank[place.ravel()]
        return Topology(place, first[order], place[faces])

    @staticmethod
    def together(parts: list["Topology"]) -> "Topology":
        """Several meshes as one, whose vertices come after each other; those of one are not welded
        to another's."""
        counts = np.cumsum([0, *(part.count for part in parts)])
        whole = np.cumsum([0, *(len(part.place) for part in parts)])
        return Topology(
            np.concatenate([part.place + before for part, before in zip(parts, counts)]),
            np.concatenate([part.first + before for part, before in zip(parts, whole)]),
            np.concatenate([part.faces + before for part, before in zip(parts, counts)]),
        )

    @property
    def count(self) -> int:
        """Of welded vertices."""
        return len(self.first)

    @cached_property
    def used(self) -> np.ndarray:
        """The welded vertices that faces name: files keep others, as of what was cropped."""
        return np.unique(self.faces)

    @cached_property
    def edges(self) -> "Edges":
        return Edges.of(self.faces)

    def laplacian(self) -> sparse.csc_matrix:
        """The graph's, ``(V, V)``: valence on the diagonal, -1 where two vertices share an edge."""
        ends = self.edges.ends
        rows, columns = np.concatenate([ends, ends[:, ::-1]]).T
        ones = np.ones(len(rows))
        neighbours = sparse.coo_matrix((ones, (rows, columns)), (self.count, self.count)).tocsr()
        valence = np.asarray(neighbours.sum(axis=1)).ravel()
        return (sparse.diags(valence) - neighbours).tocsc()

    def folded(self, positions: np.ndarray) -> float:
        """Share of the edges whose faces, with vertices at ``positions (V, 3)``, nearly lie on each
        other: normals more than 120° apart, as nowhere on a surface that is fit to be rendered."""
        a, b, c = (positions[self.faces[:, i]].astype(np.float64) for i in range(3))
        across = np.cross(b - a, c - a)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
        first, second = across[self.edges.faces.T]
        return float(np.mean(np.einsum("ij,ij->i", first, second) < -0.5))

    def outward(self, positions: np.ndarray) -> float:
        """1 where the faces, with vertices at ``positions (V, 3)``, are turned outwards, -1 where
        inwards; 0 where they enclose nothing, or their holes may be too large to say so."""
        corners = positions[self.faces].astype(np.float64)
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area, volume = np.linalg.norm(across, axis=1).sum() / 2, enclosed(corners)
        rim = positions[self.edges.ends[self.edges.faces[:, 0] == self.edges.faces[:, 1]]]
        # No line of a length goes around more than a circle of it.
        holes = np.linalg.norm(rim[:, 0] - rim[:, 1], axis=1).sum() ** 2 / (4 * np.pi)
        if holes > _HOLES * area or abs(volume) < 1e-9 * area**1.5:
            return 0.0
        return float(np.sign(volume))

    def flaws(self) -> list[str]:
        """What makes silhouettes ambiguous, in words; nothing for a closed mesh."""
        found = []
        if self.edges.open:
            found.append(f"{self.edges.open} of its {len(self.edges.ends)} edges are open")
        if self.edges.crowded:
            found.append(f"{self.edges.crowded} of its edges have more than two faces")
        return [f"{each}: silhouettes there are ambiguous, and gradients biased" for each in found]


def distinct(faces: np.ndarray) -> np.ndarray:
    """Which of ``faces (F, 3)`` have no two corners at one place, bool."""
    return (faces != np.roll(faces, 1, axis=1)).all(axis=1)


@dataclass(frozen=True)
class Edges:
    """``ends (E, 2)``: vertices; ``faces (E, 2)``: of its two faces, the same one twice where it is
    open; ``across (E, 2)``: the third vertex of each. ``open``, ``crowded``: how many edges have
    one face, or more than two, of which the first two count. Faces with two corners at one place
    are none."""

    ends: np.ndarray
    faces: np.ndarray
    across: np.ndarray
    open: int
    crowded: int

    @staticmethod
    def of(faces: np.ndarray) -> "Edges":
        ok = distinct(faces)
        number = np.flatnonzero(ok | ~ok.any())  # a mesh has some edge
        faces, face = faces[number], np.tile(number, 3)
        half = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
        ends, which, counts = np.unique(
            np.sort(half, axis=1), axis=0, return_inverse=True, return_counts=True
        )
        order = np.argsort(which.ravel(), kind="stable")
        start = np.concatenate([[0], np.cumsum(counts)[:-1]])
        pair = np.stack([order[start], order[start + np.minimum(counts - 1, 1)]], axis=1)
        return Edges(
            ends, face[pair], opposite[pair], int((counts == 1).sum()), int((counts > 2).sum())
        )
