"""Meshes that are another, coarser one, whose triangles were each split into four."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Coarser:
    """The mesh before: ``kept (V',)``, its vertices' numbers in the finer one; ``faces (F / 4, 3)``
    in its own; ``parents (V, 2)``, of each finer vertex the ends, in the coarser one, of the edge
    that it halves, or twice that vertex itself."""

    kept: np.ndarray
    faces: np.ndarray
    parents: np.ndarray


def coarser(faces: np.ndarray, count: int) -> Coarser | None:
    """Of a closed mesh of ``count`` vertices, ``faces (F, 3)``, all turned the same way. None where
    it comes from no coarser one, or where six triangles meet everywhere in one of its pieces: then
    nothing tells which vertices are old.

    A vertex where not six meet is old. Neighbours of an old one are new, and what lies opposite of
    it, seen from them, is old again.
    """
    third = {}
    for a, b, c in faces.tolist():
        third[a, b], third[b, c], third[c, a] = c, a, b
    if len(third) != 3 * len(faces):
        return None
    waiting = np.flatnonzero(np.bincount(faces.ravel(), minlength=count) != 6).tolist()
    old, ends = set(waiting), {}
    beside = {a: b for a, b in third}
    try:
        while waiting:
            vertex = waiting.pop()
            first = new = beside[vertex]
            while True:
                opposite = vertex
                for _ in range(3):
                    opposite = third[new, opposite]
                if ends.setdefault(new, {vertex, opposite}) != {vertex, opposite}:
                    return None
                if opposite not in old:
                    old.add(opposite)
                    waiting.append(opposite)
                new = third[vertex, new]
                if new == first:
                    break
    except KeyError:  # an open edge
        return None
    if len(old) + len(ends) != count or not old.isdisjoint(ends):
        return None
    if any(len(pair) != 2 for pair in ends.values()):
        return None
    kept = np.array(sorted(old))
    number = np.zeros(count, np.int64)
    number[kept] = np.arange(len(kept))
    parents = np.stack([number, number], axis=1)
    for vertex, pair in ends.items():
        parents[vertex] = number[sorted(pair)]
    middle = [[ends[v] for v in face] for face in faces.tolist() if old.isdisjoint(face)]
    corners = [(c & a, a & b, b & c) for a, b, c in middle]
    if 4 * len(corners) != len(faces) or any(len(x) != 1 for three in corners for x in three):
        return None
    coarse = number[np.array([[next(iter(x)) for x in three] for three in corners])]
    return Coarser(kept, coarse, parents)
