"""The coverage term's gradient against differences of what surfaces cover; and what is broken on
purpose is noticed."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import shapes_for_tests as shapes
from isas_cli.scenes import kirby
from scenes_for_tests import without_targets
from shapes_for_tests import KEY, STEP, agrees, directions, egg, problem
from test_silhouettes import WALL, hidden

from isas_cli import losses
from isas_cli.config.schema import UnknownConfig
from isas_cli.estimators.silhouettes import Settings
from isas_cli.rendering import contours, rays
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.runtime import streams
from isas_cli.unknowns.parameters import own

NAMES = ("right", "up", "scale", "bump")
FINE, COUNT = 40, 12
WEIGHT = 2.5


def covered(p, x: np.ndarray) -> np.ndarray:
    """How much of each pixel surfaces cover with vertices at ``x``, by a grid of rays each."""
    p.unknowns.write(p.unknowns.values_of({KEY: x.astype(np.float32)}))
    return shapes.covered(p, FINE)


def masked(**more):
    """A problem with masks of the figure as it is, half as white as they should be, so that they
    cannot be met, and a tenth of them unknown."""
    p = problem(**more)
    part = 0.5 * covered(p, np.asarray(p.unknowns[KEY].truth))
    part[np.random.default_rng(3).random(part.size) < 0.1] = -1
    p.part = own(mi.Float, part.astype(np.float32))
    return p


def differences(p) -> dict[str, float]:
    x, part = egg(p), np.array(p.part, np.float64)
    known = part >= 0
    adjoint = np.where(known, 2 * WEIGHT * (covered(p, x) - part) / known.sum(), 0)
    found = {}
    for name in NAMES:
        way = directions(x)[name] * STEP
        found[name] = np.sum(adjoint * (covered(p, x + way) - covered(p, x - way))) / (2 * STEP)
    return found


def estimates(p, count: int = COUNT, **settings) -> dict[str, np.ndarray]:
    x = egg(p)
    (mesh,) = p.unknowns[KEY].kind.topologies.values()
    border = contours.Contours(p, mesh, WEIGHT, 1 << 14, 4, **settings)
    gradients, key = [], p.unknowns[KEY].kind.positions
    for number in range(count):
        seeds = [
            dr.opaque(mi.UInt32, streams.seed(7, number, name))
            for name in ("edge", "edge_residual")
        ]
        p.unknowns.attach(p.unknowns.values_of({KEY: x}))
        border.accumulate(p.unknowns.params[key], seeds)
        gradients.append(np.array(p.unknowns.taken()[KEY], np.float64))
    return {
        name: np.array([np.sum(each * way) for each in gradients])
        for name, way in directions(x).items()
    }


def right(found: dict, exact: dict) -> list[bool]:
    """Behind the board, ``up`` and ``bump`` are small differences of large parts, of which the
    differences' own steps are wrong by more."""
    return [agrees(found[name], np.full(4, exact[name]), 0.03) for name in exact]


@pytest.fixture(scope="module", params=["alone", "behind a board"])
def made(request):
    p = masked(**({} if request.param == "alone" else {"views": 1, **hidden()}))
    exact = differences(p)
    if request.param != "alone":
        exact = {name: exact[name] for name in ("right", "scale")}
    return p, exact, request.param


def test_as_the_cover_changes(made):
    p, exact, _ = made
    for adaptive in (True, False):
        assert all(right(estimates(p, adaptive=adaptive), exact))
    assert all(right(estimates(p, freeze=False), exact))


def test_edges_before_something_else_that_count_are_noticed(made, monkeypatch):
    p, exact, which = made

    def upwards(sensors, films, view, place):
        ray = rays.through(sensors, films, view, 0, 0, place, mi.Point2f(0.5))[0]
        ray.o += 1e4  # from where nothing is met
        return ray

    monkeypatch.setattr(contours, "_through", upwards)
    agreed = all(right(estimates(p), exact))
    # What is convex and alone has no such edges.
    assert agreed == (which == "alone")


def test_masks_count_by_their_weight_and_only_where_they_are_known(made):
    p, exact, _ = made
    part = p.part
    try:
        p.part = own(mi.Float, np.abs(np.array(part)))
        assert not all(right(estimates(p), exact))
    finally:
        p.part = part


def test_the_distance_from_masks():
    p = masked()
    p.part = p.part * dr.select(p.part > 0, mi.Float(2), 1)
    x = np.asarray(p.unknowns[KEY].truth)
    p.unknowns.write(p.unknowns.values_of({KEY: x}))
    assert contours.apart(p) < 0.005
    p.unknowns.write(p.unknowns.values_of({KEY: 0 * x + 0.001 * x}))
    assert contours.apart(p) == pytest.approx(1, abs=0.02)


def test_shapes_follow_it_alone_before_anything_else_moves():
    p = masked()
    estimator = Settings(batch=256, edges=4096).on(p, losses.L2())
    assert estimator.stages == (0.0,)  # nothing else is unknown
    estimator.undrawn = 0.3
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    values = p.unknowns.values_of({KEY: egg(p)})
    paths = []
    for spent in (0.0, 0.5):
        found = estimator.estimate(values, uniform, 1, 0, spent)[KEY]
        assert np.isfinite(np.array(found)).all() and np.any(np.array(found))
        paths.append(estimator.paths_per_step)
    assert paths[0] == 4096 * 5 < paths[1]


@pytest.mark.parametrize("begin", [{"figure": 0.3}, {"figure": 0.3, "wall": 0.1}])
def test_they_do_until_the_first_of_the_others_begins(begin):
    unknowns = {KEY: UnknownConfig(start="sphere")}
    for id, share in begin.items():
        unknowns[f"{id}.bsdf.reflectance.value"] = UnknownConfig(start=0.5, during=[share, 1.0])
    p = without_targets(kirby.build(1, 8, 1) | {"wall": WALL}, unknowns)
    p.set_targets(dr.zeros(mi.Float, 3 * p.views.total), None, "test")
    p.part = own(mi.Float, np.ones(p.views.total, np.float32))
    stages = Settings(batch=64, edges=64).on(p, losses.L2()).stages
    assert stages == (0.0, min(begin.values()))


def test_views_count_by_their_weights():
    """The gradient of two views is the sum of theirs, each times its factor."""
    p = masked()
    found = []
    for given in (None, [1.0, 1.0, 1.0], [1.9, 0.1, 1.0], [0.1, 1.9, 1.0]):
        p.weights = None if given is None else np.array(given)
        told = estimates(p, 2, adaptive=False)
        found.append(np.array([told[name].mean() for name in NAMES]))
    size = np.abs(found[0]).max()
    np.testing.assert_allclose(found[1], found[0], rtol=1e-4)
    np.testing.assert_allclose(found[2] + found[3], 2 * found[0], atol=0.05 * size)
    assert np.abs(found[2] - found[3]).max() > 0.2 * size
