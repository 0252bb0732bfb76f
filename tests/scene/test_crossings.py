"""Triangles that pass through each other: against all pairs, one by one, and known meshes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from isas_cli.scenes.icosphere import icosphere

from isas_cli.scene import crossings
from isas_cli.scene.crossings import crossing


def cut(start, end, a, b, c) -> bool:
    """Whether the segment passes through the triangle: it meets the plane between its ends, on the
    same side of all three edges."""
    normal = np.cross(b - a, c - a)
    if np.dot(start - a, normal) * np.dot(end - a, normal) >= 0:
        return False
    sides = [np.dot(np.cross(q - p, start - p), end - start) for p, q in ((a, b), (b, c), (c, a))]
    return all(side > 0 for side in sides) or all(side < 0 for side in sides)


def one_by_one(positions: np.ndarray, faces: np.ndarray) -> list[int]:
    found = set()
    for this, other in itertools.permutations(range(len(faces)), 2):
        for k in range(3):
            ends = faces[this][[k, (k + 1) % 3]]
            if not set(ends) & set(faces[other]) and cut(
                *positions[ends], *positions[faces[other]]
            ):
                found |= {this, other}
    return sorted(found)


def two(apart: float, level: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Two balls of radius 1 in one mesh, turned against each other."""
    vertices, faces = icosphere(level)
    turned = vertices[:, [1, 2, 0]] + [apart, 0.03, 0.05]
    return np.concatenate([vertices, turned]), np.concatenate([faces, faces + len(vertices)])


@pytest.mark.parametrize("count", (1, 2, 3, 40))
def test_all_pairs_of_random_triangles_are_found(count, rng):
    """Some share vertices: 25 for 40 triangles."""
    positions = rng.random((max(6, 5 * count // 8), 3)) * [1, 1, 0.7]
    faces = np.stack([rng.permutation(len(positions))[:3] for _ in range(count)])
    expected = one_by_one(positions, faces)
    assert crossing(positions, faces).tolist() == expected
    assert count < 40 or 10 < len(expected)


def test_balls_that_meet_cross_and_others_do_not():
    positions, faces = two(1.5)
    assert crossing(positions, faces).tolist() == one_by_one(positions, faces)
    assert not len(crossing(*two(2.1, level=4)))
    found, half = crossing(*two(1.5, level=4)), 20 * 4**4
    assert 0 < np.sum(found < half) < half / 10 and 0 < np.sum(found >= half) < half / 10


def test_sound_meshes_of_any_density_have_none():
    vertices, faces = icosphere(5)
    stretched = vertices * [1, 1, 40]
    # A thousand times denser on one side.
    drawn = vertices * np.exp(7 * vertices[:, :1])
    for positions in (vertices, stretched, drawn, vertices.astype(np.float32)):
        assert not len(crossing(positions, faces))


def test_what_touches_does_not_cross():
    """Cubes side by side, one turned out of all axes, in single precision."""
    import trimesh

    box = trimesh.creation.box().subdivide()
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.5, 0.7]))[:3, :3]
    positions = np.concatenate([box.vertices, box.vertices + [1, 0.3, 0.2]]) @ turn.T
    faces = np.concatenate([box.faces, box.faces + len(box.vertices)])
    assert not len(crossing(positions.astype(np.float32), faces))
    positions[len(box.vertices) :] -= 0.01 * turn[:, 0]
    assert len(crossing(positions.astype(np.float32), faces))


def test_triangles_without_area_cross_nothing():
    vertices, faces = icosphere(1)
    flat = np.array([[0, 0, 1], [5, 5, 5]])
    assert not len(crossing(vertices, np.concatenate([faces, flat])))
    assert not len(crossing(np.zeros((3, 3)), np.array([[0, 1, 2], [0, 1, 2]])))


def test_of_a_mesh_of_many_triangles_no_part_is_left_out(monkeypatch):
    """Its triangles come close to more others the more it has."""
    positions, faces = two(1.5, level=3)
    every = crossing(positions, faces)
    monkeypatch.setattr(crossings, "_MOST", 100)
    assert len(every) and np.array_equal(crossing(positions, faces), every)


def test_of_more_than_can_be_held_some_are_found(rng, monkeypatch):
    positions, faces = rng.random((300, 3)), np.arange(300).reshape(-1, 3)
    every = crossing(positions, faces)
    monkeypatch.setattr(crossings, "_MOST", 500)
    monkeypatch.setattr(crossings, "_EACH", 1)
    some = crossing(positions, faces)
    assert 0 < len(some) < len(every) and set(some) <= set(every)
    monkeypatch.setattr(crossings, "_AT_ONCE", 7)
    assert crossing(positions, faces).tolist() == some.tolist()
