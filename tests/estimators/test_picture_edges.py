"""Edges in pictures: where they are found, and that shapes are drawn to them."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from isas_cli.scenes import kirby
from shapes_for_tests import KEY, problem, screened

from isas_cli import losses
from isas_cli.estimators.silhouettes import Settings
from isas_cli.rendering import picture_edges
from isas_cli.rendering.outline import at, crossed, draw
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


def measured(p, points, way, cameras, reach: float, places: mi.Float, seen: mi.Bool) -> float:
    """The measure over points that stay where they are on the mesh, drawn by length, and seen."""
    a, b = (at(places, each) for each in (points.a, points.b))
    place = cameras.project(points.eye, dr.lerp(a, b, points.t))
    d = picture_edges._looked_up(p.edges, p.views, points.eye, place, way, mi.Bool(True))
    return float(dr.mean(dr.select(seen, dr.square(dr.minimum(d, reach)), 0))[0]) / reach**2


def test_against_differences_of_what_it_measures(drawn):
    """At points on the mesh that are drawn once, by their lengths, and held there; those that
    something hides count nothing."""
    p, step = drawn, 2e-3
    x = np.asarray(p.unknowns[KEY].truth) * [1.03, 0.97, 1.02]
    (mesh,) = p.unknowns[KEY].kind.topologies.values()
    border, key = PictureEdges(p, mesh, 1.0, 1 << 13), p.unknowns[KEY].kind.positions
    (outline,) = border._outlines.values()

    def placed(at: np.ndarray) -> mi.Float:
        p.unknowns.write(p.unknowns.values_of({KEY: at.astype(np.float32)}))
        return mi.Float(p.unknowns.params[key])

    now, cameras = placed(x), border.cameras
    weights = picture_edges._lengths(now, outline, cameras, p.views, len(p.film_sizes))
    points = draw(weights, outline, 1 << 18, mi.UInt32(5))
    point, _, _, crossing = crossed(now, outline, cameras, p.views, points)
    eye = dr.gather(mi.Vector3f, cameras.eyes.place, points.eye)
    ray = mi.Ray3f(mi.Point3f(eye), mi.Vector3f(point) - eye)
    ray.maxt = 1 - 1e-3
    seen = crossing.valid & ~p.scene.ray_test(ray)
    angle = dr.atan2(crossing.away.y, crossing.away.x) * (picture_edges._WAYS / dr.pi)
    way = mi.UInt32(angle + (2 * picture_edges._WAYS + 0.5)) % picture_edges._WAYS
    dr.eval(seen, way)  # as long as the scene stands so
    reach = picture_edges._FAR - 0.5
    for along in (np.broadcast_to([1.0, 0, 0], x.shape), np.broadcast_to([0, 1.0, 0], x.shape), x):
        sides = [
            measured(p, points, way, cameras, reach, placed(x + s * along), seen)
            for s in (step, -step)
        ]
        exact = (sides[0] - sides[1]) / (2 * step)
        found = derivative(p, x, along, 16)
        error = found.std(ddof=1) / np.sqrt(len(found))
        print(f"{found.mean() / exact:.3f} ± {error / abs(exact):.3f} of the differences")
        assert abs(found.mean() - exact) < 4 * error + 0.05 * abs(exact)


def test_the_reach_falls_while_edges_alone_are_followed(drawn):
    """So that what is far is drawn in first, and another edge is left out then."""
    estimator = Settings(batch=64, edges=64, shadows=0).on(drawn, losses.L2())
    (border,) = (each for _, _, each in estimator.borders if isinstance(each, PictureEdges))
    estimator.undrawn, values, found = 0.5, drawn.unknowns.starts(), []
    for spent in (0.0, 0.25, 0.4999):
        estimator.estimate(values, None, 1, 0, spent)
        found.append(float(border._reach[0][0]) + 0.5)
    drawn.unknowns.write(values)
    far, near = picture_edges._FAR, picture_edges._NEAR
    assert near < far and found == pytest.approx([far, np.sqrt(far * near), near], rel=1e-3)


def test_what_a_near_clip_plane_cuts_away_hides_no_edges():
    found, picture = [], None
    for more in ({}, screened(kirby.build(1, 48, 1)["sensor_000"])):
        p = problem(views=1, side=48, **more)
        picture = p.target_image(0) if picture is None else picture
        p.edges = picture_edges.of([picture], [np.ones(picture.shape[:2])])
        truth = np.asarray(p.unknowns[KEY].truth)
        way = np.broadcast_to([1.0, 0, 0], truth.shape)
        found.append(derivative(p, truth + 0.08 * way, way, 2))
    assert np.abs(found[0]).min() > 0.01
    np.testing.assert_allclose(*found, rtol=1e-2)


def test_views_count_by_their_weights(drawn, monkeypatch):
    """The derivative is the sum of the views', each times its factor, in every step alike."""
    truth = np.asarray(drawn.unknowns[KEY].truth)
    way = np.broadcast_to([1.0, 0, 0], truth.shape)

    def found(weights) -> np.ndarray:
        monkeypatch.setattr(drawn, "weights", weights)
        return derivative(drawn, truth + 0.08 * way, way, 4)

    plain = found(None)
    np.testing.assert_allclose(found(np.ones(4)), plain, rtol=1e-5)
    alone = [found(4.0 * (np.arange(4) == view)) for view in range(4)]
    np.testing.assert_allclose(sum(alone), 4 * plain, rtol=1e-3)
    assert np.ptp([each.mean() for each in alone]) > 0.2 * abs(plain.mean())
