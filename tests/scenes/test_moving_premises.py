"""What makes PRDPT's tasks hard, in our scenes of them: what the cameras see, and what not."""

from __future__ import annotations

import _plateau
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from problems_for_tests import configured
from test_tiny_scenes import MOVING, SMALL

from isas_cli.engine import assemble
from isas_cli.rendering import rays
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime import backend
from isas_cli.scene.built import description, load
from isas_cli.scene.problem import Problem
from isas_cli.unknowns.specs import parse
from isas_cli.unknowns.unknowns import Unknown

ACROSS = 8  # rays along a pixel's side
# Half the width of the interval that the races draw starts from.
OCCLUSION = _plateau.TASKS["occlusion"].spread["red.depth"]
SHADOWS = _plateau.TASKS["shadows"].spread["ball.place"]


def settings(scene: str) -> list[str]:
    return [f"scene={scene}", *SMALL, "size=default", "target.spp=1"]


def bare(*words: str) -> Problem:
    """The problem of a scene, without targets."""
    return assemble.bare(configured(*words)[1].scene)[0]


def parsed(scene: str) -> list[Unknown]:
    """The unknowns as the scene is loaded: nothing is rendered."""
    config = configured(*settings(scene))[1].scene
    with backend.loading():
        loaded = load(description(config))
    return parse(mi.traverse(loaded), config.unknowns, True, config.poses)


def put(p: Problem, key: str, *numbers: float) -> None:
    """The unknown ``key`` there, the others at the truth."""
    arrays = {u.key: np.asarray(u.truth, np.float32) for u in p.unknowns}
    arrays[key] = np.asarray(numbers, np.float32).reshape(arrays[key].shape)
    p.unknowns.write(p.unknowns.values_of(arrays))


def seen(p: Problem) -> dict[str, np.ndarray]:
    """By shape: the share of every pixel in which cameras see it directly, (pixels,)."""
    pixel = dr.repeat(dr.arange(mi.UInt32, p.views.total), ACROSS**2)
    within = dr.tile(dr.arange(mi.UInt32, ACROSS**2), p.views.total)
    point = (mi.Point2f(within % ACROSS, within // ACROSS) + 0.5) / ACROSS
    place = p.views.locate(pixel)
    ray, _ = rays.through(p.sensors, p.views, *place, point, mi.Point2f(0.5))
    found = p.scene.ray_intersect(ray).shape
    return {
        shape.id(): np.array(dr.block_sum(mi.Float(found == mi.ShapePtr(shape)), ACROSS**2))
        / ACROSS**2
        for shape in p.scene.shapes()
    }


def test_cup_the_handle_is_hidden_on_the_way():
    p = bare(*settings("cup"))
    mug = {}
    for angle in (0, 80, 90, 100, 180):
        put(p, "cup.angle", angle)
        mug[angle] = seen(p)["mug"]
    handle = mug[0].sum() - mug[90].sum()
    assert handle > 0.03 * mug[90].sum()  # it shows at the truth, to the side
    assert mug[180].sum() - mug[90].sum() > 0.5 * handle
    for angle in (80, 100):
        assert np.abs(mug[angle] - mug[90]).sum() < 0.05 * handle


def test_occlusion_the_ball_is_hidden_at_the_start():
    p = bare(*settings("occlusion"))
    (unknown,) = p.unknowns
    put(p, "red.depth", *unknown.truth)
    shown = seen(p)["red"].sum()
    for off in (-OCCLUSION, 0, OCCLUSION):
        put(p, "red.depth", *(unknown.start + off))
        hidden = seen(p)
        assert hidden["red"].sum() == 0 < hidden["blue"].sum(), off
        assert shown > hidden["blue"].sum() / 4, off


def test_shadows_the_ball_is_out_of_view_and_its_shadow_elsewhere():
    p = bare(*settings("shadows"))
    renderer = Renderer(p)
    (unknown,) = p.unknowns

    def images(*place: float) -> np.ndarray:
        """Of all pixels by the same random numbers, (pixels, 3)."""
        put(p, "ball.place", *place)
        return renderer.range(0, p.views.total, 16, lambda i: 50 + i)

    lit = images(0, 500)

    def shadow(place: np.ndarray) -> np.ndarray:
        found = (images(*place) < 0.5 * lit).all(axis=1)
        assert seen(p)["ball"].sum() == 0, place
        assert found.sum() > 50, place
        return found

    at_truth = shadow(unknown.truth)
    for side in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        place = unknown.start + SHADOWS * np.array(side)
        assert not (at_truth & shadow(place)).any(), side


@pytest.mark.parametrize(
    "scene, shown, share, hidden",
    (
        # Only what walls scatter onto the box; only what the ball focuses.
        ("global_illumination", "box", 0.1, ("lamp", "left")),
        ("caustic", "ball", 0.05, ("lamp",)),
    ),
)
def test_the_light_is_out_of_view(scene, shown, share, hidden):
    p = bare(*settings(scene))
    for values in (p.unknowns.truths(), p.unknowns.starts()):
        p.unknowns.write(values)
        found = seen(p)
        assert found[shown].sum() > share * p.views.total
        assert all(found[name].sum() == 0 for name in hidden)


def test_sort_cubes_fit_beside_each_other_and_start_elsewhere():
    from isas_cli.scenes import sort

    (unknown,) = parsed("sort")
    places = sort.places().reshape(-1, 2)
    assert places.shape == (75, 2) and np.all(unknown.truth == 0)
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    assert np.min(apart[~np.eye(75, dtype=bool)]) > sort.SIDE  # they fit beside each other
    away = np.linalg.norm(unknown.start.reshape(-1, 2), axis=1)
    assert np.mean(away > sort.SIDE / 2) > 0.8


@pytest.mark.parametrize("scene", MOVING)
def test_no_range_ends_so_near_the_truth_that_the_blur_moves_the_minimum(scene):
    """Values beyond a range are rendered at its end: the mean of a blur across it is another."""
    for unknown in parsed(scene):
        margin = 2.5 * unknown.blur.end
        assert np.all(unknown.truth - margin >= unknown.low), unknown.key
        assert np.all(unknown.truth + margin <= unknown.high), unknown.key
