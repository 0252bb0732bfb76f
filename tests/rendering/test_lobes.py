"""Mirrors, clear glass and gaps beside smooth lobes: derivatives, and agreement with Mitsuba."""

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from montecarlo import welch
from scenes_for_tests import without_targets

from isas_cli.rendering import rays
from isas_cli.rendering.integrators import Replayed, Unrolled, sampled
from isas_cli.rendering.kernels import recorded
from isas_cli.rendering.lobes import touched
from isas_cli.runtime.errors import InputError

LANES, SEEDS = 1 << 15, 24
# Unlike channels must not hide each other.
WEIGHTS = np.array([1.0, 0.7, 0.3])

_DIFFUSE = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.3, 0.4, 0.5]}}
_MIRROR = {"type": "conductor", "specular_reflectance": {"type": "rgb", "value": [0.8, 0.6, 0.4]}}
_GLASS = {"type": "dielectric", "specular_transmittance": 0.8}
_THIN = {"type": "thindielectric", "specular_transmittance": 0.8}
_PLASTIC = {"type": "plastic", "diffuse_reflectance": 0.4, "specular_reflectance": 0.8}
_DARK = {"type": "diffuse", "reflectance": 0.02}
_ROUGH = {"type": "roughplastic", "diffuse_reflectance": 0.1}
_CLEARCOAT = {"type": "principled", "clearcoat": 0.5}


def blend(weight: float, first: dict, second: dict) -> dict:
    return {"type": "blendbsdf", "weight": weight, "first": first, "second": second}


def mask(opacity: float, inside: dict) -> dict:
    return {"type": "mask", "opacity": opacity, "inside": inside}


def two_sided(*inside: dict) -> dict:
    return {"type": "twosided"} | {f"side{i}": each for i, each in enumerate(inside)}


def textured(key: str, material: dict) -> dict:
    """``material``, its number ``key`` a picture of some."""
    chance = np.random.default_rng(0).random((4, 4, 1), np.float32)
    texture = {"type": "bitmap", "data": mi.TensorXf(chance), "raw": True, "format": "variant"}
    return material | {key: texture}


def problem(material: dict, word: str, start: float = 0.5, depth: int = 4, **integrator):
    place = mi.ScalarTransform4f()
    lamp = {"type": "area", "radiance": {"type": "rgb", "value": [6, 5, 4]}}
    wall = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.1, 0.3, 0.5]}}
    description = {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": depth} | integrator,
        "sensor": {
            "type": "perspective",
            "to_world": place.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16},
        },
        "sky": {"type": "constant"},
        "lamp": {
            "type": "sphere",
            "to_world": place.translate([0, 2, 1.5]).scale(0.5),
            "emitter": lamp,
        },
        "wall": {"type": "rectangle", "to_world": place.translate([0, 0, -2]).scale(3), "b": wall},
        "ball": {"type": "sphere", "bsdf": material},
    }
    return without_targets(description, {f"ball.bsdf.{word}": start})


def shown(p, render):
    """A function of a seed: what ``render(scene, stream, ray)`` finds, in the mean of rays through
    the whole picture. Recorded once."""
    total = p.views.total

    def kernel(scene, sensors, views, leaves, seed):
        with dr.suspend_grad():
            stream = rays.stream(seed, LANES)
            pixel = dr.minimum(mi.UInt32(stream.next_1d() * total), total - 1)
            ray, _ = rays.spawn(sensors, views, *views.locate(pixel), stream)
            found = render(scene, stream, ray)
            dr.eval(found)
            return found

    run = recorded(kernel, p)

    def mean(seed: int) -> float:
        seed = dr.opaque(mi.UInt32, seed)
        found = run(p.scene, p.sensors, p.views, p.unknowns.leaves, seed)
        return float((WEIGHTS @ np.array(found)).mean())

    return mean


def radiances(p, value: float, render, first: int) -> np.ndarray:
    key, mean = p.unknowns.keys[0], shown(p, render)
    p.unknowns.write(p.unknowns.values_of({key: np.full_like(p.unknowns[key].start, value)}))
    return np.array([mean(first + seed) for seed in range(SEEDS)])[:, None]


def mitsuba(p):
    """Mitsuba's own paths."""
    base = p.integrator.mitsuba
    return lambda scene, stream, ray: sampled(base, dr.ADMode.Primal, scene, stream, ray)[0]


def derivatives(p, value: float, integrator, first: int) -> np.ndarray:
    key, mean = p.unknowns.keys[0], shown(p, integrator.forward)
    like, found = p.unknowns[key].start, []
    for seed in range(SEEDS):
        p.unknowns.push_tangent(
            *(p.unknowns.values_of({key: np.full_like(like, x)}) for x in (value, 1))
        )
        found.append(mean(first + seed))
    return np.array(found)[:, None]


def differences(p, value: float) -> np.ndarray:
    # Nearly linear, and noisier the nearer the sides are: lobes are drawn by other chances.
    step = 0.1 if 0.1 < value < 0.9 else 0.02
    low, high = max(value - step, 0), min(value + step, 1)
    sides = [radiances(p, at, mitsuba(p), 500) for at in (low, high)]
    return (sides[1] - sides[0]) / (high - low)


CASES = [
    (mask(0.6, _PLASTIC), "opacity.value", 0.6),
    (mask(0.6, _PLASTIC), "nested_bsdf.diffuse_reflectance.value", 0.2),
    (mask(0.6, blend(0.4, _ROUGH, _MIRROR)), "nested_bsdf.weight.value", 0.5),
    (blend(0.5, _DIFFUSE, _MIRROR), "bsdf_0.reflectance.value", 0.3),
    (blend(0.5, _DIFFUSE, _GLASS), "weight.value", 0.5),
    (blend(0.5, _DIFFUSE, {"type": "null"}), "weight.value", 0.3),
    (blend(0.3, _CLEARCOAT, _MIRROR), "bsdf_0.clearcoat.value", 0.3),
    (blend(0.4, blend(0.3, _DIFFUSE, _MIRROR), mask(0.7, _ROUGH)), "bsdf_0.weight.value", 0.5),
    (two_sided(_PLASTIC, _MIRROR), "brdf_0.specular_reflectance.value", 0.4),
    (_GLASS, "specular_transmittance.value", 0.7),
    (_THIN, "specular_transmittance.value", 0.7),
    # Where nothing would be drawn of what is off.
    (mask(0.6, _MIRROR), "opacity.value", 1 - 1e-6),
    (mask(0.6, _DARK), "opacity.value", 1e-6),
    (blend(0.5, _MIRROR, {"type": "null"}), "weight.value", 1e-6),
]


def test_colours_that_a_material_reads_from_its_mesh_are_of_its_lobes():
    """The attribute is the mesh's, and no part of the material."""
    colours = {"type": "mesh_attribute", "name": "vertex_color"}
    for material in ({"type": "conductor"}, {"type": "diffuse"}):
        word = "specular_reflectance" if material["type"] == "conductor" else "reflectance"
        made = mi.Mesh("m", 3, 1)
        values = mi.traverse(made)
        values["vertex_positions"] = np.float32([0, 0, 0, 1, 0, 0, 0, 1, 0])
        values["faces"] = np.uint32([0, 1, 2])
        values.update()
        made.add_attribute("vertex_color", 3, np.full(9, 0.5, np.float32))
        made.set_bsdf(mi.load_dict(material | {word: colours}))
        made.set_id("m")
        described = {"type": "scene", "m": made, "sky": {"type": "constant"}}
        found = touched(mi.traverse(mi.load_dict(described, optimize=False)), ["m.vertex_color"])
        assert (found is not None) == (material["type"] == "conductor"), material


def _name(case) -> str:
    material, word, at = case
    inside = ", ".join(v["type"] for v in material.values() if isinstance(v, dict))
    return f"{material['type']}({inside}).{word} at {at:.3g}"


@pytest.mark.parametrize("material, word, at", CASES, ids=map(_name, CASES))
def test_derivatives_and_radiances_are_those_of_mitsubas_pictures(material, word, at):
    p = problem(material, word)
    paths, lobes = p.integrator.paths, p.integrator.lobes
    expected = differences(p, at)
    for number, kind in enumerate((Unrolled, Replayed)):
        own = kind(p.integrator.mitsuba, paths, lobes)
        found = welch(derivatives(p, at, own, 1000 * (number + 1)), expected)
        print(kind.__name__, expected.mean(), found)
        assert found.p_value > 1e-3, f"{kind.__name__}: {found}, of {expected.mean():.3g}"
        # Or the test could not fail.
        assert found.always_visible < 0.12 * abs(expected.mean()) + 2e-3, str(found)
    # What a replay replays, taken apart, shows the same picture.
    own = Replayed(p.integrator.mitsuba, paths, lobes)
    traced = lambda scene, stream, ray: own.once(dr.ADMode.Primal, scene, stream, ray, True)
    found = welch(radiances(p, at, traced, 7000), radiances(p, at, mitsuba(p), 8000))
    assert found.p_value > 1e-3, str(found)


def test_the_comparison_notices_a_lobe_that_is_not_taken_apart():
    p = problem(mask(0.6, _DIFFUSE), "opacity.value")
    whole = Unrolled(p.integrator.mitsuba, p.integrator.paths)
    assert welch(derivatives(p, 0.6, whole, 1000), differences(p, 0.6)).p_value < 1e-6


@pytest.mark.parametrize(
    "material, word",
    [
        (textured("opacity", mask(0.6, _DIFFUSE)), "opacity.data"),
        (textured("weight", blend(0.5, _DIFFUSE, _MIRROR)), "weight.data"),
    ],
)
def test_textures_get_the_derivative_of_each_texel(material, word):
    p = problem(material, word)
    key = p.unknowns.keys[0]
    rng = np.random.default_rng(1)
    at = (0.2 + 0.6 * rng.random((4, 4, 1))).astype(np.float32)
    signs = rng.choice([-1.0, 1.0], (4, 4, 1)).astype(np.float32)
    render, forward = shown(p, mitsuba(p)), shown(p, p.integrator.forward)

    def difference(seed: int) -> float:
        sides = []
        for offset in (-0.02, 0.02):
            p.unknowns.write(p.unknowns.values_of({key: at + offset * signs}))
            sides.append(render(seed))
        return (sides[1] - sides[0]) / 0.04

    def derivative(seed: int) -> float:
        p.unknowns.push_tangent(*(p.unknowns.values_of({key: each}) for each in (at, signs)))
        return forward(seed)

    found = welch(*(np.array([[f(s)] for s in range(SEEDS)]) for f in (derivative, difference)))
    assert found.p_value > 1e-3, str(found)


def test_only_materials_of_unknowns_are_taken_apart():
    assert problem(_DIFFUSE, "reflectance.value").integrator.lobes is None
    assert problem(_ROUGH, "diffuse_reflectance.value").integrator.lobes is None
    p = problem(_PLASTIC, "diffuse_reflectance.value")
    assert p.integrator.lobes.keys == ("ball.bsdf.diffuse_reflectance.value",)
    paths = dataclasses.replace(p.integrator.paths, derivative=2)
    assert p.integrator.cut(paths).lobes is p.integrator.lobes


@pytest.mark.parametrize(
    "word, start", [("nested_bsdf.opacity.value", 0.5), ("normalmap.data", [0.5, 0.5, 1.0])]
)
def test_a_map_around_a_gap_is_refused(word, start):
    flat = np.tile(np.float32([0.5, 0.5, 1]), (2, 2, 1))
    normal = {"type": "bitmap", "data": mi.TensorXf(flat), "raw": True}
    material = {"type": "normalmap", "normalmap": normal, "b": mask(0.6, _DIFFUSE)}
    with pytest.raises(InputError, match="put the map inside"):
        problem(material, word, start)
