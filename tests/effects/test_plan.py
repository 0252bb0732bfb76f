"""The plan of effects: what decides it, what it changes, and what is refused."""

import dataclasses
import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from gradient_estimates import Gradients, configured
from runs_for_tests import QUIET, ran, resumed
from scenes_for_tests import (
    ROUGHNESS,
    TEXTURE,
    dictionary,
    problem,
    render_targets,
    under_spots,
    without_targets,
)

from isas_cli import effects
from isas_cli.cli.app import main
from isas_cli.config.schema import BlurConfig, PoseConfig, UnknownConfig
from isas_cli.effects import plan as planning
from isas_cli.effects import probe, rules
from isas_cli.effects.probe import Cut, Lights, Probe, Share, gradient_share, noise_ratio
from isas_cli.effects.settings import Effects
from isas_cli.engine.evaluate import Evaluator
from isas_cli.estimators.staged import Staged
from isas_cli.losses import L2
from isas_cli.rendering import coverage, targets
from isas_cli.rendering.integrators import Paths, adapt
from isas_cli.runtime.errors import InputError
from isas_cli.unknowns import cameras
from isas_cli.unknowns.parameters import as_numpy

WALL = "wall.bsdf.reflectance.value"
ONE = {"light_samples": [1, 1], "directions": 1}  # which then are not measured
# As they are before conftest.py lets probes take as long as they take.
ALLOWED = {name: getattr(planning, name) for name in ("_SHARE", "_MOST")}


def decided(p, seconds=None, estimator="two_path", crossed=True, prior=False, **settings):
    made = configured("estimator", estimator, {} if crossed else {"crossed": False})
    return effects.decide(p, Effects(**settings), made, L2(), seconds, prior=prior)


def furnace(albedo: float, start: float, depth: int):
    """A camera inside a diffuse cube that emits 1: radiance is Σ albedo^i over its bounces."""
    scene = {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": depth, "rr_depth": 100},
        "wall": {
            "type": "cube",
            "flip_normals": True,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": albedo}},
            "emitter": {"type": "area", "radiance": 1.0},
        },
        "sensor_000": {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 0.1], [0.3, 0.2, 1], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16},
        },
    }
    p = without_targets(scene, {WALL: start})
    target = np.full(p.views.total * 3, sum(albedo**i for i in range(depth)), np.float32)
    p.set_targets(mi.Float(target), None, "test")
    p.unknowns.write(p.unknowns.starts())
    return p


@pytest.mark.parametrize("depth", [4, 9])
def test_shares_of_depth_are_those_in_closed_form(depth):
    """Unrolled or replayed in a run; of the image Σρ^i from d on, of the gradient by residual times
    Σiρ^(i-1), both of which lose what longer paths bring."""
    truth, start = 0.5, 0.3
    p = furnace(truth, start, depth)
    measured = Probe(p, L2(), 3)
    target = sum(truth**i for i in range(depth))

    def radiance(d: int) -> float:
        return sum(start**i for i in range(d))

    def gradient(d: int, derivative: int) -> float:
        return (radiance(d) - target) * sum(i * start ** (i - 1) for i in range(1, derivative))

    for edges, derivative in ((2, False), (3, False), (2, True), (3, True)):
        found = measured.cut(edges, derivative)
        own = found.gradient[WALL]
        longest = depth if derivative else edges
        share = abs(1 - gradient(longest, edges) / gradient(depth, depth))
        print(edges, derivative, share, own, found.image)
        assert own.value == pytest.approx(share, abs=0.1 * share + 0.02)
        assert share < own.bound < 1.5 * share + 0.05
        if derivative:
            assert found.image is None
        else:
            image = 1 - radiance(edges) / radiance(depth)
            bound = found.image.bound
            assert found.image.value == pytest.approx(image, abs=3 * (bound - image) + 0.01)
    assert measured.cut(depth, True).gradient[WALL].value == pytest.approx(0, abs=1e-4)
    assert measured.seconds > 0


def test_a_short_derivative_vanishes_where_the_whole_one_does():
    """At the truth: what it lacks moves no result. Shorter paths do: they lack radiance."""
    p, means = furnace(0.5, 0.5, 4), []
    for paths in (Paths(4, 2), Paths(2, 2)):
        kernel = Gradients(dataclasses.replace(p, integrator=p.integrator.cut(paths)), L2(), 1024)
        rows = kernel.uniform(40, 3)
        means.append(float(rows.mean()))
    print(means)
    assert abs(means[0]) < 0.002 * abs(means[1])


def test_where_residuals_stay_a_derivative_lacks_no_more_than_they_do(monkeypatch):
    """Of images from elsewhere, which nothing meets; with a prior; where an unknown rests."""
    asked = []
    monkeypatch.setattr(
        planning, "_probed", lambda p, settings, *_: asked.append(settings) or _[-1]
    )
    p = problem({TEXTURE: 0.5}, depth=4)
    for known, more in ((True, {}), (False, {}), (False, {"finish": 0.3})):
        monkeypatch.setattr(type(p), "truth_known", property(lambda _, known=known: known))
        decided(p, 60.0, **more)
    for typed in (0.2, 0.3):
        decided(p, 60.0, derivative_tolerance=typed)
    assert [each.derivative_tolerance for each in asked] == [0.3, 0.005, 0.3, 0.2, 0.3]
    asked.clear()
    monkeypatch.setattr(type(p), "truth_known", True)
    decided(p, 60.0, prior=True)
    decided(p, 60.0, prior=True, finish=0.3)
    (unknown,) = p.unknowns
    unknown.during = (0.0, 0.5)
    decided(p, 60.0)
    assert [each.derivative_tolerance for each in asked] == [0.005, 0.3, 0.005]


def test_bounds_hold_the_share_as_often_as_they_say(rng):
    """Of parts and wholes with noise larger than themselves, in many entries."""
    part, whole = 0.1 * np.ones(50), np.ones(50)
    held = []
    for _ in range(400):
        noise = rng.normal(size=(12, 50))
        rows = part + 0.5 * rng.normal(size=(12, 50)), whole + noise
        found = gradient_share(*rows)
        held.append((found.bound >= 0.1, found.low <= 0.1))
    assert np.all(np.mean(held, axis=0) > 0.9)
    assert gradient_share(np.zeros((12, 50)), whole + np.zeros((12, 50))) == Share(0.0, 0.0)
    assert gradient_share(part + np.zeros((12, 50)), np.zeros((12, 50))).bound == np.inf


@pytest.mark.parametrize("hits", (100, 10, 1, 0.2))
def test_rare_light_is_not_taken_for_none(rng, hits):
    """A caustic that so many paths of a batch meet, each on another texel: no products meet."""
    part, entries = 0.16, 8192
    held = []
    for _ in range(40):
        whole = rng.exponential(size=(12, entries))
        rare = np.zeros_like(whole)
        for row in rare:
            met = rng.integers(0, 1000, rng.poisson(hits))
            np.add.at(row, met, rng.exponential(size=met.size) / hits)
        rare *= part * np.sqrt(entries * 1000)
        held.append(not rare.any() or gradient_share(rare, whole + rare).bound > 0.145)
    assert np.mean(held) > 0.85
    # What is met by rounding alone is nothing.
    rounding = 1e-7 * rng.normal(size=(12, 1)) * (rng.random((12, entries)) < 1e-4)
    assert gradient_share(rounding, 1 + rounding).bound < 1e-6


def test_noise_is_compared_entry_by_entry(rng):
    """Whatever their scales, and though a rare path rules one of them."""
    scale = 10.0 ** rng.uniform(-6, 6, 200)
    usual = (scale * rng.normal(size=(64, 200))) ** 2
    quarter = (scale * 0.5 * rng.normal(size=(40, 200))) ** 2
    usual[7, 3] *= 1e9
    value, error = noise_ratio({"a": quarter}, {"a": usual})
    assert value == pytest.approx(0.25, abs=4 * error) and error < 0.03
    one, error = noise_ratio({"a": usual}, {"a": usual})
    assert one == pytest.approx(1) and error == pytest.approx(0, abs=1e-9)
    rare = usual * (rng.random(usual.shape) < 0.02) / 0.02
    seen_often = np.arange(200) < 40
    value, error = noise_ratio({"a": np.where(seen_often, usual, rare)}, {"a": usual})
    assert value == pytest.approx(1), "as much noise, met less often"


def rung(depth: int, *bounds: float, lost: float = 0.0) -> Cut:
    shares = {str(i): Share(b / 2, b) for i, b in enumerate(bounds)}
    return Cut(depth, Share(0, 0), shares, 1, lost)


def test_depth_is_the_least_beyond_which_no_unknown_loses_its_share():
    ladder = [rung(2, 0.001, 0.2), rung(3, 0.001, 0.004), rung(4, 0, 0)]
    assert rules.depth(ladder, 0.01, 6)[0] == 3
    assert rules.depth(ladder, 0.002, 6)[0] == 4
    assert rules.depth(ladder, 0.5, 6)[0] == 2
    depth, why = rules.depth(ladder, 0.0, 6)
    assert depth == 6 and "%" in why


def test_what_is_differentiated_is_the_least_that_loses_no_share_and_no_entry():
    ladder = [rung(2, 0.1, 0.5), rung(3, 0.1, 0.2)]
    assert rules.derivative(ladder, 0.3, 6)[0] == 3
    assert rules.derivative(ladder, 0.15, 6) == (
        *(6, "longer than 3 are up to 20.00% of a gradient (95 % bound)"),
    )
    depth, why = rules.derivative([rung(2, 0.1, lost=0.4)], 0.3, 6)
    assert depth == 6 and why.startswith("up to 40% of the entries")


def test_no_more_is_differentiated_than_is_traced():
    cuts, derivatives = (rung(2, 0.1), rung(3, 0.0)), (rung(2, 0.1), rung(3, 0.01))
    found = planning.Plan(Paths(6, 6), 0.0, {}, cuts=cuts, derivatives=derivatives)
    settings = Effects(tolerance=0.2, derivative_tolerance=0.05)
    chosen, _ = planning._chosen(problem({TEXTURE: 0.5}, depth=6), settings, found)
    assert (chosen.paths.depth, chosen.paths.derivative) == (2, 2)


def test_light_samples_are_more_only_where_that_pays():
    one = Lights((1, 1), 1, 1.0, 0.0, 1.0)
    paying = Lights((4, 4), 4, 0.3, 0.02, 1.6)
    assert rules.lights([one, paying])[0] is paying
    assert rules.lights([one, Lights((4, 4), 4, 0.6, 0.02, 1.8)])[0] is one
    assert rules.lights([one, Lights((4, 4), 4, 0.5, 0.2, 1.3)])[0] is one, "better, but not surely"
    few, many = Lights((4, 1), 4, 0.33, 0.03, 1.23), Lights((4, 4), 4, 0.29, 0.03, 1.47)
    assert rules.lights([one, few, many])[0] is many, "as good within the errors"
    assert rules.lights([one, few, Lights((4, 4), 4, 0.4, 0.03, 1.47)])[0] is few
    picked = Lights((1, 1), 4, 0.5, 0.02, 1.05)
    assert rules.lights([one, picked])[0] is picked, "costs next to nothing"
    assert rules.lights([one, picked, paying])[0] is picked, "not surely better than that"
    surely = dataclasses.replace(paying, noise=0.2)
    assert rules.lights([one, picked, surely])[0] is surely
    dear = dataclasses.replace(picked, time=2.1)
    assert rules.lights([one, dear, paying])[0] is paying
    dark = dataclasses.replace(picked, noise=math.nan)
    assert rules.lights([one, dark, paying])[0] is paying
    none = dataclasses.replace(one, noise=math.nan)
    assert rules.lights([none, dark, paying]) == (none, "not measured")
    assert rules.lights([one, dark]) == (one, "not measured")


def test_a_run_by_iterations_has_all_effects_and_no_probe(monkeypatch):
    """A clock's decision would make it another run on another machine. Light samples are picked
    but where renderings are compared."""
    p = problem({TEXTURE: 0.5}, depth=4)
    plan = decided(p)
    assert plan.paths == Paths(4, 4, directions=4) and plan.seconds == 0 and not plan.cuts
    assert "each picked from 4 directions" in plan.statements["light samples"]
    for how in ({"estimator": "plateau"}, {"directions": 1}):
        assert decided(p, **how).on(p) is p
    moved = p.unknowns[TEXTURE]
    monkeypatch.setattr(cameras, "unknown", lambda unknowns: [moved])
    assert decided(p).on(p) is p, "a moving camera"
    assert "up to 4 edges" in plan.statements["paths"]


def test_a_timed_run_is_probed_once(monkeypatch, tmp_path):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}, depth=4)
    settings = {"tolerance": 0.99, "derivative_tolerance": 0.99}
    first = decided(p, 60.0, **settings)
    assert [each.depth for each in first.cuts] == [2, 3] and len(first.samples) == 3
    assert [each.depth for each in first.derivatives] == [2]
    assert first.seconds > 0 and first.paths.depth == first.paths.derivative == 2
    one_way = decided(p, 60.0, crossed=False, **settings)
    assert len(one_way.samples) == 4 and not one_way.on(p).integrator.crosses
    assert first.cuts[0].gradient.keys() == {TEXTURE, ROUGHNESS}
    assert "bound" in first.statements["paths"]
    assert first.on(p).integrator.paths == first.paths
    monkeypatch.setattr(planning, "Probe", None)
    assert decided(p, 60.0, **settings) == first
    short = decided(p, 5.0)
    assert short.seconds == 0 and short.paths == Paths(4, 4, directions=4)
    again = effects.decide(
        p, Effects(), configured("estimator", "two_path"), L2(), 60.0, first.record()
    )
    assert again.paths == first.paths and again.seconds == first.seconds


def test_a_probe_is_allowed_its_share_of_the_budget(monkeypatch):
    for name, value in ALLOWED.items():
        monkeypatch.setattr(planning, name, value)
    p, asked = problem({TEXTURE: 0.5}, depth=4), []
    monkeypatch.setattr(
        planning, "_probed", lambda p, settings, loss, allowed, *_: asked.append(allowed) or _[-1]
    )
    for seconds in (9.0, 40.0, 100.0):
        decided(p, seconds)
    assert asked == pytest.approx([2.0, 3.0])


def test_a_probe_leaves_out_what_would_take_longer_than_its_share(monkeypatch, tmp_path):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(planning, "_MOST", 1e-6)
    p = problem({TEXTURE: 0.5}, depth=4)
    plan = decided(p, 60.0)
    assert plan.paths == Paths(4, 4, directions=4)
    assert not (plan.cuts or plan.derivatives or plan.samples)


def test_entries_are_asked_for_no_longer_than_is_allowed(monkeypatch):
    """What was not met by then counts as lost; with time enough it is met."""
    monkeypatch.setattr(coverage, "_FIRST", (4, 4))
    monkeypatch.setattr(coverage, "_WORTH", 0.0)
    p = problem({TEXTURE: 0.5})
    coverage.fill_in(p, 0)
    u = p.unknowns[TEXTURE]
    where = p, {TEXTURE: u.start}, {TEXTURE: u.seen}, 0.01
    hasty, patient = (coverage.missed(*where, seconds)[0][TEXTURE] for seconds in (0.0, math.inf))
    assert hasty > 0.5 > patient


def test_entries_that_a_wider_cone_lights_are_met_there(monkeypatch, tmp_path):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    scene = under_spots(spot={"cutoff_angle": 40.0, "beam_width": 5.0})
    p = without_targets(scene, {TEXTURE: 0.5, "spot.cutoff_angle": 10.0})
    coverage.fill_in(p, 0)
    assert planning._lost(p, p.integrator.paths, 0.01)[0][TEXTURE] < 0.1


def test_a_probe_lights_what_starts_dark_and_leaves_it_dark():
    dark = dict.fromkeys(("sky.radiance.value", "lamp.emitter.radiance.value"), 0.0)
    p = problem({TEXTURE: 0.5} | dark)
    measured = Probe(p, L2(), 3)
    found = measured.lights(p.integrator.paths, [((1, 1), 1), ((4, 4), 1)])
    assert all(math.isfinite(each.noise) for each in found)
    assert not any(as_numpy(p.unknowns.leaves[key]).any() for key in dark)
    share = measured.cut(2, True).gradient[TEXTURE]
    assert 0 <= share.value < 1
    assert not any(as_numpy(p.unknowns.leaves[key]).any() for key in dark)


def test_what_is_set_is_done():
    p = problem({TEXTURE: 0.5}, depth=4)
    plan = decided(p, max_depth=2, light_samples=[3, 2], finish=0.3)
    last = plan.on(p, finish=True).integrator
    assert last.paths == Paths(4, 4, (3, 2), directions=4) and "30%" in plan.statements["finish"]
    assert "finish" not in decided(p, light_samples=[3, 2], finish=0.3).statements
    assert plan.on(p).integrator.paths == Paths(2, 2, (3, 2), directions=4)
    assert decided(p, derivative_depth=2, directions=1).paths == Paths(4, 2)
    ended = decided(p, roulette=2, max_depth=3, directions=3, finish=0.3)
    assert ended.on(p).integrator.paths == Paths(3, 3, (1, 1), 2, directions=3)
    assert ended.on(p, finish=True).integrator.paths == Paths(4, 4, (1, 1), 2, directions=3)
    assert "as set" in ended.statements["roulette"]
    again = Effects(roulette=2, max_depth=3)
    again = effects.decide(p, again, configured("estimator", "two_path"), L2(), 9, ended.record())
    assert again.paths == ended.paths
    assert (
        "as set" in plan.statements["paths"] and "4 edges in the scene" in plan.statements["paths"]
    )
    assert decided(p, max_depth=4, directions=1).on(p) is p
    with pytest.raises(InputError, match="effects.max_depth=9: the scene's own paths .* 4 edges"):
        decided(p, max_depth=9)
    with pytest.raises(InputError, match="derivative_depth=3: the paths to differentiate .* 2 edg"):
        decided(p, max_depth=2, derivative_depth=3)


def test_what_is_not_set_is_measured(monkeypatch, tmp_path):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    p, depths = problem({TEXTURE: 0.5}, depth=4), {"max_depth": 4, "derivative_depth": 4}
    asked = lambda self, paths, ways: [Lights(*way, 1.0, 0.0, 1.0) for way in ways]
    monkeypatch.setattr(Probe, "lights", asked)
    for settings, ways in (
        ({"directions": 2}, [((1, 1), 2), ((4, 4), 2)]),
        ({"light_samples": [2, 2]}, [((2, 2), 4), ((2, 2), 1)]),
        ({"light_samples": [2, 2], "directions": 2}, []),
    ):
        plan = decided(p, 60.0, **depths, **settings)
        assert [(each.samples, each.directions) for each in plan.samples] == ways
        assert ("as set" in plan.statements["light samples"]) == (not ways)
    p.target_hash = "another, or the plan would be the one that is kept"
    monkeypatch.setattr(Probe, "lights", lambda self, paths, ways: asked(self, paths, ways[:1]))
    short = decided(p, 60.0, **depths).paths
    assert (short.lights, short.directions) == ((1, 1), 4), "one that was measured is not preferred"


def test_a_derivative_that_draws_its_own_light_has_no_say_in_light_samples(monkeypatch, tmp_path):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    p = problem({ROUGHNESS: 0.5}, depth=4)
    made = configured("estimator", "two_path", {"derivative_sampling": True})

    def plan_of(seconds=None, **settings):
        return effects.decide(p, Effects(**settings), made, L2(), seconds)

    monkeypatch.setattr(Probe, "lights", None)
    plan = plan_of(60.0, max_depth=4, derivative_depth=4)
    assert plan.samples == () and plan.paths.lights == (1, 1)
    told = plan.statements["light samples"]
    assert told == "1 for a residual, each picked from 4 directions; the derivative draws its own"
    told = plan_of(light_samples=[4, 16], directions=1).statements["light samples"]
    assert told == "4 for a residual; the derivative draws its own: as set"


def test_nothing_is_cut_while_differences_need_it(monkeypatch, tmp_path):
    """Beside path replay: they are not among the gradients that the probe looks at."""
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    p, loose = problem({TEXTURE: 0.5}, depth=4), {"tolerance": 0.9, "derivative_tolerance": 0.9}
    assert decided(p, 60.0, **loose, **ONE).paths.depth < 4
    monkeypatch.setattr(p.unknowns[TEXTURE].kind, "aside", "not rightly", raising=False)
    p.target_hash = "another, or the plan would be the one that is kept"
    assert decided(p, 60.0, **loose, **ONE).paths.depth == 4
    beside = problem({TEXTURE: 0.5, ROUGHNESS: 0.5}, depth=4)
    monkeypatch.setattr(beside.unknowns[ROUGHNESS].kind, "carried", False, raising=False)
    assert decided(beside, 60.0, **loose, **ONE).paths.depth == 4, "as beside an exposure"


def behind_a_mirror(*more, moves: bool = False):
    """A wall that only a mirror shows, lit by a sky. ``more``: where other cameras look at.
    ``moves``: its place is unknown, not its albedo."""
    to = mi.ScalarTransform4f
    film = {"type": "hdrfilm", "width": 8, "height": 8}
    scene = {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 4},
        "sky": {"type": "constant"},
        "mirror": {
            "type": "rectangle",
            "to_world": to().translate([0, 0, -1]),
            "bsdf": {"type": "conductor"},
        },
        "wall": {
            "type": "rectangle",
            "to_world": to().translate([0, 0, 3]).rotate([0, 1, 0], 180).scale(3),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.5}},
        },
        "sensor_000": {
            "type": "perspective",
            "fov": 20,
            "to_world": to().look_at([0, 0, 1], [0, 0, -1], [0, 1, 0]),
            "film": film,
        },
    }
    for number, at in enumerate(more, 1):
        to_world = to().look_at([0, 0, 1], at, [0, 1, 0])
        scene[f"sensor_{number:03d}"] = {**scene["sensor_000"], "to_world": to_world}
    unknown, poses = {WALL: 0.2}, None
    if moves:
        where = {"kind": "translation", "objects": ["wall"], "directions": [[1, 0, 0]], "at": [0]}
        poses = {"place": PoseConfig(**where)}
        unknown = {"place": UnknownConfig(start=2.9, blur=BlurConfig(start=0.3, end=0.1))}
    p = without_targets(scene, unknown, poses)
    render_targets(p, 16)
    return p


def test_a_plan_without_a_path_to_an_unknown_is_refused_or_not_made(monkeypatch, tmp_path):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    p = behind_a_mirror()
    with pytest.raises(InputError, match=rf"effects.max_depth=2: .*'{WALL}'.*the scene's 4"):
        decided(p, max_depth=2)
    with pytest.raises(InputError, match=rf"effects.derivative_depth=2: .*'{WALL}'"):
        decided(p, derivative_depth=2)
    assert decided(p, max_depth=3).paths.depth == 3
    found = decided(p, 60.0, tolerance=0.9, derivative_tolerance=0.9, **ONE).paths
    assert (found.depth, found.derivative) == (3, 3)
    moving = behind_a_mirror(moves=True)
    for estimator in ("plateau", "finite_differences"):
        with pytest.raises(InputError, match="effects.max_depth=1: .*'place'"):
            decided(moving, estimator=estimator, max_depth=1)
        # Unlit, and before the sky.
        assert decided(moving, estimator=estimator, max_depth=2).paths.depth == 2
    moving.unknowns["place"].start[:] = 50.0  # neither is it seen by all paths
    assert decided(moving, estimator="plateau", max_depth=1).paths.depth == 1
    p.integrator = adapt(mi.load_dict({"type": "prb", "max_depth": -1}))
    with pytest.raises(InputError, match=f"effects.max_depth=2: .* meets '{WALL}': give more$"):
        decided(p, max_depth=2)


def test_what_no_view_sees_holds_no_plan_up(monkeypatch, tmp_path):
    """As of a photographed object's parts, which are unknown without being asked for."""
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    hidden, grey = "hidden.bsdf.reflectance.value", {"type": "diffuse", "reflectance": 0.5}
    far = {"type": "sphere", "center": [0, 50, 50], "radius": 0.01, "bsdf": grey}
    p = without_targets(dictionary() | {"hidden": far}, {TEXTURE: 0.2, hidden: 0.3})
    render_targets(p, 16)
    # Not told so, as where something moves.
    assert decided(p, max_depth=2).paths.depth == 2
    assert decided(p, derivative_depth=2).paths.derivative == 2
    p.unknowns[hidden].asked = False
    coverage.fill_in(p, 0)
    assert any(f"'{hidden}': no view sees it" in line for line in p.warnings)
    found = decided(p, 60.0, tolerance=0.9, derivative_tolerance=0.9, **ONE)
    assert found.paths.depth < 4 and found.cuts[0].gradient.keys() == {TEXTURE}


def test_views_that_see_no_unknown_are_not_drawn_from(monkeypatch, tmp_path):
    """One looks past the mirror at the sky; one sees the wall in the mirror only, and stays."""
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    p = behind_a_mirror([9, 0, 0], [0.2, 0, -1])
    plan = decided(p, 60.0, max_depth=4, derivative_depth=4, **ONE)
    assert plan.views == (0, 2) and plan.statements["views"].startswith("2 of 3")
    assert plan.seconds > 0 and decided(p).views is None
    assert plan.traced >= 3 * 512 and plan.record()["probe_paths"] == plan.traced
    assert decided(p, 60.0, max_depth=3, derivative_depth=3, finish=0.3, **ONE).views is None
    monkeypatch.setattr(probe, "_PATHS_A_VIEW", (1, 1 << 12))
    assert Probe(p, L2(), 0).views() == plan.views, "few paths show nothing: more are asked"
    assert Probe(p, L2(), 0, 0.0).views() is None, "no time for more"
    # A view that shows an unknown in a few pixels may be missed: that is checked.
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path / "checked"))
    within = lambda p, *_: ({TEXTURE: float(p.views.count < 3)}, 0.0)
    monkeypatch.setattr(planning, "_lost", within)
    assert decided(p, 60.0, max_depth=4, derivative_depth=4, **ONE).views is None
    few = plan.on(p)
    assert few.film_sizes == [(8, 8)] * 2 and few.views.total == 2 * 64
    for view, origin in enumerate(few.kept):
        assert np.array_equal(few.target_image(view), p.target_image(origin))
    means, errors = [], []
    for problem_ in (p, few):
        rows = Gradients(problem_, L2(), 1024).uniform(60, 3)
        means.append(rows.mean())
        errors.append(rows.std() / len(rows) ** 0.5)
    print(means, errors)
    assert abs(means[0] - means[1]) < 4 * np.hypot(*errors) < 0.1 * abs(means[0])
    assert errors[1] < errors[0]
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path / "other"))
    again = behind_a_mirror([0.2, 0, -1])
    assert decided(again, 60.0, max_depth=4, derivative_depth=4, **ONE).views is None


@pytest.mark.parametrize(
    "settings, words",
    [
        ({"max_depth": 0}, "effects.max_depth=0: at least 1"),
        ({"derivative_depth": 0}, "effects.derivative_depth=0: at least 1"),
        ({"roulette": 0}, "effects.roulette=0: at least 1"),
        ({"light_samples": [4]}, r"effects.light_samples=\[4\]: two numbers"),
        ({"light_samples": [0, 4]}, r"light_samples=\[0,4\]"),
        ({"directions": 0}, "effects.directions=0: from 1 to 256"),
        ({"light_samples": [4, 1], "directions": 65}, "effects.directions=65: from 1 to 64"),
        ({"tolerance": 1.0}, "effects.tolerance=1.0"),
        ({"derivative_tolerance": 1.0}, "effects.derivative_tolerance=1.0"),
        ({"finish": -0.1}, "effects.finish=-0.1"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, words):
    with pytest.raises(InputError, match=words):
        Effects(**settings)


def test_what_leaves_paths_to_mitsuba_cannot_be_planned():
    p = problem({TEXTURE: 0.5}, depth=4)
    with pytest.raises(InputError, match="estimator=mitsuba leaves the paths to Mitsuba, which"):
        decided(p, estimator="mitsuba", max_depth=2)
    assert decided(p, 60.0, estimator="mitsuba").on(p) is p
    with pytest.raises(InputError, match="derivative_depth=2: estimator=plateau differentiates no"):
        decided(p, estimator="plateau", derivative_depth=2)
    for integrator, words in (
        ({"type": "prb", "hide_emitters": True}, "hide_emitters, also by photos.background=black,"),
        ({"type": "prbvolpath"}, "integrator PRBVolpathIntegrator is Mitsuba's and traces them"),
    ):
        p.integrator = adapt(mi.load_dict({"max_depth": 3} | integrator))
        with pytest.raises(InputError, match=words):
            decided(p, light_samples=[2, 2])


def test_a_staged_run_takes_the_second_estimator_at_the_end():
    class Named:
        problem, blurs, stages = None, False, (0.0,)

        def __init__(self, name, paths):
            self.name, self.paths_per_step = name, paths

        def estimate(self, *arguments):
            return self.name

    staged = Staged(Named("cheap", 10), Named("full", 30), 0.75)
    told = [(staged.estimate({}, None, 1, 0, s), staged.paths_per_step) for s in (0, 0.74, 0.75, 1)]
    assert told == [("cheap", 10), ("cheap", 10), ("full", 30), ("full", 30)]
    assert staged.stages == (0.0, 0.75)


TINY = [
    *("scene=pottery", "size=tiny", "sampler=uniform", "target.spp=4", "estimator.batch=256"),
    *("evaluation.pixels=512", *QUIET),
]


@pytest.mark.parametrize(
    "settings, told",
    [
        (["effects.max_depth=2", "effects.derivative_depth=3"], "effects.derivative_depth=3: the"),
        (["estimator=mitsuba", "effects.max_depth=2"], "estimator=mitsuba leaves the paths to"),
    ],
)
def test_what_cannot_be_had_is_refused_before_targets_are_rendered(
    settings, told, monkeypatch, refused
):
    monkeypatch.setattr(targets, "render", None)
    refused(["run", *TINY, *settings], told)


def test_a_run_says_what_it_left_out(tmp_path, capsys):
    """Its errors are those with all effects; the difference of the images stands beside them. The
    last part of the budget has all effects."""
    settings = ["effects.max_depth=2", "effects.finish=0.5", "budget.iterations=8"]
    run = ran(tmp_path / "r", *TINY, *settings)
    told = capsys.readouterr().err
    assert "paths: of up to 2 edges" in told and "left out of the images: " in told
    assert run.summary["left_out_rmse"] > 1e-3
    assert run.manifest["plan"]["max_depth"] == 2 and "50%" in run.manifest["effects"]["finish"]
    assert resumed(tmp_path / "r", "budget.iterations=10").summary["iterations"] == 10


def test_rare_light_that_is_left_out_is_told(rng, monkeypatch):
    """Of which no pixel has any in both halves of an evaluation."""
    p = problem({TEXTURE: 0.5}, resolution=(64, 64))
    evaluator = Evaluator(p, L2(), 4096, 4, 1)
    rare = rng.random((2, 4096)) < 0.03
    rare[1] &= ~rare[0]
    bright = [mi.Color3f(*[mi.Float(each.astype(np.float32))] * 3) for each in rare]
    dark = [dr.zeros(mi.Color3f, 4096)] * 2
    monkeypatch.setattr(evaluator, "_halves", lambda values, other=None: bright if other else dark)
    assert evaluator.apart(p, {}) == pytest.approx(0.03, rel=0.3)
    bright = dark
    assert evaluator.apart(p, {}) == 0


@pytest.mark.parametrize("finish, error", [(0.0, 0.012), (0.0, 0.03), (0.5, 0.012)])
def test_what_is_left_out_is_doubted_where_it_is_much_of_the_error(
    finish, error, tmp_path, monkeypatch
):
    """Where unknowns make up for all of it, images are off by as much, and by what is left."""
    honest = Evaluator.__call__
    near = lambda self, values: honest(self, values) | {"image_rmse": error}
    monkeypatch.setattr(Evaluator, "__call__", near)
    monkeypatch.setattr(Evaluator, "apart", lambda *_: 0.01)
    settings = ["effects.max_depth=2", f"effects.finish={finish}", "budget.iterations=2"]
    told = ran(tmp_path / "r", *TINY, *settings).summary["warnings"]
    doubted = finish == 0 and error < 0.02
    assert any("results make up for it" in line for line in told) == doubted


def test_what_is_left_out_is_no_noise_of_light_samples(tmp_path):
    """However they are drawn, it is the light of the paths that are not traced."""
    found = []
    for directions in (1, 4):
        settings = ["effects.max_depth=2", f"effects.directions={directions}", "optimizer.lr=1e-9"]
        run = ran(tmp_path / str(directions), *TINY, *settings, "budget.iterations=1")
        found.append(run.summary["left_out_rmse"])
    assert found[0] == pytest.approx(found[1], rel=1e-3)


def test_effects_are_printed_alone(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main(["effects", *TINY[:3], "target.spp=4"]) == 0
    out = capsys.readouterr().out
    for words in ("of the gradient", "noise × time", "light samples", "a run is billed"):
        assert words in " ".join(out.split()), out
    assert list(tmp_path.iterdir()) == []
    assert main(["effects", *TINY[:3], "effects.max_dept=3"]) == 2
    assert "did you mean 'effects.max_depth'" in capsys.readouterr().err
    assert main(["effects", "--foo"]) == 2
    assert main(["variance", "scene=pottery", "effects.max_depth=2"]) == 2
    assert "no use for it" in capsys.readouterr().err


def test_views_that_a_light_may_yet_reach_are_kept(monkeypatch, tmp_path):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    scene = dictionary()
    scene["spot"] = {"type": "spot", "cutoff_angle": 20, "beam_width": 15, "intensity": 2.0}
    p = without_targets(scene, {"spot.cutoff_angle": 30.0})
    p.set_targets(dr.zeros(mi.Float, 3 * p.views.total), None, "test")
    monkeypatch.setattr(probe.Probe, "views", lambda self: pytest.fail("asked"))
    assert decided(p, 60.0, max_depth=2, derivative_depth=2, **ONE).views is None
