"""Gradients by shapes against differences of images; and what is broken on purpose is noticed."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from isas_cli.scenes import kirby, meshes, stage
from scenes_for_tests import TEXTURE, dictionary, render_targets, without_targets
from shapes_for_tests import (
    COUNT,
    KEY,
    STEP,
    agrees,
    ball,
    differences,
    egg,
    estimates,
    problem,
    screened,
    shaped,
)

from isas_cli import losses
from isas_cli.config.schema import PoseConfig, UnknownConfig
from isas_cli.estimators import mitsuba
from isas_cli.estimators.silhouettes import Settings
from isas_cli.rendering import silhouettes
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime.errors import InputError

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


@pytest.fixture(scope="module")
def plain() -> dict:
    p = problem()
    exact = differences(p, ["right", "up", "scale", "bump"])
    return {"problem": p, "exact": exact}


def test_along_movements_of_all_and_of_some_vertices(plain):
    """Seen: 1.000 ± 0.007 along ``scale``, 0.999 ± 0.017 to the right."""
    found = estimates(plain["problem"], 2 * COUNT, batch=1 << 16)
    for name, exact in plain["exact"].items():
        assert agrees(found[name], exact), name


def test_steps_are_brighter_by_their_views_exposures(plain):
    """Seen: 0.99 ± 0.02 along ``scale``; the interior and the edges do without them not agree."""
    p = problem()
    p.views.exposure = dr.opaque(mi.Float, 1, 9) * mi.Float([1, 1, 1, 2, 0.5, 1.5, 0.2, 0.3, 0.4])
    exact = differences(p, ["right", "up", "scale"])
    assert all(right(estimates(p, 2 * COUNT, batch=1 << 15), exact))
    assert not all(right(plain["exact"], exact))


def right(found: dict, exact: dict, names=("right", "up", "scale")) -> list[bool]:
    return [agrees(found[name], exact[name]) for name in names]


def test_of_edges_drawn_otherwise_and_1_over_p_left_out_is_noticed(plain, monkeypatch):
    """The mean does not depend on the probabilities."""
    lengths, draw = silhouettes.lengths, silhouettes.draw

    def uneven(*given):
        """Four times as often in the first of three views."""
        found = lengths(*given)
        first = dr.arange(mi.UInt32, dr.width(found)) < dr.width(found) // 3
        return found * dr.select(first, mi.Float(4), 1)

    def alike(*given):
        """All with the same probability, one over the number of edges that may be drawn."""
        found = draw(*given)
        number = dr.mean(dr.select(found.probability > 0, 1 / found.probability, 0))
        found.probability = dr.select(found.probability > 0, 1 / number, 0)
        return found

    monkeypatch.setattr(silhouettes, "lengths", uneven)
    assert all(right(estimates(plain["problem"], COUNT), plain["exact"]))
    monkeypatch.setattr(silhouettes, "draw", alike)
    assert not all(right(estimates(plain["problem"], 4, freeze=False), plain["exact"]))


def test_one_path_for_residual_and_difference_is_noticed(plain, monkeypatch):
    kept, made = [], silhouettes.without_film

    class Keeping:
        """Of what is convex: behind its outline is the sky."""

        def __init__(self, base):
            self.base = made(base)

        def sample_radiance_difference(self, scene, found, *rest):
            step, more = self.base.sample_radiance_difference(scene, found, *rest)
            beyond = dr.zeros(mi.SurfaceInteraction3f, dr.width(found.d))
            beyond.wi = -found.d
            kept.append(step + scene.environment().eval(beyond))
            return step, more

    def same(integrator, loss, scene, sensors, films, targets, mask, share, crossing, *rest):
        target = dr.gather(mi.Color3f, targets, crossing.pixel)
        return dr.select(crossing.valid, loss.derivative(kept.pop(), target) * share, 0)

    monkeypatch.setattr(silhouettes, "without_film", Keeping)
    monkeypatch.setattr(silhouettes, "residual", same)
    assert not all(right(estimates(plain["problem"], 6, freeze=False), plain["exact"]))


def test_along_some_vertices_of_a_silhouette():
    """About every fourth of those that the view has, outwards. Where single vertices move, the
    outline has corners, and differences need shorter steps: of 0.016, 0.008, 0.004 and 0.002 they
    say 0.052, 0.058, 0.063 and 0.065 ± 0.002, and the estimate 0.0631 ± 0.0001."""
    p = problem(views=1)
    x, topology = egg(p).astype(np.float64), p.unknowns[KEY].kind.topology
    a, b, c = (x[topology.faces[:, corner]] for corner in range(3))
    eye = np.array(p.scene.sensors()[0].world_transform().translation()).ravel()
    turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), eye - a) > 0
    one, other = turned[topology.edges.faces.T]
    chosen = np.unique(topology.edges.ends[one != other])[::4]
    assert 6 < len(chosen) < 20
    way = np.zeros_like(x)
    way[chosen] = x[chosen]
    exact = differences(p, ways={"rim": way}, spp=2048, step=STEP / 4)["rim"]
    found = estimates(p, COUNT, batch=1 << 16, ways={"rim": way})["rim"]
    assert agrees(found, exact)


def test_pixels_that_a_mask_weighs(plain):
    p = plain["problem"]
    whole = p.targets, None, "test"
    rng = np.random.default_rng(4)
    weights = rng.random(p.views.total) * (np.arange(p.views.total) % 32 < 16)
    try:
        p.set_targets(p.targets, mi.Float(weights), "test")
        exact, found = differences(p, ["right", "scale"]), estimates(p, COUNT, batch=1 << 16)
    finally:
        p.set_targets(*whole)
    assert all(right(found, exact, exact))
    assert not all(right(found, plain["exact"], exact))  # without it


@pytest.mark.slow  # that seams are welded is in tests/unknowns
def test_seams_of_the_file_are_no_borders(plain):
    found = estimates(problem(seams=True), COUNT)
    for name in ("right", "scale"):
        assert agrees(found[name], plain["exact"][name]), name


def test_hidden_edges_bring_nothing_and_counting_them_is_noticed(monkeypatch):
    p = problem(views=1, **hidden())
    # So that the board has a residual, which its hidden edges would be weighed with.
    p.set_targets(p.targets + 0.3, None, "test")
    exact = differences(p, ["right", "up", "scale"])

    assert all(right(estimates(p, COUNT, batch=1 << 16), exact))
    monkeypatch.setattr(silhouettes, "hidden_by_nothing", lambda scene, ray, active: active)
    assert not all(right(estimates(p, COUNT, batch=1 << 16), exact))


def flat(**more) -> dict[str, np.ndarray]:
    """Of a figure that is black before a bright sky, on which no light but that falls."""
    p = problem(views=1, side=16, integrator={"type": "prb", "max_depth": 1}, **more)
    p.set_targets(dr.opaque(mi.Float, 0.3, 3 * p.views.total), None, "grey")
    found = estimates(p, 2, batch=1 << 12)
    return {name: found[name] for name in ("right", "up", "scale")}


def test_what_a_near_clip_plane_cuts_away_hides_no_edges():
    plain, found = flat(), flat(**screened(kirby.build(1, 16, 1)["sensor_000"]))
    for name, expected in plain.items():
        assert np.abs(expected).min() > 1e-3
        np.testing.assert_allclose(found[name], expected, rtol=1e-2, err_msg=name)


def test_there_are_no_edges_beyond_a_far_clip_plane():
    sensor = kirby.build(1, 16, 1)["sensor_000"] | {"far_clip": 2.0}
    assert not any(each.any() for each in flat(sensor_000=sensor).values())


def test_replayed_paths_have_the_same_derivatives():
    """prb_projective's, for longer paths, at the depth that is else done in one go."""
    p = problem(views=1, side=24)
    found = []
    for direct in (True, False):
        chosen = Settings(batch=1 << 14, edges=16)
        q = chosen.differentiated(p)
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


@pytest.fixture(scope="module")
def small():
    return problem(views=2, side=16)


def test_frozen_kernels_see_every_update(small):
    p = small
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    steps = []
    for freeze in (True, False):
        chosen = Settings(batch=1024, edges=1024, freeze=freeze)
        estimator = chosen.on(p, losses.L2())
        found: list[np.ndarray] = []
        for i in range(5):
            values = p.unknowns.values_of({KEY: egg(p) * np.float32(1 + 0.05 * i)})
            found.append(np.array(estimator.estimate(values, uniform, 1, i, 0.0)[KEY]))
        steps.append(np.stack(found))
    p.unknowns.write(p.unknowns.starts())
    assert np.isfinite(steps[0]).all()
    np.testing.assert_allclose(*steps, atol=2e-3 * np.abs(steps[1]).max())


def test_what_a_run_met_is_its_own(small):
    """Steps of one run with another's in between, on one estimator, are those without."""
    p = small
    chosen = Settings(batch=1024, edges=1024)
    estimator = chosen.on(p, losses.L2())
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    values = p.unknowns.values_of({KEY: egg(p)})

    def steps(memory: list, first: int) -> tuple[np.ndarray, list]:
        estimator.memory = memory
        for i in range(first, first + 2):
            gradient = estimator.estimate(values, uniform, 1, i, 0.0)[KEY]
        return np.array(gradient), estimator.memory

    fresh = estimator.memory
    _, met = steps(fresh, 0)
    alone, _ = steps(met, 2)
    steps(fresh, 7)
    again, _ = steps(met, 2)
    forgotten, _ = steps(fresh, 2)
    p.unknowns.write(p.unknowns.starts())
    noise = 1e-4 * np.abs(alone).max()  # threads add in another order
    np.testing.assert_allclose(again, alone, atol=noise)
    assert np.abs(forgotten - alone).max() > 10 * noise


def test_a_pose_of_a_mesh():
    """Beside an unknown colour, whose gradient is that of path replay alone."""
    colour, x = "figure.bsdf.reflectance.value", np.float32(0.1)
    poses = {"shift": PoseConfig(kind="translation", objects=["figure"], directions=[[1, 0, 0]])}
    unknowns = {"shift": UnknownConfig(start=0.1), colour: UnknownConfig(start=0.5)}
    p = without_targets(kirby.build(2, 32, 2), unknowns, poses)
    render_targets(p, 256)
    chosen = Settings(batch=1 << 14, edges=1 << 14)
    estimator = chosen.on(p, losses.L2())
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
    assert agrees(shifts, exact)
    # The other part leaves this one alone: the same as without silhouettes.
    two = estimator.inside
    p.unknowns.attach(values)
    two.accumulate(uniform, 1, 0)
    alone = np.array(p.unknowns.gradients()[colour])
    np.testing.assert_allclose(np.array(found[0][colour]), alone, rtol=1e-5)
    p.unknowns.write(values)


def test_a_mesh_that_moves_before_another():
    """The place of what hides, and the shape of what it partly hides, at once. Seen: 0.978 ± 0.007,
    0.985 ± 0.016."""
    eye, (vertices, faces) = kirby_eye(), ball(3, 0.25)
    across = np.cross([0, 1, 0], eye) / np.linalg.norm(np.cross([0, 1, 0], eye))
    front = shaped(vertices + 0.5 * eye + 0.3 * across, faces, "front", [0.1, 0.5, 0.2])
    poses = {
        "shift": PoseConfig(
            kind="translation", objects=["front"], directions=[[float(x) for x in across]]
        )
    }
    unknowns = {KEY: UnknownConfig(start="sphere"), "shift": UnknownConfig(start=0.1)}
    p = without_targets(kirby.build(1, 32, 3) | {"front": front}, unknowns, poses)
    render_targets(p, 256)
    ways = {
        "shift": {KEY: 0 * egg(p), "shift": np.ones(1)},
        "scale": {KEY: egg(p), "shift": np.zeros(1)},
    }
    chosen = Settings(batch=1 << 16, edges=1 << 16, shadows=1 << 15, lamps=64)
    estimator = chosen.on(p, losses.L2())
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    place = {KEY: egg(p), "shift": np.array([0.1], np.float32)}
    values = p.unknowns.values_of(place)
    found = [estimator.estimate(values, uniform, 1, i, 0.0) for i in range(COUNT)]
    p.unknowns.write(values)
    renderer = Renderer(p)

    def image(way: dict, step: float, first: int) -> np.ndarray:
        at = {k: (place[k] + step * way[k]).astype(np.float32) for k in place}
        p.unknowns.write(p.unknowns.values_of(at))
        return renderer.range(0, p.views.total, 1024, lambda i: first + i).astype(np.float64)

    target = np.array(p.targets, np.float64).reshape(-1, 3)
    for name, way in ways.items():
        adjoint = 2 * (image(way, 0, 5) - target) * float(p.share[0])
        steps = ((image(way, STEP, i), image(way, -STEP, i)) for i in (10**6, 2 * 10**6))
        exact = np.array([np.sum(adjoint * (more - less)) / (2 * STEP) for more, less in steps])
        along = [sum(np.sum(np.array(g[key], np.float64) * way[key]) for key in way) for g in found]
        assert agrees(np.array(along), exact), name
    p.unknowns.write(values)


def test_out_of_view_there_is_nothing_and_no_nan():
    p = problem(views=2, side=16)
    chosen = Settings(batch=512, edges=512)
    estimator = chosen.on(p, losses.L2())
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
        chosen.on(p, losses.L2())


@pytest.mark.parametrize("estimator", [Settings(), mitsuba.Settings()])
def test_lamps_that_are_hidden_are_refused(estimator):
    """Those of surfaces: a sky is hidden by all alike."""
    lamp = {"type": "rectangle", "emitter": {"type": "area", "radiance": 1.0}}
    hiding = {"integrator": {"type": "prb", "max_depth": 2, "hide_emitters": True}}
    for more, refused in (
        (hiding, False),
        ({"lamp": lamp}, False),
        (hiding | {"lamp": lamp}, True),
    ):
        scene = kirby.build(1, 8, 1) | more
        p = without_targets(scene, {KEY: UnknownConfig(start="sphere")})
        if not refused:
            estimator.on(p, losses.L2())
            continue
        with pytest.raises(InputError, match="hides 'lamp'.*leave hide_emitters out, or") as found:
            estimator.on(p, losses.L2())
        assert "\n" not in str(found.value)


SHARP = {
    "plastic": {"type": "plastic"},
    "conductor": {"type": "conductor", "material": "none"},
    "mask": {"type": "mask", "opacity": 0.5, "nested": {"type": "diffuse"}},
    "blend": {
        "type": "blendbsdf",
        "weight": 0.5,
        "a": {"type": "diffuse"},
        "b": {"type": "plastic"},
    },
    "rough": {"type": "roughplastic", "alpha": 0.3},
}


@pytest.mark.parametrize("material", SHARP)
def test_what_moves_and_mirrors_is_told_once(material):
    """Seen along ``scale`` against differences, of a ball under a map of a sky, with 3 edges: 3.2
    times as much of plastic, 4.3 of a conductor; 0.99 of rough plastic."""
    figure, mirror = made_of(SHARP[material]), WALL | {"bsdf": {"type": "conductor"}}
    scene = kirby.build(1, 8, 1) | {"figure": figure, "mirror": mirror}
    p = without_targets(scene, {KEY: UnknownConfig(start="sphere")})
    for _ in range(2):
        Settings().on(p, losses.L2())
    rest = [each for each in p.warnings if "'figure' passes through mirror" not in each]
    found = [each for each in p.warnings if "what figure mirrors" in each]
    assert len(found) == len(rest) == (material != "rough")
    assert len(p.warnings) == len(rest) + 1


def test_what_no_path_goes_on_from_has_no_mirrors():
    scene = kirby.build(1, 8, 1) | {"figure": made_of(SHARP["plastic"])}
    scene |= {"integrator": {"type": "prb", "max_depth": 1}}
    p = without_targets(scene, {KEY: UnknownConfig(start="sphere")})
    Settings().on(p, losses.L2())
    assert not p.warnings


@pytest.mark.parametrize("depth", [2, 3])
def test_the_derivative_of_what_moves_and_mirrors_is_wrong_still(depth):
    """Else nothing is to be told."""
    scene = {"figure": made_of(SHARP["conductor"]), "sky": {"type": "envmap", "bitmap": sky()}}
    scene |= {"integrator": {"type": "prb", "max_depth": depth, "rr_depth": 100}}
    p = problem(views=1, side=24, start="smooth", **scene)
    p.set_targets(dr.opaque(mi.Float, 0.3, 3 * p.views.total), None, "grey")
    at = np.array(p.unknowns[KEY].truth)
    exact = differences(p, ["scale"], at=at, spp=128)["scale"]
    found = estimates(p, 4, at=at, shadows=0)["scale"]
    assert found.mean() / exact.mean() > 2


def made_of(material: dict) -> mi.Mesh:
    vertices, faces = ball(3)
    apart = meshes.from_corners(
        vertices[faces], np.zeros((0, 2)), meshes.corner_normals(vertices, faces)
    )
    return meshes.shape("figure", apart, material)


def sky() -> mi.Bitmap:
    """Bright to one side and above."""
    y, x = (np.mgrid[:32, :64] + 0.5) * (np.pi / 32)
    shades = 1 + np.cos(x) * np.sin(y), 1 + np.cos(y), 0.6 + 0 * x
    return mi.Bitmap(np.stack(shades, axis=-1).astype(np.float32))


def test_where_nothing_moves_no_border_is_followed():
    """Beside a lamp and things that could throw shadows."""
    scene = dictionary()
    p = without_targets(scene, {TEXTURE: 0.5})
    p.set_targets(dr.zeros(mi.Float, 3 * p.views.total), None, "test")
    assert any(shape.is_emitter() for shape in p.scene.shapes())
    assert Settings(batch=64, reflections=4).on(p, losses.L2()).borders == []


def test_what_lies_in_a_group_is_refused():
    scene = dictionary()
    scene["group"] = {"type": "shapegroup", "leaf": {"type": "cube"}}
    scene["one"] = {"type": "instance", "group": {"type": "ref", "id": "group"}}
    pose = {"up": PoseConfig(kind="translation", objects=["group.leaf"], directions=[[0, 1, 0]])}
    p = without_targets(scene, {"up": UnknownConfig(start=0.1)}, pose)
    p.set_targets(dr.zeros(mi.Float, 3 * p.views.total), None, "test")
    with pytest.raises(InputError, match="'group.leaf', which lies in a group"):
        Settings(batch=64).on(p, losses.L2())


def posed(thing: dict):
    """A thing that is to be moved up and down, above a floor at y = 0."""
    scene = dictionary()
    flat = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(3)
    scene = {each: scene[each] for each in ("type", "integrator")} | {
        "floor": WALL | {"to_world": flat},
        "sensor": stage.camera([0.2, 1.6, 3.5], (0.0, 0.4, 0.0), 45.0, 8),
        "sky": {"type": "constant"},
        "thing": thing,
    }
    pose = {"up": PoseConfig(kind="translation", objects=["thing"], directions=[[0, 1, 0]])}
    p = without_targets(scene, {"up": UnknownConfig(start=0.1)}, pose)
    p.set_targets(dr.zeros(mi.Float, 3 * p.views.total), None, "test")
    Settings(batch=64, edges=64).on(p, losses.L2())
    return p


def test_meshes_whose_outer_side_is_not_known_are_refused():
    """Both sides of the first look alike in images, and the second is one of hard edges whose
    to_world mirrors; Mitsuba would shade the silhouettes of both from within."""
    vertices, faces = ball(2, 0.3)
    vertices = (vertices + np.array([0, 0.5, 0])).astype(np.float32)

    def thing(turned: np.ndarray, material: dict) -> mi.Mesh:
        normals = meshes.corner_normals(vertices, turned)
        apart = meshes.from_corners(vertices[turned], np.zeros((0, 2)), normals)
        return meshes.shape("thing", apart, material)

    matt, inwards = {"type": "diffuse"}, np.ascontiguousarray(faces[:, ::-1])
    both = {"type": "twosided", "bsdf": matt}
    posed(thing(faces, both))
    posed(thing(inwards, matt))  # of one side: black from there
    with pytest.raises(InputError, match="'thing' moves, and its normals point inwards"):
        posed(thing(inwards, both))
    for side in (0.3, -0.3):
        to_world = mi.ScalarTransform4f().translate([0, 0.5, 0]).scale([side, 0.3, 0.3])
        cube = {"type": "cube", "to_world": to_world, "bsdf": WALL["bsdf"]}
        if side > 0:
            posed(cube)
            continue
        with pytest.raises(InputError, match="hard edges, and its triangles turn the other way"):
            posed(cube)


def test_holes_of_what_is_posed_are_told_and_small_ones_leave_it_an_inside():
    vertices, faces = ball(2, 0.3)
    vertices = (vertices + np.array([0, 0.5, 0])).astype(np.float32)
    both = {"type": "twosided", "bsdf": {"type": "diffuse"}}

    def thing(kept: np.ndarray) -> mi.Mesh:
        normals = meshes.corner_normals(vertices, kept)
        apart = meshes.from_corners(vertices[kept], np.zeros((0, 2)), normals)
        return meshes.shape("thing", apart, both)

    bowl = faces[(vertices[faces][..., 1] < 0.55).all(axis=1)]
    # Whose holes face each other.
    ring = faces[(np.abs(vertices[faces][..., 1] - 0.5) < 0.2).all(axis=1)]
    for kept in (faces, faces[1:], bowl, bowl[:, ::-1].copy(), ring, ring[:, ::-1].copy()):
        told = [each for each in posed(thing(kept)).warnings if "edges are open" in each]
        assert len(told) == (len(kept) < len(faces))
        assert all(each.startswith("mesh thing: ") and "biased" in each for each in told)
    with pytest.raises(InputError, match="'thing' moves, and its normals point inwards"):
        posed(thing(np.ascontiguousarray(faces[1:, ::-1])))


@pytest.mark.parametrize("height, told", [(0.2, True), (0.3, False), (0.5, False)])
def test_what_passes_through_something_else_is_told(height, told):
    """And what stands on it is not: the line where two meet is an edge of neither."""
    to_world = mi.ScalarTransform4f().translate([0, height, 0]).scale(0.3)
    warnings = posed({"type": "cube", "to_world": to_world, "bsdf": WALL["bsdf"]}).warnings
    assert any("'thing' passes through floor" in each for each in warnings) is told
