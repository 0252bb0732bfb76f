"""Edges in pictures: where they are found, and that shapes are drawn to them."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from shapes_for_tests import KEY, problem

from isas_cli.rendering import picture_edges
from isas_cli.rendering.picture_edges import PictureEdges, distances
from isas_cli.runtime import streams

SIDE = 40


def step(angle: float) -> np.ndarray:
    """A picture that is dark on one side of a line through its middle, whose normal has this angle
    to the right, downwards."""
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5 - SIDE / 2
    bright = np.cos(angle) * x + np.sin(angle) * y > 0
    return np.repeat(np.where(bright, 0.8, 0.1)[..., None], 3, axis=2).astype(np.float32)


@pytest.mark.parametrize("way", [0, 2, 3, 6])
def test_edges_are_found_where_they_are_by_their_direction(way):
    angle = way * np.pi / picture_edges._WAYS
    found = distances([step(angle)], [np.ones((SIDE, SIDE))]).reshape(SIDE, SIDE, -1)
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5 - SIDE / 2
    exact = np.minimum(np.abs(np.cos(angle) * x + np.sin(angle) * y), picture_edges._FAR)
    inner = (slice(8, -8), slice(8, -8))
    assert np.abs(found[..., way] - exact)[inner].max() < 1.6
    across = (way + picture_edges._WAYS // 2) % picture_edges._WAYS
    assert (found[..., across][inner] == picture_edges._FAR).all()


def test_what_a_mask_hides_has_no_edges():
    mask = np.ones((SIDE, SIDE))
    mask[:, SIDE // 2 - 6 : SIDE // 2 + 6] = 0
    assert (distances([step(0)], [mask]) == picture_edges._FAR).all()


def test_a_flat_picture_has_none():
    flat = np.full((SIDE, SIDE, 3), 0.3, np.float32)
    assert (distances([flat], [np.ones((SIDE, SIDE))]) == picture_edges._FAR).all()


def derivative(p, x: np.ndarray, way: np.ndarray, count: int = 8) -> np.ndarray:
    """Along a movement of all vertices."""
    (mesh,) = p.unknowns[KEY].kind.topologies.values()
    border, key = PictureEdges(p, mesh, 1.0, 1 << 13), p.unknowns[KEY].kind.positions
    found = []
    for number in range(count):
        seeds = [dr.opaque(mi.UInt32, streams.seed(7, number, "edge"))]
        p.unknowns.attach(p.unknowns.values_of({KEY: x.astype(np.float32)}))
        border.accumulate(p.unknowns.params[key], seeds)
        found.append(np.sum(np.array(p.unknowns.taken()[KEY], np.float64) * way))
    return np.array(found)


@pytest.fixture(scope="module")
def drawn():
    """The figure, and pictures of it over a wall of stripes that are no outline of it."""
    p = problem(views=4, side=96)
    pictures = [p.target_image(view) for view in range(4)]
    for picture in pictures:
        picture[:, ::17] *= 1.4
    p.edges = picture_edges.of(pictures, [np.ones(picture.shape[:2]) for picture in pictures])
    return p


def test_it_draws_a_shape_back_to_its_place(drawn):
    truth = np.asarray(drawn.unknowns[KEY].truth)
    for way in ([1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]):
        way = np.broadcast_to(way, truth.shape)
        at = [derivative(drawn, truth + shift * way, way) for shift in (-0.08, 0.08)]
        print([f"{each.mean():.3f} ± {each.std() / np.sqrt(len(each)):.3f}" for each in at])
        assert at[0].mean() < -5 * at[0].std() / np.sqrt(len(at[0]))
        assert at[1].mean() > 5 * at[1].std() / np.sqrt(len(at[1]))


def test_its_size_is_that_of_the_slope(drawn):
    """Against the mean of the same measure a little before and after, of the same points."""
    truth = np.asarray(drawn.unknowns[KEY].truth)
    way, far = np.broadcast_to([1.0, 0, 0], truth.shape), 0.06
    slopes = [derivative(drawn, truth + s * way, way).mean() for s in np.linspace(0.02, far, 5)]
    # A square around the truth: the slope grows as the distance does.
    assert slopes[-1] > 1.3 * slopes[0]
