"""Several light samples at the first hit, and isas's own paths, unrolled and replayed: the same
means as with one, the same values as Mitsuba's. Derivatives of a path's beginning alone."""

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from gradient_estimates import Gradients
from hard_scenes import SCENES, assemble, hard_problem
from montecarlo import welch
from scenes_for_tests import ROUGHNESS, TEXTURE, problem
from weights import as_mitsuba

from isas_cli.losses import L2
from isas_cli.rendering import attached, light, rays, sky
from isas_cli.rendering.integrators import Integrator, Mixed, Paths, Replayed, Unrolled, adapt
from isas_cli.unknowns.parameters import flat

LEVEL = 1e-4
UNKNOWNS = {
    TEXTURE: 0.5,
    ROUGHNESS: 0.5,
    "lamp.emitter.radiance.value": 9.0,
    "sky.radiance.value": 0.2,
}


def spawned(p, seed: int, copies: int = 4):
    pixel = dr.tile(dr.arange(mi.UInt32, p.views.total), copies)
    stream = rays.stream(mi.UInt32(seed), dr.width(pixel))
    ray, _ = rays.spawn(p.sensors, p.views, *p.views.locate(pixel), stream)
    return p.scene, stream, ray


def backward(p, integrator) -> np.ndarray:
    starts = p.unknowns.starts()
    p.unknowns.attach(starts)
    with dr.suspend_grad():
        scene, stream, ray = spawned(p, 5)
        weights = np.random.default_rng(1).normal(size=(3, dr.width(ray.o)))
        with dr.isolate_grad():  # as in all kernels (`kernels.recorded`)
            integrator.backward(scene, stream, ray, mi.Color3f(weights))
    found = [np.array(flat(g), np.float64) for g in p.unknowns.gradients().values()]
    p.unknowns.write(starts)
    return np.concatenate(found)


def forward(p, integrator) -> np.ndarray:
    starts = p.unknowns.starts()
    p.unknowns.push_tangent(starts, {k: v * 0 + 1 for k, v in starts.items()})
    with dr.suspend_grad():
        found = np.array(integrator.forward(*spawned(p, 9)))
    p.unknowns.write(starts)
    return found


def primal(p, integrator) -> np.ndarray:
    with dr.suspend_grad():
        return np.array(integrator.primal(*spawned(p, 7))[0])


CASES = [(backward, 1), (backward, 2), (backward, 7)]
CASES += [(what, depth) for what in (forward, primal) for depth in (4, 7)]


@pytest.mark.parametrize("what, depth", CASES)
def test_own_paths_agree_with_mitsubas(what, depth, monkeypatch):
    """Path by path; with roulette where paths are long enough for it."""
    as_mitsuba(monkeypatch)
    p = problem(UNKNOWNS if depth > 1 else {"sky.radiance.value": 0.2}, depth=depth)
    stock = what(p, Integrator(p.integrator.mitsuba))
    assert np.abs(stock).max() > 0
    for kind in (Replayed, Unrolled):
        ours = what(p, kind(p.integrator.mitsuba, Paths(depth, depth)))
        assert np.allclose(ours, stock, rtol=2e-4, atol=1e-5 * np.abs(stock).max()), kind


def test_long_paths_are_replayed():
    assert attached.handles(8) and not any(attached.handles(depth) for depth in (9, 2**32 - 1))
    hidden = mi.load_dict({"type": "prb", "max_depth": 3, "hide_emitters": True})
    kinds = {3: Unrolled, 9: Replayed}
    for depth, kind in kinds.items():
        assert type(adapt(mi.load_dict({"type": "prb", "max_depth": depth}))) is kind
    assert type(adapt(hidden)) is Integrator and not adapt(hidden).cuts


@pytest.mark.parametrize("what", [backward, primal])
def test_roulette_as_set_is_that_of_a_scene_that_has_it(what, monkeypatch):
    """Path by path, and other paths than without."""
    as_mitsuba(monkeypatch)
    p = problem(UNKNOWNS, depth=4)
    early = mi.load_dict({"type": "prb", "max_depth": 4, "rr_depth": 1})
    stock = what(p, Integrator(early))
    for kind in (Unrolled, Replayed):
        ours = what(p, kind(p.integrator.mitsuba, Paths(4, 4, roulette=1)))
        assert np.allclose(ours, stock, rtol=5e-4, atol=2e-5 * np.abs(stock).max())
        assert not np.allclose(ours, what(p, p.integrator), rtol=1e-3)


def test_one_kernel_does_for_all_depths():
    p = problem({TEXTURE: 0.5}, depth=6)
    for depth in (2, 4):
        edges = dr.opaque(mi.UInt32, depth)
        opaque = Replayed(p.integrator.mitsuba, Paths(edges, edges))
        plain = p.integrator.cut(Paths(depth, depth))
        assert isinstance(plain, Unrolled)
        assert np.allclose(primal(p, opaque), primal(p, plain), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("depth, kind", [(4, Unrolled), (9, Mixed)])
def test_the_beginning_of_a_path_is_differentiated_as_a_short_path(depth, kind):
    p = problem(UNKNOWNS, depth=depth)
    whole, short = p.integrator, p.integrator.cut(Paths(2, 2))
    mixed = whole.cut(Paths(depth, 2))
    assert type(mixed) is kind
    assert np.array_equal(primal(p, mixed), primal(p, whole))
    for what in (backward, forward):
        # The sums of two kernels have no order.
        found, wanted = what(p, mixed), what(p, short)
        np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-5 * np.abs(wanted).max())
        assert not np.allclose(what(p, mixed), what(p, whole), rtol=0.01)


@pytest.mark.parametrize("lights, directions", [((1, 1), 1), ((4, 4), 4)])
def test_paths_without_caustics_are_those_with_them_but_for_their_light(lights, directions):
    """A glass ball in the sun: unrolled, as replayed where an opaque flag says so to one kernel for
    all."""
    p = hard_problem("glass", depth=5)
    whole = Paths(5, 5, lights, directions=directions)
    less = dataclasses.replace(whole, caustics=False)
    with_them, without = (primal(p, p.integrator.cut(each)) for each in (whole, less))
    assert 0 < np.mean(with_them - without) < np.mean(with_them)
    assert np.all(without <= with_them * (1 + 1e-4) + 1e-6)
    for paths, found in ((whole, with_them), (less, without)):
        flag = dr.opaque(mi.Bool, paths.caustics)
        opaque = Replayed(p.integrator.mitsuba, dataclasses.replace(paths, caustics=flag))
        assert np.allclose(primal(p, opaque), found, rtol=1e-3, atol=1e-5)
        for what in (backward, forward) if directions > 1 else ():
            ours, other = what(p, opaque), what(p, p.integrator.cut(paths))
            assert np.allclose(ours, other, rtol=5e-3, atol=1e-4 * np.abs(other).max())


STANDING = {"floor.bsdf.base_color.data": 0.5, "ball.bsdf.roughness.value": 0.7}


@pytest.mark.parametrize("what", [backward, forward, primal])
def test_several_directions_to_a_known_map_are_drawn_otherwise(what):
    """A single one as Mitsuba draws it; several in another way, in a replay as unrolled."""
    p = assemble(SCENES["sun"].build(3), STANDING)
    ways = Paths(3, 3), Paths(3, 3, directions=4), Paths(3, 3, (2, 2))
    before = [what(p, p.integrator.cut(paths)) for paths in ways]
    light.prepare(p.scene, stays=True)
    far = 1e-4 * np.abs(before[0]).max()
    for paths, earlier in zip(ways, before):
        found = what(p, p.integrator.cut(paths))
        assert np.allclose(found, earlier, rtol=1e-3, atol=far) == (paths is ways[0])
        replayed = what(p, Replayed(p.integrator.mitsuba, paths))
        assert np.allclose(replayed, found, rtol=5e-3, atol=far)


class Bench:
    """A scene of `hard_scenes` at a depth that is unrolled or replayed; gradients of an L2 loss.
    ``sky``: with other unknowns, and directions drawn by its map as it was loaded."""

    def __init__(self, name: str, depth: int, sky: bool = False):
        own = SCENES[name]
        self.problem = assemble(own.build(depth), STANDING if sky else own.unknowns)
        self.one = Gradients(self.problem, L2(), 4096)
        self.reference = self.one.uniform(300, 99)
        if sky:
            light.prepare(self.problem.scene, stays=True)
            assert light.sky_for(self.problem.scene, 4) is not None

    def outcome(self, lights: tuple[int, int], directions: int, seed: int):
        whole = self.problem.integrator
        paths = dataclasses.replace(whole.paths, lights=lights, directions=directions)
        self.problem.integrator = whole.cut(paths)
        try:
            rows = Gradients(self.problem, L2(), 4096).uniform(120, seed)
        finally:
            self.problem.integrator = whole
        components = self.one.components
        return rows, welch(
            components(rows, self.reference), components(self.reference, self.reference), LEVEL
        )


@pytest.fixture(scope="module")
def bench(request):
    return Bench(*request.param)


SAMPLED = [
    (("sun", 3), (4, 4), 1),
    (("sun", 3), (1, 1), 4),
    (("sun", 3, True), (1, 1), 4),
    (("sun", 9, True), (4, 4), 4),
    (("glass", 9), (3, 2), 4),
]


@pytest.mark.parametrize("bench, lights, directions", SAMPLED, indirect=["bench"])
def test_several_light_samples_are_unbiased(bench, lights, directions, seed):
    """A sun and a sky, unrolled; glass, replayed. In the residual as in the derivative."""
    integrator = bench.problem.integrator
    assert isinstance(integrator, Unrolled if integrator.max_depth < 9 else Replayed)
    rows, outcome = bench.outcome(lights, directions, seed)
    print(outcome)
    assert outcome.p_value > LEVEL, str(outcome)
    assert outcome.always_visible < 0.15, str(outcome)


@pytest.mark.parametrize(
    "brings, sure, honest",
    [
        ((1.0, 0.0, -2.0, 4.0), 0.9, True),
        ((1.0, 0.0, -2.0, 4.0), 1.0, False),
        ((1.0, 0.0, np.inf, 4.0), 0.9, True),
        ((1.0, np.nan, -2.0, 4.0), 0.9, True),
    ],
    ids=["nothing", "never", "infinite", "no number"],
)
def test_a_direction_that_brings_nothing_counts_as_well(brings, sure, honest, seed, monkeypatch):
    """One of four is picked and stands for the sum over all. It may come from a lamp that is off,
    which has a derivative, or be negative, as a map's texel may. One that is not finite spoils no
    other."""
    count = 1 << 18
    loaded = mi.load_dict({"type": "scene", "sky": {"type": "constant"}})
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
    si.wi = mi.Vector3f(0, 0, 1)
    stream = rays.stream(mi.UInt32(seed), count)

    def toward(scene, sky, sampler, si, active, part, within):
        ds = dr.zeros(mi.DirectionSample3f, count)
        ds.d, ds.pdf = mi.warp.square_to_uniform_hemisphere(sampler.next_2d()), mi.Float(0.2)
        ds.time = mi.Float(within[0])  # which one it is
        return ds, mi.Spectrum(brings[within[0]])

    monkeypatch.setattr(light, "toward", toward)
    monkeypatch.setattr(light, "_hidden", lambda *arguments: mi.Bool(False))
    monkeypatch.setattr(light, "mis_weight", lambda a, b: mi.Float(1))
    monkeypatch.setattr(light, "_SURE", sure)
    bsdf = mi.load_dict({"type": "diffuse"})
    ds, _, weight = light._picked(loaded, None, stream, si, bsdf, mi.Bool(True), (0, 3), 4)
    which, weight = np.array(ds.time), np.array(weight, np.float64)
    found = np.array([np.mean(weight * (which == n)) for n in range(4)])
    errors = np.array([np.std(weight * (which == n)) for n in range(4)]) / count**0.5
    assert np.all(np.abs(found - 1) < 5 * errors) == honest
    assert errors.max() < 0.02


@pytest.mark.parametrize("bench", [("sun", 3, True)], indirect=True)
def test_a_density_of_the_sky_that_is_not_its_own_is_noticed(bench, seed, monkeypatch):
    honest = sky.Sky.pdf
    monkeypatch.setattr(sky.Sky, "pdf", lambda *arguments: 2 * honest(*arguments))
    _, outcome = bench.outcome((4, 4), 4, seed)
    assert outcome.p_value < LEVEL


@pytest.mark.parametrize("bench", [("sun", 3)], indirect=True)
@pytest.mark.parametrize("count", [1, 4])
def test_weights_that_ignore_their_number_are_noticed(bench, count, seed, monkeypatch):
    """Each direction weighted as if it were the only one: light that the BSDF's sample finds, too,
    counts twice in part."""
    honest = light.mis_weight
    monkeypatch.setattr(light, "mis_weight", lambda a, b: honest(a / 4, b))
    _, outcome = bench.outcome((count, count), 4 // count, seed)
    assert outcome.p_value < LEVEL


def test_light_samples_and_picking_them_lower_the_noise_of_radiance(seed):
    p = problem({TEXTURE: 0.5}, depth=3)
    variances = []
    for paths in Paths(3, 3), Paths(3, 3, (4, 4)), Paths(3, 3, directions=4):
        integrator = p.integrator.cut(paths)
        with dr.suspend_grad():
            L = np.array(integrator.primal(*spawned(p, seed % 1000, 64))[0])
        variances.append(L.reshape(3, 64, -1).var(axis=1).mean())
    print("variance of radiance: one, four, one of four", variances)
    assert variances[0] > 1.2 * variances[1] and variances[0] > 1.1 * variances[2]
