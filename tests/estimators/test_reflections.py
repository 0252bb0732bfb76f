"""Gradients by silhouettes that other surfaces show, against differences of images."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from isas_cli.scenes.cameras import perspective
from shapes_for_tests import (
    COUNT,
    KEY,
    agrees,
    ball,
    differences,
    egg,
    estimates,
    problem,
    shaped,
)

from isas_cli import losses
from isas_cli.estimators.silhouettes import Settings
from isas_cli.rendering import reflections
from isas_cli.rendering.outline import Eyes, Outline, silhouettes
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.rendering.rays import stream
from isas_cli.runtime.errors import InputError
from isas_cli.scene.topology import Topology

BRIGHT = {"type": "rgb", "value": [0.8, 0.8, 0.8]}
MATERIALS = {
    "glossy": {
        "type": "roughconductor",
        "alpha": 0.2,
        "material": "none",
        "specular_reflectance": BRIGHT,
    },
    "matt": {"type": "diffuse", "reflectance": BRIGHT},
}


def above_a_floor(material: str, depth: int = 4, colour: float = 0.05) -> dict:
    """A ball outside of the image, which shows the floor below it."""
    floor = mi.ScalarTransform4f().translate([0, -1.1, 0]).rotate([1, 0, 0], -90).scale(6)
    return {
        "figure": shaped(*ball(3), colour=[colour] * 3),
        "floor": {"type": "rectangle", "to_world": floor, "bsdf": MATERIALS[material]},
        "sky": {"type": "constant", "radiance": 1.0},
        "integrator": {"type": "prb", "max_depth": depth, "rr_depth": 100},
        "sensor_000": perspective((0.0, 2.0, 6.0), (0.0, -1.1, 1.8), 16.0, 32),
    }


@pytest.mark.parametrize("material", ["glossy", pytest.param("matt", marks=pytest.mark.slow)])
def test_what_only_a_floor_shows(material):
    """By two cameras. Seen: 1.01 ± 0.03 and 1.03 ± 0.06 by a glossy floor; by a matt one, with four
    times as many samples, 0.998 ± 0.006 and 1.001 ± 0.008. (With an edge more 0.989 and 0.978 ±
    0.006: some light goes by way of both.) Without these samples nothing."""
    scene = above_a_floor(material, 3)
    scene["sensor_001"] = perspective((-2.0, 2.4, 5.0), (0.2, -1.1, 1.5), 16.0, 32)
    p = problem(views=2, **scene)
    exact = differences(p, ["scale", "up"], spp=256)
    found = estimates(p, COUNT, shadows=0, reflections=1 << 15)
    for name, each in exact.items():
        assert agrees(found[name], each), name
    missing = estimates(p, 3, shadows=0)["scale"]
    assert abs(missing.mean()) < 0.1 * abs(exact["scale"].mean())


@pytest.mark.slow
def test_lamps_are_the_part_of_shadows_where_these_are_sampled():
    """A bright ball lights the floor that it shades. Seen: 0.97 ± 0.05, all by reflections 1.01 ±
    0.03, all by shadows 1.18 ± 0.03. (With an edge more 0.78, 0.82 and 1.29: light goes by way of
    ball and floor.)"""
    lamp = {
        "type": "sphere",
        "center": [1.5, 4.0, 3.0],
        "radius": 0.4,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 15.0}},
    }
    sky = {"type": "constant", "radiance": 0.2}
    p = problem(views=1, **above_a_floor("matt", 3, 0.8) | {"sky": sky, "lamp": lamp})
    exact = differences(p, ["scale"])["scale"]
    many = {"shadows": 1 << 17, "lamps": 256}
    assert agrees(estimates(p, 20, reflections=1 << 17, **many)["scale"], exact)
    assert agrees(estimates(p, 20, reflections=1 << 17, shadows=0)["scale"], exact)
    assert not agrees(estimates(p, 20, **many)["scale"], exact)


def floor_of(reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a square below."""
    at = np.linspace(-reach, reach, 13)
    x, z = (each.ravel() for each in np.meshgrid(at, at, indexing="ij"))
    number = np.arange(13 * 13).reshape(13, 13)
    a, b = number[:-1, :-1].ravel(), number[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, a + 1, b + 1], 1), np.stack([a, b + 1, b], 1)])
    return np.stack([x, np.full(x.shape, -1.1), z], 1), faces


def test_what_moves_shows_what_stands_still():
    """A dark ball over a floor that moves. Seen with four times as many: 1.02 ± 0.03
    of all of it, 0.95 ± 0.10 of its middle; without these samples nothing of all of it."""
    scene = above_a_floor("matt", depth=3) | {
        "figure": shaped(*floor_of(6), colour=[0.8] * 3),
        "ball": shaped(*ball(3), id="ball", colour=[0.05] * 3),
    }
    del scene["floor"]
    p = problem(views=1, start="smooth", **scene)
    at = (np.array(p.unknowns[KEY].truth) - [0, 0.1, 0]).astype(np.float32)
    near = np.exp(-np.sum((at - [0, -1.2, 1.8]) ** 2, axis=1, keepdims=True))
    ways = {"up": np.broadcast_to([0, 1.0, 0], at.shape), "here": near * [0, 1.0, 0]}
    exact = differences(p, at=at, ways=ways, spp=1024)
    more = {"at": at, "ways": ways, "shadows": 0}
    found = estimates(p, COUNT, reflections=1 << 17, **more)
    missing = estimates(p, 3, **more)
    for name, each in exact.items():
        assert agrees(found[name], each), name
    assert not agrees(missing["up"], exact["up"])


@pytest.mark.slow
def test_what_moves_shows_what_moves():
    """Ball and floor as one mesh. Seen with four times as many: 0.94 ± 0.07 of the floor's, 1.01 ±
    0.04 of the ball's. Longer paths would see the ball's silhouettes by way of the ball and the
    floor, which are left out: 1.39 and 0.83."""
    (below, floor), (vertices, faces) = floor_of(24), ball(4)
    faces = np.concatenate([faces, floor + len(vertices)])
    vertices = np.concatenate([vertices, below])
    scene = above_a_floor("matt", depth=3) | {"figure": shaped(vertices, faces, colour=[0.6] * 3)}
    del scene["floor"]
    p = problem(views=1, start="smooth", **scene)
    at = np.array(p.unknowns[KEY].truth)
    below = np.abs(at[:, 1:2] + 1.1) < 1e-6
    at = np.where(below, at, 0.85 * at).astype(np.float32)
    ways = {"floor": below * [0, 1.0, 0], "ball": ~below * [0, 1.0, 0]}
    exact = differences(p, at=at, ways=ways, spp=2048)
    found = estimates(p, COUNT, at=at, ways=ways, batch=1 << 17, shadows=0, reflections=1 << 17)
    for name, each in exact.items():
        assert agrees(found[name], each), name


def test_lines_that_touch_an_edge():
    """Of all directions, those that an edge is a silhouette in: as many as the measure says, and
    all that are drawn are."""
    tent = np.array([[0, 0, 0], [0, 0, 2.0], [1, -0.4, 1], [-1, -0.7, 1], [3, 0, 0]])
    for faces in ([[0, 1, 2], [1, 0, 3]], [[1, 0, 2], [0, 1, 3]]):
        topology = Topology.of(tent, np.array(faces))
        outline = Outline.of(topology)
        positions = mi.Float(tent[topology.first].ravel().astype(np.float32))
        ridge = int(np.flatnonzero(topology.edges.faces[:, 0] != topology.edges.faces[:, 1])[0])
        for edge in (ridge, (ridge + 1) % outline.count):
            count = 1 << 16
            chosen = dr.full(mi.UInt32, edge, count)
            measure, across, beyond, turn = reflections._turn(positions, outline, chosen)
            ends = topology.first[topology.edges.ends[edge]]
            along = mi.Vector3f((tent[ends[1]] - tent[ends[0]]).tolist())
            random = stream(mi.UInt32(3), count)
            way = reflections._direction(along, across, beyond, turn, random)

            def seen(way) -> np.ndarray:
                eyes = Eyes(way, dr.zeros(mi.Float, count))
                number = dr.arange(mi.UInt32, count)
                return np.array(silhouettes(positions, outline, eyes, chosen, number))

            assert seen(way).mean() > 0.999
            assert dr.allclose(dr.norm(way), 1, atol=1e-5)
            share = seen(mi.warp.square_to_uniform_sphere(random.next_2d())).mean()
            expected = measure[0] / np.linalg.norm(tent[ends[1]] - tent[ends[0]]) / (4 * np.pi)
            assert abs(share - expected) < 0.01, (share, expected)


def test_frozen_kernels_see_every_update_and_nothing_is_nan():
    scene = above_a_floor("matt")
    own = {key: scene[key] for key in ("floor", "integrator")}
    p = problem(views=2, side=16, level=2, **own)
    uniform, x = PixelDistribution.uniform(Tiles.over(p.views)), egg(p)
    beyond, flat = x + np.float32(50), x * np.float32([1, 1, 0])
    steps = []
    for freeze in (True, False):
        chosen = Settings(batch=512, edges=512, shadows=0, reflections=2048, freeze=freeze)
        estimator = chosen.on(p, losses.L2())
        found = []
        for i, place in enumerate((x, x * np.float32(1.1), beyond, flat)):
            values = p.unknowns.values_of({KEY: place})
            found.append(np.array(estimator.estimate(values, uniform, 1, i, 0.0)[KEY]))
        steps.append(np.stack(found))
    assert np.isfinite(steps[0]).all() and not steps[0][2].any()
    for frozen, traced in zip(*steps):
        assert np.allclose(frozen, traced, atol=2e-3 * np.abs(traced).max())


def test_what_cannot_be_is_refused():
    with pytest.raises(InputError, match="estimator.reflections must be 0 or more, not -1"):
        Settings(reflections=-1)
    with pytest.raises(InputError, match="have 3 edges.*most 2: take scene.max_depth=3 or more$"):
        Settings(reflections=9).reflected(problem(views=1, side=8, level=1))
