"""Media alone: against closed forms, Mitsuba's own paths, and what must hold of any derivative."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from isas_cli.scenes import figures
from runs_for_tests import QUIET, ran
from scenes_for_tests import render_targets, without_targets
from volumes_for_tests import (
    ALBEDO,
    DENSITY,
    SKY,
    N,
    backward,
    description,
    forward,
    problem,
    smooth_rays,
    through_the_middle,
    uneven,
)
from xml_for_tests import camera

from isas_cli import losses
from isas_cli.config.schema import UnknownConfig
from isas_cli.estimators.two_path import TwoPath
from isas_cli.rendering import coverage, rays, volume
from isas_cli.rendering.integrators import Integrator, Medium
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.runtime.errors import InputError
from isas_cli.unknowns.parameters import flat


@pytest.mark.parametrize("density", [1e-3, 0.3, 4.0])
def test_a_glowing_slab(density):
    """L = e (1 - exp(-2σ)) + B exp(-2σ), and its derivatives by σ and e."""
    glow = 0.4
    p = problem(density, glow, "emission")
    ray = through_the_middle(p)
    radiance, _ = p.integrator.primal(p.scene, rays.stream(mi.UInt32(3), N), ray)
    left = math.exp(-2 * density)
    found = np.array(radiance)[0]
    expected, error = glow * (1 - left) + SKY * left, found.std() / math.sqrt(N)
    assert abs(found.mean() - expected) < 4 * error + 1e-5
    repeats = [backward(p, p.unknowns.truths(), ray, seed) for seed in range(12)]
    by_density = np.array([r[DENSITY].sum() for r in repeats])
    by_glow = np.array([r[ALBEDO].sum() for r in repeats])
    for name, sums, exact in (
        ("σ", by_density, 3 * 2 * left * (glow - SKY)),
        ("e", by_glow, 3 * (1 - left)),
    ):
        spread = sums.std(ddof=1) / math.sqrt(len(sums))
        print(f"{name}: {sums.mean():.5f} ± {spread:.5f}, exactly {exact:.5f}")
        assert abs(sums.mean() - exact) < 4 * spread + 1e-4 and spread < 0.05 * max(
            abs(exact), 0.01
        )


@pytest.mark.parametrize("fills", [True, False])
def test_a_medium_ends_where_its_extinction_does(fills):
    """Of a grid in a corner of its shell: around it Mitsuba has nothing."""
    density, albedo = uneven()
    described = description(density, albedo)
    if not fills:  # as a file has it that says no to_world: the cube from 0 to 1
        for name in ("sigma_t", "albedo"):
            described["box"]["interior"][name].pop("to_world")
    p = without_targets(described, {DENSITY: UnknownConfig(start=1.0)})
    assert isinstance(p.integrator, Medium) == fills
    beside = mi.Ray3f(dr.full(mi.Point3f, 0, 64) + [-0.5, -0.4, 5], mi.Vector3f(0, 0, -1))
    seen = np.array(p.integrator.primal(p.scene, rays.stream(mi.UInt32(1), 64), beside)[0])
    assert fills != np.allclose(seen, SKY)
    as_mitsuba_shows_it(p)


def as_mitsuba_shows_it(p) -> None:
    """The truth, in the mean of all pixels."""
    p.unknowns.write(p.unknowns.truths())
    ray = smooth_rays(p)
    found = np.array(p.integrator.primal(p.scene, rays.stream(mi.UInt32(1), N), ray)[0])
    wanted = np.array(mi.render(p.scene, spp=N // 256, seed=5)).reshape(-1, 3).T
    error = found.std(axis=1) / math.sqrt(N)
    assert (np.abs(found.mean(axis=1) - wanted.mean(axis=1)) < 6 * error + 1e-4).all()


@pytest.mark.parametrize(
    "sizes, flipped, own",
    [
        ([1, 1, 1], False, True),
        ([1.3, 0.6, 0.9], False, True),
        ([1, 1, -1], True, True),
        ([1, 1, -1], False, False),
    ],
    ids=["turned", "stretched", "mirrored and flipped", "mirrored"],
)
def test_a_shell_stands_anyhow_and_inside_out_it_is_left_to_mitsuba(sizes, flipped, own):
    """Of a cube that is mirrored the normals point inwards, and its medium is around it."""
    place = mi.ScalarTransform4f().rotate([0.6, 0.8, 0], 40).scale(sizes)
    described = description(*uneven())
    described["box"] |= {"to_world": place, "flip_normals": flipped}
    for each in ("sigma_t", "albedo"):
        grid = described["box"]["interior"][each]
        grid["to_world"] = place @ grid["to_world"]
    p = without_targets(described, {DENSITY: UnknownConfig(start=1.0)})
    assert isinstance(p.integrator, Medium) == own
    as_mitsuba_shows_it(p)


def test_an_emission_inside_out_is_refused():
    described = description(0.5, 0.5, "emission")
    described["box"]["flip_normals"] = True
    with pytest.raises(InputError, match="of normals that point outwards"):
        without_targets(described, {DENSITY: UnknownConfig(start=1.0)})


def test_a_medium_that_no_path_enters_is_told_what_lets_it(monkeypatch, tmp_path):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    p = without_targets(description(*uneven(), "prb"), {DENSITY: 1.0})
    with pytest.raises(InputError, match="let paths into its medium .the integrator volpath"):
        coverage.fill_in(p, 1)


def test_an_emission_that_does_not_fill_its_shell_is_refused():
    described = description(0.5, 0.5, "emission")
    described["box"]["interior"]["sigma_t"].pop("to_world")
    with pytest.raises(InputError, match="which the extinction's volume fills"):
        without_targets(described, {DENSITY: UnknownConfig(start=1.0)})


def test_the_largest_density_of_a_volume_that_stands_alone_is_kept_up():
    """Mitsuba tells a medium of its own parts alone, and tracks by what was largest before."""
    described = description(0.2, 0.5)
    inside = described["box"]["interior"]
    shared = {"type": "scene", "thick": inside["sigma_t"]}
    inside["sigma_t"] = {"type": "ref", "id": "thick"}
    p = without_targets(shared | described, {"thick.data": UnknownConfig(start=1.0)})
    medium = p.scene.shapes()[0].interior_medium()
    p.unknowns.write(p.unknowns.values_of({"thick.data": np.full((4, 4, 4, 1), 7, np.float32)}))
    found = medium.get_majorant(dr.zeros(mi.MediumInteraction3f), True)
    assert float(found[0][0]) == pytest.approx(7)


def test_microflakes_that_are_the_same_all_over_are_as_dense_as_mitsubas():
    """Their extinction is by the path's direction: Mitsuba tells no largest one."""
    normals = {"type": "gridvolume", "raw": True}
    normals["data"] = mi.TensorXf(np.tile(np.float32([1, 0.1, 0.1, 0, 0, 0]), (2, 2, 2, 1)))
    flakes = {"type": "homogeneous", "sigma_t": {"type": "constvolume", "value": 8.0}}
    flakes["albedo"] = {"type": "constvolume", "value": {"type": "rgb", "value": 0.9}}
    flakes["phase"] = {"type": "sggx", "S": normals}
    described = description(1.0, 0.9)
    described["box"]["interior"] = flakes
    albedo = "box.interior_medium.albedo.value.value"
    p = without_targets(described, {albedo: UnknownConfig(start=0.9)})
    stream, ray = rays.stream(mi.UInt32(1), N), smooth_rays(p)
    found = np.array(p.integrator.primal(p.scene, stream, ray)[0])
    how = mi.load_dict({"type": "volpath", "max_depth": 64, "rr_depth": 64})
    wanted = np.array(mi.render(p.scene, integrator=how, spp=N // 256, seed=5))
    error = found.std(axis=1) / math.sqrt(N)
    difference = found.mean(axis=1) - wanted.reshape(-1, 3).mean(axis=0)
    print(found.mean(axis=1), difference / error)
    assert (np.abs(difference) < 6 * error).all()


def test_a_furnace_has_no_derivative_by_density(monkeypatch):
    """Nothing is absorbed, and light comes alike from everywhere: the images cannot tell the
    density. A majorant that equals a constant density has no null collisions, and is noticed."""

    def found() -> tuple[float, float]:
        p = problem(1.5, 1.0)
        values = p.unknowns.truths()
        sums = [backward(p, values, through_the_middle(p), s)[DENSITY].sum() for s in range(12)]
        return float(np.mean(sums)), float(np.std(sums, ddof=1) / math.sqrt(len(sums)))

    monkeypatch.setattr("isas_cli.unknowns.grid._ALBEDO", (0.01, 1.0))
    p = problem(1.5, 1.0)
    radiance, _ = p.integrator.primal(p.scene, rays.stream(mi.UInt32(3), N), through_the_middle(p))
    np.testing.assert_allclose(np.array(radiance), SKY, rtol=1e-4)
    mean, error = found()
    print(f"{mean:.4f} ± {error:.4f}")
    assert abs(mean) < 4 * error and error < 0.05
    monkeypatch.setattr(volume, "_MARGIN", 1.0)
    monkeypatch.setitem(volume._FEWEST, "scatters", 0.0)
    mean, error = found()
    assert abs(mean) > 10 * error


def test_images_and_gradients_are_those_of_prbvolpath():
    p = problem(*uneven())
    stock = Integrator(p.integrator.mitsuba)
    pixel = dr.tile(dr.arange(mi.UInt32, p.views.total), N // p.views.total)
    adjoint = np.random.default_rng(5).normal(size=p.views.total).astype(np.float32) / N
    weight = mi.Color3f(dr.gather(mi.Float, mi.Float(adjoint), pixel))
    values = p.unknowns.values_of(
        {DENSITY: uneven()[0][..., None] * 0.8, ALBEDO: uneven()[1] * 0.9}
    )
    images, gradients = [], []
    for integrator in (p.integrator, stock):
        rows = {"image": [], "gradient": []}
        for seed in range(12):
            stream = rays.stream(mi.UInt32(seed), N)
            ray, _ = rays.spawn(p.sensors, p.views, *p.views.locate(pixel), stream)
            p.unknowns.attach(values)
            with dr.suspend_grad():
                radiance, _ = integrator.primal(p.scene, stream.clone(), ray)
                integrator.backward(p.scene, stream, ray, weight)
            shown = np.array(radiance, np.float64).T.reshape(-1, p.views.total, 3).mean(axis=0)
            rows["image"].append(shown.ravel())
            found = p.unknowns.gradients()
            rows["gradient"].append(np.concatenate([np.array(flat(found[k])) for k in values]))
            p.unknowns.write(values)
        images.append(np.array(rows["image"]))
        gradients.append(np.array(rows["gradient"], np.float64))
    for what, (own, other) in (("image", images), ("gradient", gradients)):
        difference = own.mean(axis=0) - other.mean(axis=0)
        error = np.sqrt(own.var(axis=0, ddof=1) / 12 + other.var(axis=0, ddof=1) / 12)
        z = difference[error > 0] / error[error > 0]
        print(f"{what}: χ²/n {np.mean(z**2):.2f}, largest {np.abs(z).max():.1f}, of {z.size}")
        # Student's t of about 20 degrees of freedom has a variance of 1.1.
        assert 0.7 < np.mean(z**2) < 1.5 and np.abs(z).max() < 6
        together = np.linalg.norm(difference) / np.linalg.norm(other.mean(axis=0))
        assert together < 0.15


@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize("integrator", ["prbvolpath", "emission"])
def test_forwards_is_backwards_transposed(integrator, levels):
    """⟨Jᵀa, z⟩ = ⟨a, Jz⟩, path by path, at the coarsest level too."""
    p = problem(*uneven(), integrator, levels=levels)
    rng, shapes = np.random.default_rng(1), p.unknowns.shapes(0)
    arrays = {u.key: u.kind.coarse(u.truth, shapes[u.key]) for u in p.unknowns}
    values = p.unknowns.values_of(arrays)
    tangents = {key: rng.normal(size=shape).astype(np.float32) for key, shape in shapes.items()}
    ray, adjoint = smooth_rays(p), (0.3, -1.0, 0.7)
    one = forward(p, values, tangents, ray, adjoint)
    gradients = backward(p, values, ray, 1, adjoint)
    assert [g.size for g in gradients.values()] == [t.size for t in tangents.values()]
    other = sum(gradients[k] @ tangents[k].ravel() for k in gradients)
    print(one, other)
    assert one == pytest.approx(other, rel=2e-4)


@pytest.mark.parametrize("levels", [1, 2])
def test_emission_is_differentiated_as_finite_differences_are(levels, monkeypatch):
    """With the same random numbers no decision depends on the unknowns, roulette left out: the
    derivative of the estimate itself, along a direction that leaves the majorant alone."""
    monkeypatch.setattr(volume, "_WEAK", 0.0)
    density, albedo = uneven()
    density[1, 2, 1] = 6.0  # by far the most, also where it is coarse
    p = problem(density, albedo, "emission", levels=levels)
    rng, shapes, ray = np.random.default_rng(1), p.unknowns.shapes(0), smooth_rays(p)
    at = {u.key: u.kind.coarse(u.truth, shapes[u.key]) for u in p.unknowns}
    towards = {k: rng.normal(size=s).astype(np.float32) for k, s in shapes.items()}
    towards[DENSITY][at[DENSITY] == at[DENSITY].max()] = 0
    if levels > 1:  # between points the majorant's may be another's
        towards[DENSITY] *= 0.2
    gradients = backward(p, p.unknowns.values_of(at), ray)
    for key in (DENSITY, ALBEDO):
        ends, h = [], 0.02
        for sign in (1, -1):
            moved = at | {key: at[key] + np.float32(sign * h) * towards[key]}
            p.unknowns.write(p.unknowns.values_of(moved))
            radiance, _ = p.integrator.primal(p.scene, rays.stream(mi.UInt32(1), N), ray)
            ends.append(np.array(radiance, np.float64).mean(axis=1).sum())
        quotient, along = (ends[0] - ends[1]) / (2 * h), gradients[key] @ towards[key].ravel()
        print(key, along, quotient)
        assert along == pytest.approx(quotient, rel=5e-3)


@pytest.mark.parametrize("integrator", ["prbvolpath", "emission"])
@pytest.mark.parametrize("density", [1e-3, 0.5, 3.0])
def test_what_is_left_of_the_light_behind(integrator, density, monkeypatch):
    """Transmittance exp(-2σ) through a medium that neither scatters nor glows."""
    monkeypatch.setattr("isas_cli.unknowns.grid._ALBEDO", (0.0, 1.0))
    p = problem(density, 0.0, integrator)
    found = np.array(
        p.integrator.primal(p.scene, rays.stream(mi.UInt32(3), N), through_the_middle(p))[0]
    )[0]
    expected, error = SKY * math.exp(-2 * density), found.std() / math.sqrt(N)
    print(found.mean(), expected, error)
    assert error < 0.01 and abs(found.mean() - expected) < 4 * error + 1e-5


def test_frozen_kernels_see_every_update():
    steps, uniform = [], None
    for freeze in (True, False):
        p = problem(*uneven())
        render_targets(p, 64)
        uniform = PixelDistribution.uniform(Tiles.over(p.views))
        estimator, found = TwoPath(p, losses.L2(), 4096, freeze), []
        for i in range(4):
            # The majorant changes with the largest density.
            arrays = {DENSITY: uneven()[0][..., None] * (0.5 + 0.7 * i), ALBEDO: uneven()[1] * 0.9}
            arrays = {key: array.astype(np.float32) for key, array in arrays.items()}
            gradients = estimator.estimate(p.unknowns.values_of(arrays), uniform, 1, i, 0.0)
            found.append(np.concatenate([np.array(flat(g)) for g in gradients.values()]))
        p.unknowns.write(p.unknowns.starts())
        steps.append(np.stack(found))
    assert np.isfinite(steps[0]).all() and steps[0].any(axis=1).all()
    # A rounding that is another lets a rare path collide elsewhere, and all that follows differ.
    apart = [np.median(np.abs(a - b)) / np.median(np.abs(b)) for a, b in zip(*steps)]
    print(apart)
    assert max(apart) < 0.02


BESIDE = {
    "a ball": {"type": "sphere", "center": [2, 0, 0], "radius": 0.3},
    "a lamp": {"type": "point", "position": [3, 3, 3]},
    "a sun": {"type": "directional", "direction": [0, -1, 0]},
}


@pytest.mark.parametrize("what", BESIDE)
def test_what_is_not_one_medium_alone_keeps_mitsubas_paths(what):
    scene = description(*uneven()) | {"beside": BESIDE[what]}
    assert type(without_targets(scene, {DENSITY: 1.0}).integrator) is Integrator
    with pytest.raises(InputError, match="emission is for one medium in a cube or sphere"):
        without_targets(scene | {"integrator": {"type": "emission"}}, {DENSITY: 1.0})


GREY = {"type": "rgb", "value": [0.5, 0.5, 0.5]}
COLOURED = {"type": "rgb", "value": [0.2, 0.4, 0.8]}
GLASS = {"type": "thindielectric"}
HALF = {"type": "mask", "opacity": 0.5, "nested": {"type": "diffuse"}}
BLEND = {"type": "blendphase", "weight": 0.3, "a": {"type": "isotropic"}, "b": {"type": "hg"}}


def fog(extinction, bsdf=None, **more) -> dict:
    inside = {"type": "homogeneous", "sigma_t": extinction, "albedo": 0.8, **more}
    whole = description(1.0, 0.5)
    whole["box"] = {"type": "cube", "bsdf": bsdf or {"type": "null"}, "interior": inside}
    return whole


@pytest.mark.parametrize(
    "whole, unknowns, own",
    [
        (fog(GREY), {}, True),
        (fog(GREY), {"box.interior_medium.albedo.value.value": 0.5}, True),
        (fog(GREY), {"box.interior_medium.sigma_t.value.value": 0.5}, False),
        (fog(COLOURED), {}, False),
        (fog(GREY, GLASS), {}, False),
        (fog(GREY, HALF), {}, False),
        (fog(GREY, phase=BLEND), {}, True),
        (
            fog(GREY, phase=BLEND),
            {"box.interior_medium.phase_function.weight.value.value": 0.5},
            False,
        ),
        (
            fog(GREY, phase={"type": "hg", "g": 0.5}),
            {"box.interior_medium.phase_function.g": 0.3},
            False,
        ),
    ],
    ids=[*("grey", "albedo", "three unknown", "coloured", "glass", "half", "blend")]
    + ["phase unknown", "g unknown"],
)
def test_what_is_more_than_a_grey_medium_is_left_to_mitsuba(whole, unknowns, own):
    p = without_targets(whole, unknowns or {"sky.radiance.value": 0.5})
    assert type(p.integrator) is (Medium if own else Integrator)


def test_a_medium_beside_others_outside_is_left_to_mitsuba():
    whole = fog(GREY)
    whole["box"]["exterior"] = {"type": "homogeneous", "sigma_t": 0.1, "albedo": 0.5}
    assert volume.medium_of(mi.load_dict(whole)) is None


def sky_of(kind: str) -> dict:
    if kind == "smoke's":
        return figures.sky(16)
    if kind == "one texel":  # with most of the light
        texels = np.full((64, 128, 3), 0.5, np.float32)
        texels[20, 40] = 2e4
        return {"type": "envmap", "bitmap": mi.Bitmap(texels)}
    return {"type": "sunsky", "sun_scale": float(kind == "sunny")}


@pytest.mark.parametrize(
    "kind, sunny", [("one texel", True), ("sunny", True), ("no sun", False), ("smoke's", False)]
)
def test_a_sun_is_left_to_paths_that_sample_it(kind, sunny):
    """But for what only emits, where no path is turned towards it."""
    for integrator, own in (("prbvolpath", not sunny), ("emission", True)):
        whole = description(*uneven(), integrator) | {"sky": sky_of(kind)}
        made = without_targets(whole, {DENSITY: 1.0})
        assert type(made.integrator) is (Medium if own else Integrator), integrator


def test_a_glow_of_several_extinctions_is_refused():
    whole = fog(COLOURED) | {"integrator": {"type": "emission"}}
    with pytest.raises(InputError, match="where it is alike in all channels"):
        without_targets(whole, {"sky.radiance.value": 0.5})


def test_coloured_fog_looks_as_mitsuba_has_it():
    """In a furnace that absorbs nothing all channels stay as bright as the sky."""
    whole = fog(COLOURED)
    whole["box"]["interior"]["albedo"] = 1.0
    p = without_targets(whole, {"sky.radiance.value": 0.5})
    p.unknowns.write(p.unknowns.truths())
    radiance, _ = p.integrator.primal(p.scene, rays.stream(mi.UInt32(3), N), through_the_middle(p))
    np.testing.assert_allclose(np.array(radiance).mean(axis=1), SKY, rtol=0.02)


def test_the_direction_that_fog_scatters_in_is_found(tmp_path):
    """By a lamp behind it, which hardly shows where light is scattered backwards."""
    file = tmp_path / "fog.xml"
    file.write_text(f"""<scene version="3.0.0"><integrator type="volpath">
<integer name="max_depth" value="6"/></integrator>{camera("0,0,5", fov=40)}
<shape type="rectangle"><transform name="to_world"><rotate y="1" angle="0"/>
<translate z="-3"/></transform><emitter type="area"><rgb name="radiance" value="4"/></emitter>
</shape><shape type="cube" id="box"><bsdf type="null"/><medium name="interior"
type="homogeneous"><float name="albedo" value="0.9"/><float name="sigma_t" value="1"/>
<phase type="hg"><float name="g" value="0.6"/></phase></medium></shape></scene>""")
    run = ran(
        *(tmp_path / "run", "scene=file", f"scene.path={file}", "target.spp=256", *QUIET),
        "scene.unknowns={box.interior_medium.phase_function.g: {start: 0, lr: 0.05}}",
        *("sampler=uniform", "estimator.batch=1024", "budget.iterations=60"),
    )
    assert run.history["parameter_rmse"].iloc[-1] < 0.1 * 0.6
