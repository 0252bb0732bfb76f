"""Which triangles pass through each other."""

from __future__ import annotations

import numpy as np

from ..runtime import memory

# Of the coordinates' size, some of float32's roundings: what is as near to a plane lies in it.
_TOUCHING = 1e-6
# Pairs of triangles looked at together, and at most; and at most for each triangle, of many.
_AT_ONCE, _MOST, _EACH = 1 << 17, 1 << 22, 16


def crossing(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Indices, in order, of the triangles that an edge cuts which has no vertex of theirs, and of
    those whose edge it is.

    ``positions (V, 3)``, finite; ``faces (F, 3)``, of welded vertices. Triangles that share an
    edge, or lie in one plane, are not counted. Of meshes that lie over themselves so much that
    more than 4 million pairs come close, and more than 16 for each triangle, some.
    """
    corners = positions.astype(np.float64)[faces]
    least = _TOUCHING * np.abs(corners).max()
    pairs = _overlapping(corners.min(axis=1), corners.max(axis=1))
    found = np.zeros(len(faces), bool)
    for begin in range(0, len(pairs), _AT_ONCE):
        some = pairs[begin : begin + _AT_ONCE]
        for pair in (some, some[:, ::-1]):
            found[pair[_cuts(corners, faces, *pair.T, least)]] = True
    return np.flatnonzero(found)


def through(own: np.ndarray, others: np.ndarray) -> bool:
    """Whether any of the triangles ``own (F, 3, 3)`` passes through one of the ``others (G, 3,
    3)``; to touch it is not enough."""
    others = _around(others, own)
    own = _around(own, others) if len(others) else own[:0]
    if not len(own):
        return False
    corners = np.concatenate([own, others]).astype(np.float64)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)  # none shares a vertex
    least = _TOUCHING * np.abs(corners).max()
    pairs = _overlapping(corners.min(axis=1), corners.max(axis=1))
    pairs = pairs[(pairs[:, 0] < len(own)) != (pairs[:, 1] < len(own))]
    return any(
        _cuts(corners, faces, *some.T, least).any()
        for begin in range(0, len(pairs), _AT_ONCE)
        for some in (pairs[begin : begin + _AT_ONCE], pairs[begin : begin + _AT_ONCE, ::-1])
    )


def _around(corners: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Of triangles those that meet the box around ``other`` ones."""
    low, high = other.min(axis=(0, 1)), other.max(axis=(0, 1))
    return corners[((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)]


def _cuts(
    corners: np.ndarray, faces: np.ndarray, this: np.ndarray, other: np.ndarray, least: float
) -> np.ndarray:
    """Whether an edge of the triangles ``this (N,)``, farther than ``least`` from its ends, passes
    through the ``other (N,)``, as far from theirs, bool."""
    normal = np.cross(*np.moveaxis(corners[other, 1:] - corners[other, :1], 1, 0))
    heights = np.einsum("nij,nj->ni", corners[this] - corners[other, :1], normal)
    common = (faces[this][:, :, None] == faces[other][:, None, :]).any(axis=2)
    free = ~common & (np.abs(heights) > least * np.linalg.norm(normal, axis=1, keepdims=True))
    through = np.zeros(len(this), bool)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        near = np.flatnonzero(free[:, i] & free[:, j] & (heights[:, i] * heights[:, j] < 0))
        start, end = (corners[this[near], k] for k in (i, j))
        t = heights[near, i] / (heights[near, i] - heights[near, j])
        point = start + t[:, None] * (end - start)
        through[near[_margin(point, corners[other[near]], normal[near]) > least]] = True
    return through


def _margin(points: np.ndarray, corners: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """How far ``points (N, 3)`` of triangles' planes are within the triangles, from the nearest
    side, ``(N,)``; negative outside."""
    found = np.full(len(points), np.inf)
    for k in range(3):
        side = corners[:, k] - corners[:, k - 1]
        across = np.cross(normals, side)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        found = np.minimum(found, np.einsum("ni,ni->n", points - corners[:, k], across))
    return found


def _overlapping(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Pairs ``(P, 2)`` of boxes ``[low, high] (N, 3)`` that overlap, each once; where there are
    more than 4 million, and more than 16 for each box, some.

    By a binary tree over the boxes, whose nodes are paired with each other from its root down.
    """
    most, levels = max(_MOST, _EACH * len(low)), max(1, (len(low) - 1).bit_length())
    rest = np.zeros(((1 << levels) - len(low), 3))
    middle = np.concatenate([(low + high) / 2, rest + (low[-1] + high[-1]) / 2])
    low, high = np.concatenate([low, rest + np.inf]), np.concatenate([high, rest - np.inf])
    order = np.arange(len(low))
    for level in range(levels):  # each node's boxes, halved along the longest side
        own = order.reshape(1 << level, -1)
        longest = np.ptp(middle[own], axis=1).argmax(axis=1)
        places = middle[own, longest[:, None]].argsort(axis=1)
        order = np.take_along_axis(own, places, axis=1)
    order = order.ravel()
    tree = [(low[order], high[order])]
    for _ in range(levels - 1):
        below = [side.reshape(-1, 2, 3) for side in tree[-1]]
        tree.append((below[0].min(axis=1), below[1].max(axis=1)))
    one = other = np.zeros(1, np.int64)
    for low, high in reversed(tree):
        one, other = (
            (2 * each[:, None] + halves).ravel()
            for each, halves in ((one, [0, 0, 1, 1]), (other, [0, 1, 0, 1]))
        )
        near = np.flatnonzero(one <= other)
        one, other = one[near], other[near]
        near = np.concatenate(
            [
                (low[a] <= high[b]).all(axis=1) & (low[b] <= high[a]).all(axis=1)
                for a, b in ((one[at], other[at]) for at in memory.parts(len(one)))
            ]
        )
        one, other = one[near][:most], other[near][:most]
    apart = one != other
    return np.stack([order[one[apart]], order[other[apart]]], axis=1)
