"""Where effects may be left out and where they must not: scenes with one way to an unknown."""

import mitsuba as mi
import numpy as np
import pytest
from gradient_estimates import Gradients, configured
from scenes_for_tests import render_targets, without_targets

from isas_cli import effects
from isas_cli.effects import probe
from isas_cli.effects.settings import Effects
from isas_cli.losses import L2
from isas_cli.rendering.integrators import Paths
from isas_cli.runtime.errors import InputError

KEY = "thing.bsdf.reflectance.value"
DEPTH = 6


BATCHES = 24  # of a probe


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))


def to():
    return mi.ScalarTransform4f()


def grey(value: float) -> dict:
    return {"type": "diffuse", "reflectance": {"type": "uniform", "value": value}}


def ball(radius: float, bsdf: dict) -> dict:
    return {"type": "sphere", "radius": radius, "bsdf": bsdf}


def square(place, bsdf: dict) -> dict:
    return {"type": "rectangle", "to_world": place, "bsdf": bsdf}


GLASS = {"type": "dielectric"}


def alone():
    """Convex, under a sky."""
    return {"thing": ball(1.0, grey(0.5))}, [0, 0, 4]


def behind_glass():
    """In a ball of glass: light comes and goes through it."""
    return {"thing": ball(0.4, grey(0.5)), "shell": ball(1.0, GLASS)}, [0, 0, 4]


def in_a_caustic():
    """A floor under a dome of glass, where the camera is too: no shadow ray reaches the sky."""
    floor = square(to().translate([0, -0.5, 0]).rotate([1, 0, 0], -90).scale(0.6), grey(0.5))
    return {"thing": floor, "dome": ball(2.0, GLASS)}, [0, 1, 1]


def under_a_mask():
    """The same under a dome that lets half of the light through as it comes."""
    shapes, origin = in_a_caustic()
    mask = {"type": "mask", "opacity": 0.5, "bsdf": grey(0.5)}
    return shapes | {"dome": ball(2.0, mask)}, origin


def a_bead():
    """Beside a speck of glass, whose caustic is a small share of what lights it."""
    bead = ball(0.03, GLASS) | {"to_world": to().translate([0, 1.0, 0])}
    return {"thing": ball(0.8, grey(0.5)), "bead": bead}, [0, 0, 4]


def out_of_sight():
    """Behind the camera, which sees the floor that it lights."""
    thing = square(to().translate([0, 1, 4]).rotate([0, 1, 0], 180).scale(3), grey(0.9))
    floor = square(to().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(9), grey(0.8))
    return {"thing": thing, "floor": floor}, [0, 1, 3]


def problem(build):
    """``build`` gives shapes and where the camera is, which looks at the origin."""
    shapes, origin = build()
    scene = {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": DEPTH, "rr_depth": 100},
        "sky": {"type": "constant"},
        **shapes,
        "sensor_000": {
            "type": "perspective",
            "fov": 25,
            "to_world": to().look_at(origin, [0, -0.1, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16},
        },
    }
    p = without_targets(scene, {KEY: 0.2})
    render_targets(p, 64)
    return p


def decided(p, seconds=None, **settings) -> effects.Plan:
    """Light samples are not asked for here: to measure them compiles most."""
    settings = Effects(light_samples=[1, 1], directions=1, **settings)
    return effects.decide(p, settings, configured("estimator", "two_path"), L2(), seconds)


@pytest.mark.parametrize(
    "build, least",
    [(behind_glass, 4), (in_a_caustic, 3), (out_of_sight, 3)],
    ids=["glass", "caustic", "out of sight"],
)
def test_the_only_way_to_an_unknown_stays(build, least):
    """However wide the tolerances, and though no shorter path would be noticed in the images."""
    p = problem(build)
    for name in ("max_depth", "derivative_depth"):
        with pytest.raises(InputError, match=f"effects.{name}={least - 1}: .*'{KEY}'"):
            decided(p, **{name: least - 1})
        decided(p, **{name: least})
    plan = decided(p, 60.0, tolerance=0.99, derivative_tolerance=0.99)
    print(plan.paths, plan.cuts, plan.derivatives)
    assert plan.views is None
    assert plan.paths.depth >= least and plan.paths.derivative >= least


@pytest.mark.parametrize(
    "build, kept", [(in_a_caustic, True), (behind_glass, True), (a_bead, False)]
)
def test_caustics_go_where_they_are_little_and_stay_where_they_are_the_light(build, kept):
    plan = decided(problem(build), 60.0, max_depth=DEPTH)
    print(plan.statements["caustics"], plan.caustics)
    assert plan.paths.caustics is plan.record()["caustics"] is kept
    assert ("simulated" if kept else "left out") in plan.statements["caustics"]


def test_caustics_can_be_set():
    beside = problem(a_bead)
    kept = decided(beside, 60.0, caustics=True, max_depth=DEPTH)
    assert kept.paths.caustics and "as set" in kept.statements["caustics"]
    assert kept.caustics is None
    for build in (in_a_caustic, under_a_mask):
        with pytest.raises(InputError, match=f"effects.caustics=false: .*'{KEY}'"):
            decided(problem(build), caustics=False)
    plan = decided(problem(alone), 60.0)
    assert plan.caustics is None and "not met" in plan.statements["caustics"]
    short = decided(beside, max_depth=2)
    assert "not met" in short.statements["caustics"]
    ended = decided(beside, caustics=False, finish=0.5)
    assert not ended.paths.caustics and "50%" in ended.statements["finish"]
    assert ended.on(beside, finish=True).integrator.paths.caustics


def test_the_share_of_a_caustic_is_what_it_brings():
    """Under a dome it is all of the gradient and of the floor's radiance, but not the sky that the
    camera sees through the glass."""
    found = probe.Probe(problem(in_a_caustic), L2(), 1).caustics()
    assert found.gradient[KEY].value == pytest.approx(1, abs=1e-3)
    assert 0.05 < found.image.value < 0.95


def test_a_convex_object_alone_is_done_with_two_edges():
    """Nothing is lost: the same gradient, batch by batch."""
    p = problem(alone)
    plan = decided(p, 60.0)
    assert (plan.paths.depth, plan.paths.derivative) == (2, 2)
    rows = []
    whole = p.integrator.max_depth
    for paths in (Paths(whole, whole, crossed=False), Paths(2, 2, crossed=False)):
        p.integrator = p.integrator.cut(paths)
        rows.append(Gradients(p, L2(), 1024).uniform(4, 3))
    assert np.allclose(*rows, rtol=1e-4)


def test_lobes_that_are_off_are_not_there():
    """A rule that needs no code here, as Mitsuba has it: a strength of 0 is no lobe."""

    def lobes(**strengths) -> int:
        return mi.load_dict({"type": "principled", **strengths}).component_count()

    off = dict.fromkeys(("clearcoat", "sheen", "spec_trans", "flatness"), 0.0)
    assert lobes(**off) == lobes() < min(lobes(clearcoat=0.5), lobes(spec_trans=0.5))


def test_decisions_are_those_of_shares_in_closed_form():
    """Of radiance 1 from the upper of two wide plates the lower one's is Σ ρ (ρσ)^i, i of every two
    edges; what more than d edges bring to the gradient is left out just above their share."""
    start, truth, other = 0.2, 0.5, 0.5

    def plates():
        wide = 500.0
        lower = square(to().rotate([1, 0, 0], -90).scale(wide), grey(truth))
        upper = square(to().translate([0, 1, 0]).rotate([1, 0, 0], 90).scale(wide), grey(other))
        upper["emitter"] = {"type": "area", "radiance": 1.0}
        return {"thing": lower, "upper": upper}, [0.1, 0.9, 0]

    def radiance(edges: int, albedo: float) -> float:
        return sum(albedo * (albedo * other) ** i for i in range(edges // 2))

    def gradient(edges: int, derivative: int) -> float:
        slope = sum((i + 1) * (start * other) ** i for i in range(derivative // 2))
        return (radiance(edges, start) - radiance(DEPTH, truth)) * slope

    p, every = problem(plates), gradient(DEPTH, DEPTH)
    shares = {d: 1 - gradient(d, d) / every for d in (2, 4)}
    slopes = {d: 1 - gradient(DEPTH, d) / every for d in (2, 4)}
    print(shares, slopes)
    assert decided(p, 60.0).paths.depth == DEPTH, "concave, by what it is where nothing is set"
    for above, depth in ((1.1 * shares[2], 2), (1.1 * shares[4], 4), (0.9 * shares[4], DEPTH)):
        plan = decided(p, 60.0, tolerance=above, derivative_tolerance=1e-4)
        print(plan.cuts)
        assert plan.paths.depth == depth
    for above, depth in ((1.1 * slopes[2], 2), (1.1 * slopes[4], 4), (0.9 * slopes[4], DEPTH)):
        plan = decided(p, 60.0, tolerance=1e-4, derivative_tolerance=above)
        assert (plan.paths.depth, plan.paths.derivative) == (DEPTH, depth)
