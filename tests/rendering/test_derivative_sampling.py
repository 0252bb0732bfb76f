"""Derivatives by roughness from directions drawn for them: densities, bias, variance, refusals."""

import functools
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from crosses import some
from gradient_estimates import Gradients, configured, difference_quotients
from hard_scenes import SCENES, assemble
from montecarlo import welch
from samplers_for_tests import pixel_samplers
from scenes_for_tests import dictionary, texture, without_targets
from scipy import stats

from isas_cli.losses import L2
from isas_cli.rendering import derivative_sampling, rays
from isas_cli.runtime.errors import InputError
from isas_cli.unknowns.parameters import flat

LEVEL = 1e-4
BATCH = 4096
REPEATS = 110


def back_of_a_sheet(depth: int) -> dict:
    """The wall turned round, so that its back is seen, with a texture for its roughness."""
    scene = dictionary(size=2, depth=depth)
    values = 0.3 + 0.4 * texture(2)[..., :1]
    scene["wall"]["to_world"] = scene["wall"]["to_world"].rotate([0, 1, 0], 180)
    scene["wall"]["bsdf"]["roughness"] = {
        "type": "bitmap",
        "data": mi.TensorXf(values),
        "raw": True,
    }
    scene["wall"]["bsdf"] = {"type": "twosided", "bsdf": scene["wall"]["bsdf"]}
    return scene


def two_kinds(depth: int) -> dict:
    """Two roughnesses of different kinds that see each other, behind a pane, and a bulb."""
    scene = dictionary(size=2, depth=depth)
    scene["ball"] = {
        "type": "sphere",
        "center": [0, 0.5, 0],
        "radius": 0.5,
        "bsdf": {"type": "roughconductor", "distribution": "ggx", "alpha": 0.3},
    }
    scene["pane"] = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([-0.6, 0.8, 1.2]).scale(0.8),
        "bsdf": {"type": "thindielectric"},
    }
    scene["bulb"] = {"type": "point", "position": [-1, 2, 2], "intensity": 4.0}
    return scene


# Starts, depth, description. Interreflection, and direct light alone; a sun, which BSDF sampling
# hardly finds; Beckmann instead of GGX, with a mirror and roulette; a texture on the back of a
# sheet; two unknowns.
PROBLEMS = {
    "interreflection": ({"wall.bsdf.roughness.value": 0.5}, 4, SCENES["interreflection"].build),
    "direct": ({"wall.bsdf.roughness.value": 0.5}, 2, SCENES["interreflection"].build),
    "sun": ({"ball.bsdf.roughness.value": 0.7}, 4, SCENES["sun"].build),
    "mirror": ({"ball.bsdf.alpha.value": 0.5}, 6, SCENES["mirror"].build),
    "back": ({"wall.bsdf.brdf_0.roughness.data": 0.4}, 4, back_of_a_sheet),
    "two": ({"wall.bsdf.roughness.value": 0.5, "ball.bsdf.alpha.value": 0.45}, 5, two_kinds),
}


_honest_pdf = derivative_sampling.parts_pdf


class Pair:
    """One problem with derivatives of both kinds, and the plain ones' reference."""

    def __init__(self, name: str):
        starts, depth, build = PROBLEMS[name]
        self.problem = assemble(build(depth), starts)
        self.plain = Gradients(self.problem, L2(), BATCH)
        self.drawn = Gradients(derivative_sampling.sampled(self.problem), L2(), BATCH)
        self.reference = self.plain.uniform(3 * REPEATS, 99)

    def against_plain(self, rows: np.ndarray):
        components = self.plain.components
        return welch(
            components(rows, self.reference), components(self.reference, self.reference), LEVEL
        )


@functools.cache
def of(name: str) -> Pair:
    return Pair(name)


@pytest.fixture(scope="module", params=PROBLEMS)
def pair(request):
    return of(request.param)


@pytest.fixture(scope="module")
def shared():
    return of("interreflection")


@pytest.mark.parametrize("pair", some([*PROBLEMS], ("back", "mirror")), indirect=True)
def test_gradient_is_that_of_bsdf_sampling(pair, seed):
    outcome = pair.against_plain(pair.drawn.uniform(REPEATS, seed))
    print(outcome)
    assert outcome.p_value > LEVEL, str(outcome)
    assert outcome.always_visible < 0.3, str(outcome)


@pytest.mark.parametrize("pair", some([*PROBLEMS], ("interreflection",)), indirect=True)
def test_gradient_is_the_slope_of_the_loss(pair, seed):
    rng = np.random.default_rng(seed)
    rows = pair.drawn.uniform(2 * REPEATS, seed)
    for unknown in pair.problem.unknowns:
        direction = rng.uniform(0.5, 1.5, unknown.start.shape).astype(np.float32)
        (whole, half), *_ = difference_quotients(
            pair.problem, [L2()], {unknown.key: direction}, 0.1, 64
        )
        own = rows[:, pair.drawn.entries()[unknown.key]]
        norm = np.linalg.norm(own.mean(axis=0)) * np.linalg.norm(direction)
        quotient = (4 * half - whole) / 3 / norm
        slopes = own @ direction.ravel() / norm
        outcome = welch(quotient[:, None], slopes[:, None], LEVEL)
        print(unknown.key, outcome)
        assert outcome.p_value > LEVEL, str(outcome)
        assert outcome.always_visible < 0.3, str(outcome)


@pytest.mark.parametrize(
    ("what", "broken"),
    [
        ("parts_pdf", lambda wi, wo, alpha: 0.5 * _honest_pdf(wi, wo, alpha)),
        ("gained", lambda u: derivative_sampling.lost(u)),
    ],
)
def test_wrong_densities_are_noticed(what, broken, shared, seed, monkeypatch):
    monkeypatch.setattr(derivative_sampling, what, broken)
    drawn = Gradients(derivative_sampling.sampled(shared.problem), L2(), BATCH)
    assert shared.against_plain(drawn.uniform(REPEATS, seed)).p_value < LEVEL


def test_a_vertex_chosen_without_its_probability_is_noticed(shared, seed, monkeypatch):
    honest = derivative_sampling.DerivativeSampling._vertex

    def broken(self, *arguments):
        hit, ray, depth, β, active = honest(self, *arguments)
        # As if every path had met one unknown surface.
        return hit, ray, depth, β / dr.maximum(dr.mean(β), 1e-6), active

    monkeypatch.setattr(derivative_sampling.DerivativeSampling, "_vertex", broken)
    drawn = Gradients(derivative_sampling.sampled(shared.problem), L2(), BATCH)
    assert shared.against_plain(drawn.uniform(REPEATS, seed)).p_value < LEVEL


def test_emission_counted_twice_is_noticed(shared, seed, monkeypatch):
    """By rays as if no emitter had been sampled."""
    honest = derivative_sampling.DerivativeSampling._incident

    def broken(self, *arguments):
        at_once, pdf_light, later = honest(self, *arguments)
        return at_once, mi.Float(0) * pdf_light, later

    monkeypatch.setattr(derivative_sampling.DerivativeSampling, "_incident", broken)
    drawn = Gradients(derivative_sampling.sampled(shared.problem), L2(), BATCH)
    assert shared.against_plain(drawn.uniform(REPEATS, seed)).p_value < LEVEL


@pytest.mark.parametrize("name", some(pixel_samplers(), ("progress",)))
def test_goes_with_every_pixel_sampler(name, shared, seed):
    made = shared.drawn.prepared(configured("sampler", name))
    outcome = shared.against_plain(shared.drawn.sampled(made, REPEATS, seed))
    assert outcome.p_value > LEVEL, str(outcome)
    assert outcome.always_visible < 0.3, str(outcome)


def test_variance_is_less_on_a_glossy_surface(seed):
    """Of the whole image's derivative: there is no loss and no pixel sampler in between."""
    problem = without_targets(dictionary(size=2, depth=4), {"wall.bsdf.roughness.value": 0.15})
    variances = [
        _derivatives(problem, integrator, 200, seed).var()
        for integrator in (problem.integrator, derivative_sampling.sampled(problem).integrator)
    ]
    print("variance of BSDF sampling over that of derivative sampling", variances[0] / variances[1])
    assert variances[0] > 2 * variances[1]


def _derivatives(problem, integrator, repeats: int, base: int) -> np.ndarray:
    """Estimates of Σ_j dI_j/dθ, path after path of all pixels."""
    unknowns, found = problem.unknowns, []
    pixel = dr.tile(dr.arange(mi.UInt32, problem.views.total), 32)
    count = dr.width(pixel)

    def kernel(scene, sensors, views, leaves, seed):
        with dr.suspend_grad():
            stream = rays.stream(seed, count)
            ray, weight = rays.spawn(sensors, views, *views.locate(pixel), stream)
            integrator.backward(scene, stream, ray, weight / count)

    run = dr.freeze(kernel)
    for i in range(repeats):
        unknowns.attach(unknowns.starts())
        seed = dr.opaque(mi.UInt32, (base + i) & 0xFFFFFFFF)
        run(problem.scene, problem.sensors, problem.views, unknowns.leaves, seed)
        found.append(np.array(flat(next(iter(unknowns.gradients().values())))).sum())
    unknowns.write(unknowns.starts())
    return np.array(found, np.float64)


def test_forward_and_backward_agree_path_by_path():
    problem = without_targets(dictionary(size=2, depth=4), {"wall.bsdf.roughness.value": 0.3})
    integrator = derivative_sampling.sampled(problem).integrator
    unknowns = problem.unknowns
    adjoint = mi.Color3f(np.random.default_rng(1).normal(size=(3, problem.views.total)))

    def spawned():
        stream = rays.stream(mi.UInt32(5), problem.views.total)
        pixel = dr.arange(mi.UInt32, problem.views.total)
        ray, _ = rays.spawn(problem.sensors, problem.views, *problem.views.locate(pixel), stream)
        return problem.scene, stream, ray

    unknowns.push_tangent(
        unknowns.starts(), unknowns.values_of({u.key: np.ones_like(u.start) for u in unknowns})
    )
    with dr.suspend_grad():
        along = integrator.forward(*spawned())
    unknowns.attach(unknowns.starts())
    with dr.suspend_grad():
        integrator.backward(*spawned(), adjoint)
    back = float(next(iter(unknowns.gradients().values()))[0])
    unknowns.write(unknowns.starts())
    forth = float(dr.sum(dr.sum(along * adjoint))[0])
    assert forth != 0 and back == pytest.approx(forth, rel=1e-4)


def test_normals_follow_the_derivative_of_the_lobe():
    """4r/(1 + r)² below r = 1 and its complement above."""
    u = mi.Float((np.arange(20000) + 0.5) / 20000)
    for drawn, distribution in (
        (derivative_sampling.lost(u), lambda r: 4 * r / (1 + r) ** 2),
        (derivative_sampling.gained(u), lambda r: 1 - 4 * r / (1 + r) ** 2),
    ):
        assert stats.kstest(np.array(drawn, np.float64), distribution).pvalue > 0.01
    assert np.array(derivative_sampling.lost(u)).max() <= 1
    assert np.array(derivative_sampling.gained(u)).min() >= 1


@pytest.mark.parametrize("alpha", [1e-3, 0.02, 0.1, 0.5])
def test_density_is_that_of_the_lobes_derivative(alpha):
    """|∂(D cos θ)/∂α| over its mass 1/(2α), by central differences of Mitsuba's GGX; per solid
    angle of ω_o."""
    rng = np.random.default_rng(3)
    theta = np.arctan(alpha * np.sqrt(rng.uniform(0.05, 20, 1000)))
    phi = rng.uniform(0, 2 * np.pi, 1000)
    h = mi.Vector3f(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))
    wi = dr.normalize(mi.Vector3f(0.3, -0.1, 0.95))
    wo = 2 * dr.dot(wi, h) * h - wi
    above = np.array(wo.z) > 0.05
    step = 1e-2 * alpha
    ends = [
        np.array(mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha + s).eval(h), np.float64)
        for s in (step, -step)
    ]
    cos = np.cos(theta)
    expected = np.abs(ends[0] - ends[1]) / (2 * step) * cos * 2 * alpha
    expected /= 4 * np.abs(np.array(dr.dot(wi, h)))
    found = np.array(derivative_sampling.parts_pdf(wi, wo, mi.Float(alpha)))
    scale = expected[above].max()
    np.testing.assert_allclose(found[above], expected[above], rtol=0.02, atol=2e-3 * scale)


def test_roulette_begins_where_the_plan_says():
    problem = without_targets(dictionary(size=2, depth=4), {"wall.bsdf.roughness.value": 0.3})
    cut = problem.integrator.cut(replace(problem.integrator.paths, roulette=2))
    found = derivative_sampling.sampled(replace(problem, integrator=cut)).integrator
    assert found.rr_depth == cut.rr_depth == 2


def test_other_unknowns_are_refused():
    problem = without_targets(dictionary(size=2), {"floor.bsdf.base_color.data": 0.5})
    with pytest.raises(InputError, match="'floor.bsdf.base_color.data' is no roughness"):
        derivative_sampling.sampled(problem)


def test_a_roughness_is_what_a_material_takes_as_one():
    """Also where vertices hold the numbers, whatever these are called."""
    scene = dictionary(size=2)
    worn = {"type": "mesh_attribute", "name": "vertex_wear"}
    props = mi.Properties()
    props["bsdf"] = mi.load_dict({"type": "principled", "roughness": worn})
    scene["mesh"] = mi.Mesh("triangle", 3, 1, props=props)
    scene["mesh"].add_attribute("vertex_wear", 1, [0.3] * 3)
    scene["mesh"].set_id("mesh")
    problem = without_targets(scene, {"mesh.vertex_wear": 0.5})
    derivative_sampling.sampled(problem)


def test_roughness_out_of_reach_is_refused():
    """A blend does not tell the roughness of its parts."""
    scene = dictionary(size=2)
    rough = {"type": "roughconductor", "alpha": 0.3}
    scene["wall"]["bsdf"] = {
        "type": "blendbsdf",
        "weight": 0.5,
        "a": rough,
        "b": {"type": "diffuse"},
    }
    problem = without_targets(scene, {"wall.bsdf.bsdf_0.alpha.value": 0.5})
    with pytest.raises(InputError, match="'wall.bsdf.bsdf_0.alpha.value' lies inside a material"):
        derivative_sampling.sampled(problem)


def test_a_roughness_that_a_group_shares_is_refused():
    """What only instances show is not asked for its lobe."""
    shared = {"type": "ref", "id": "shared"}
    rough = {"type": "roughconductor", "alpha": shared}
    more = {
        "group": {"type": "shapegroup", "leaf": {"type": "cube", "bsdf": rough}},
        "one": {"type": "instance", "group": {"type": "ref", "id": "group"}},
    }

    def made(**more):
        scene = dictionary(size=2)
        picture = mi.Bitmap(np.full((2, 2, 1), 0.3, np.float32))
        scene["shared"] = {"type": "bitmap", "bitmap": picture, "raw": True}
        scene["wall"]["bsdf"] = rough
        return without_targets(scene | more, {"wall.bsdf.alpha.data": 0.5})

    derivative_sampling.sampled(made())
    with pytest.raises(InputError, match="'wall.bsdf.alpha.data' lies inside a material or an"):
        derivative_sampling.sampled(made(**more))


def test_other_integrators_are_refused():
    scene = dictionary(size=2)
    scene["integrator"] = {"type": "prb", "max_depth": 4, "hide_emitters": True}
    problem = without_targets(scene, {"wall.bsdf.roughness.value": 0.5})
    with pytest.raises(InputError, match="visible emitters"):
        derivative_sampling.sampled(problem)
