"""Gradients by shapes against differences of images; and what is broken on purpose is noticed."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from isas_cli.scenes import kirby
from isas_cli.scenes.cameras import orbit, perspective
from scenes_for_tests import render_targets, without_targets
from shapes_for_tests import KEY, STEP, differences, egg, estimates, problem

from isas_cli import losses
from isas_cli.config.schema import PoseConfig, UnknownConfig
from isas_cli.estimators.silhouettes import Settings
from isas_cli.rendering import silhouettes
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime.errors import InputError

COUNT = 12
# What the step of the differences is wrong by.
EXACT = 0.02
WALL = {
    "type": "rectangle",
    "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.1, 0.5, 0.2]}},
}


def hidden() -> dict:
    """Near the first camera, a board that hides the figure's right half from it; small, as its
    shadow on the figure has edges that are left out."""
    eye, middle = kirby_eye(), np.zeros(3)
    look = mi.ScalarTransform4f().look_at(
        origin=(eye + 0.2 * (middle - eye)).tolist(), target=middle.tolist(), up=[0, 1, 0]
    )
    return {"board": WALL | {"to_world": look.translate([-0.2, 0, 0]).scale([0.2, 0.3, 1])}}


def kirby_eye() -> np.ndarray:
    sensor = mi.load_dict(kirby.build(1, 8, 1)["sensor_000"])
    return np.array(sensor.world_transform().translation()).ravel()


def agrees(found: np.ndarray, exact: np.ndarray, scale: float) -> bool:
    """Within three standard errors of both, and what the differences' step is good for."""
    error = math.hypot(*(each.std(ddof=1) / math.sqrt(len(each)) for each in (found, exact)))
    share = found.mean() / exact.mean()
    print(f"{share:.3f} ± {error / abs(exact.mean()):.3f} of the differences")
    return abs(found.mean() - exact.mean()) < 3 * error + EXACT * scale


def size(exact: np.ndarray) -> float:
    return abs(exact.mean())


@pytest.fixture(scope="module")
def plain() -> dict:
    p = problem()
    exact = differences(p, ["right", "up", "scale", "bump"])
    return {"problem": p, "exact": exact}


def test_along_movements_of_all_and_of_some_vertices(plain):
    """Seen: 1.000 ± 0.007 along ``scale``, 0.999 ± 0.017 to the right."""
    found = estimates(plain["problem"], 2 * COUNT, batch=1 << 16)
    for name, exact in plain["exact"].items():
        assert agrees(found[name], exact, size(exact)), name


def test_of_pixels_and_edges_drawn_otherwise(plain, monkeypatch):
    """The mean does not depend on the probabilities: 1/P is there, and right."""
    lengths = silhouettes._lengths

    def uneven(*given):
        found = lengths(*given)
        number = dr.arange(mi.UInt32, dr.width(found))
        return found * dr.select(number % 3 == 0, mi.Float(4), 1)

    monkeypatch.setattr(silhouettes, "_lengths", uneven)
    found = estimates(plain["problem"], COUNT)
    for name in ("right", "up", "scale"):
        assert agrees(found[name], plain["exact"][name], size(plain["exact"][name])), name


def test_seams_of_the_file_are_no_borders(plain):
    found = estimates(problem(seams=True), COUNT)
    for name in ("right", "scale"):
        assert agrees(found[name], plain["exact"][name], size(plain["exact"][name])), name


def test_hidden_edges_bring_nothing_and_counting_them_is_noticed(monkeypatch):
    p = problem(views=1, **hidden())
    # So that the board has a residual, which its hidden edges would be weighed with.
    p.set_targets(p.targets + 0.3, None, "test")
    exact = differences(p, ["right", "up", "scale"])

    def right(found: dict) -> list[bool]:
        return [agrees(found[name], each, size(each)) for name, each in exact.items()]

    assert all(right(estimates(p, COUNT, batch=1 << 16)))
    monkeypatch.setattr(silhouettes, "hidden_by_nothing", lambda scene, ray, active: active)
    assert not all(right(estimates(p, COUNT, batch=1 << 16)))


def test_replayed_paths_have_the_same_derivatives():
    """prb_projective's, for longer paths, at the depth that is else done in one go."""
    p = problem(views=1, side=24)
    found = []
    for direct in (True, False):
        chosen = Settings(batch=1 << 14, edges=16)
        q = chosen.on(p)
        if not direct:
            q.integrator.direct = False
            q.integrator.projective = mi.load_dict(
                {"type": "prb_projective", "max_depth": 2, "sppi": 0}
            )
        values = p.unknowns.values_of({KEY: egg(p)})
        uniform = PixelDistribution.uniform(Tiles.over(p.views))
        p.unknowns.attach(values)
        chosen.made(q, losses.L2()).inside.accumulate(uniform, 1, 0)
        found.append(np.array(p.unknowns.gradients()[KEY]))
    p.unknowns.write(p.unknowns.starts())
    # The random numbers are not spent in the same order.
    difference = np.linalg.norm(found[0] - found[1]) / np.linalg.norm(found[0])
    print(f"differ by {difference:.3f}")
    assert difference < 0.1


LAMPS = {
    "ball": {
        "type": "sphere",
        "center": [3.0, 1.0, -2.0],
        "radius": 0.3,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [90.0, 90.0, 90.0]}},
    },
    "point": {"type": "point", "position": [3.0, 1.0, -2.0], "intensity": 30.0},
    "sun": {"type": "directional", "direction": [-3.0, -1.4, 2.0], "irradiance": 2.0},
}


def shadow(lamp: str) -> dict:
    """A lamp throws the figure's shadow on a floor, and a disk hides the figure from the camera."""
    place = mi.ScalarTransform4f()
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.8, 0.8]}}
    floor = place.translate([0, -1.1, 0]).rotate([1, 0, 0], -90).scale(6)
    eye = orbit((0, 0, 0), 9.0, 40.0, 50.0)
    near = place.look_at(origin=(np.array(eye) * 8 / 9).tolist(), target=[0, 0, 0], up=[0, 1, 0])
    return {
        "floor": {"type": "rectangle", "to_world": floor, "bsdf": grey},
        "board": {"type": "disk", "to_world": near.scale(0.17), "bsdf": grey},
        "sky": {"type": "constant", "radiance": 0.05},
        "lamp": LAMPS[lamp],
        "sensor_000": perspective(eye, (0, 0, 0), 35.0, 32),
    }


@pytest.mark.parametrize("lamp", LAMPS)
def test_what_only_a_shadow_shows(lamp):
    """Seen with four times as many: 0.97 ± 0.03, 0.99 ± 0.03, 1.00 ± 0.02 along ``scale``. Without
    samples of shadows' edges nothing is found, which is noticed."""
    p = problem(views=1, **shadow(lamp))
    exact = differences(p, ["right", "scale"])
    found = estimates(p, COUNT, shadows=1 << 16, lamps=64)
    for name, each in exact.items():
        assert agrees(found[name], each, size(each)), name
    missing = estimates(p, 3, shadows=0)["right"]
    assert abs(missing.mean()) < 0.1 * size(exact["right"])


def test_shapes_that_hide_and_shade_parts_of_themselves():
    """Seen: 0.993 ± 0.004, with shadows' edges or without. Of 642 vertices 0.98: smooth normals are
    black along the silhouettes of coarse meshes, and the inner border of that is not sampled."""
    p = problem(views=2, level=5)
    own = 1.1 * np.array(p.unknowns[KEY].truth)
    exact = differences(p, ["scale"], at=own, spp=256)["scale"]
    assert agrees(estimates(p, COUNT, batch=1 << 16, at=own)["scale"], exact, size(exact))


def test_frozen_kernels_see_every_update():
    p = problem(views=2, side=16)
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    steps = []
    for freeze in (True, False):
        chosen = Settings(batch=4096, edges=4096, freeze=freeze)
        estimator = chosen.made(chosen.on(p), losses.L2())
        found: list[np.ndarray] = []
        for i in range(5):
            values = p.unknowns.values_of({KEY: egg(p) * np.float32(1 + 0.05 * i)})
            found.append(np.array(estimator.estimate(values, uniform, 1, i, 0.0)[KEY]))
        steps.append(np.stack(found))
    p.unknowns.write(p.unknowns.starts())
    assert np.isfinite(steps[0]).all()
    np.testing.assert_allclose(*steps, atol=2e-3 * np.abs(steps[1]).max())


def test_a_pose_of_a_mesh():
    """Beside an unknown colour, whose gradient is that of path replay alone."""
    colour, x = "figure.bsdf.reflectance.value", np.float32(0.1)
    poses = {"shift": PoseConfig(kind="translation", objects=["figure"], directions=[[1, 0, 0]])}
    unknowns = {"shift": UnknownConfig(start=0.1), colour: UnknownConfig(start=0.5)}
    p = without_targets(kirby.build(2, 32, 2), unknowns, poses)
    render_targets(p, 256)
    chosen = Settings(batch=1 << 14, edges=1 << 14)
    estimator = chosen.made(chosen.on(p), losses.L2())
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    values = p.unknowns.starts()
    found = [estimator.estimate(values, uniform, 1, i, 0.0) for i in range(COUNT)]
    p.unknowns.write(values)
    renderer = Renderer(p)

    def image(place: float, first: int) -> np.ndarray:
        p.unknowns.write(p.unknowns.values_of({"shift": np.array([place], np.float32)}))
        return renderer.range(0, p.views.total, 1024, lambda i: first + i).astype(np.float64)

    target = np.array(p.targets, np.float64).reshape(-1, 3)
    adjoint = 2 * (image(x, 5) - target) * float(p.share[0])
    steps = ((image(x + STEP, i), image(x - STEP, i)) for i in (10**6, 2 * 10**6))
    exact = np.array([np.sum(adjoint * (more - less)) / (2 * STEP) for more, less in steps])
    shifts = np.array([each["shift"][0] for each in found], np.float64)
    assert agrees(shifts, exact, size(exact))
    # The other part leaves this one alone: the same as without silhouettes.
    two = estimator.inside
    p.unknowns.attach(values)
    two.accumulate(uniform, 1, 0)
    alone = np.array(p.unknowns.gradients()[colour])
    np.testing.assert_allclose(np.array(found[0][colour]), alone, rtol=1e-5)
    p.unknowns.write(values)


def test_out_of_view_there_is_nothing_and_no_nan():
    p = problem(views=2, side=16)
    chosen = Settings(batch=512, edges=512)
    estimator = chosen.made(chosen.on(p), losses.L2())
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    beyond = (egg(p) + np.float32(50)).astype(np.float32)
    flat = egg(p) * np.float32([1, 1, 0])
    for place in (beyond, flat):
        values = p.unknowns.values_of({KEY: place})
        found = np.array(estimator.estimate(values, uniform, 1, 0, 0.0)[KEY])
        assert np.isfinite(found).all() and (place is flat or not found.any())
    p.unknowns.write(p.unknowns.starts())


def test_what_it_cannot_follow_is_refused(plain):
    from poses_for_tests import blurred_problem

    p = blurred_problem()  # a sphere, which is no mesh
    chosen = Settings()
    with pytest.raises(InputError, match="which is no mesh: estimator=silhouettes follows meshes"):
        chosen.made(chosen.on(p), losses.L2())
