"""The BSDF of the PBDR paper's Eq. (5): what it reflects, how it is sampled, its derivatives."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from isas_cli.scene import phong  # noqa: F401  (registers it)

DIFFUSE, SPECULAR = 0.3, 0.5


def material(roughness: float, diffuse: float = DIFFUSE, specular: float = SPECULAR) -> mi.BSDF:
    return mi.load_dict(
        {"type": "phong", "diffuse": diffuse, "specular": specular, "roughness": roughness}
    )


def hit(tilt: float, size: int = 1) -> mi.SurfaceInteraction3f:
    """Seen from ``tilt`` radians beside the normal."""
    si = dr.zeros(mi.SurfaceInteraction3f, size)
    si.wi = mi.Vector3f(math.sin(tilt), 0.0, math.cos(tilt))
    return si


def equation_5(wi, wo, roughness: float) -> float:
    """As printed, in double precision, times the cosine that a renderer adds."""
    n = 2 / roughness**2 - 2
    along = max(0.0, float(np.dot([-wi[0], -wi[1], wi[2]], wo)))
    lobe = along**n if along else 0.0
    return (DIFFUSE / np.pi + SPECULAR * (n + 2) / (2 * np.pi) * lobe) * wo[2]


def test_it_is_equation_5(rng):
    for roughness in (0.1, 0.4, 1.0):
        for _ in range(20):
            wi, wo = rng.normal(size=(2, 3))
            wi, wo = (v / np.linalg.norm(v) * np.sign(v[2]) for v in (wi, wo))
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.wi = mi.Vector3f(*wi.tolist())
            found = material(roughness).eval(mi.BSDFContext(), si, mi.Vector3f(*wo.tolist()))
            wanted = equation_5(wi, wo, roughness)
            assert np.allclose(np.array(found).ravel(), wanted, rtol=2e-4, atol=1e-6)


def test_from_behind_it_is_black():
    si = hit(0.3)
    behind = mi.Vector3f(0.1, 0.2, -math.sqrt(0.95))
    assert np.all(np.array(material(0.3).eval(mi.BSDFContext(), si, behind)) == 0)
    si.wi = -si.wi
    sample, weight = material(0.3).sample(mi.BSDFContext(), si, 0.3, mi.Point2f(0.2, 0.6))
    assert np.all(np.array(weight) == 0)


@pytest.mark.parametrize("roughness, tilt", [(0.15, 0.2), (0.5, 1.2), (1.0, 0.7)])
def test_directions_are_drawn_as_the_density_says(roughness, tilt):
    plugin = f'<float name="roughness" value="{roughness}"/>'
    sample, pdf = mi.chi2.BSDFAdapter(
        "phong", plugin, wi=dr.normalize(mi.ScalarVector3f(np.sin(tilt), 0, np.cos(tilt)))
    )
    test = mi.chi2.ChiSquareTest(
        domain=mi.chi2.SphericalDomain(),
        sample_func=sample,
        pdf_func=pdf,
        sample_dim=3,
        sample_count=200_000,
        res=101,
        ires=32,
    )
    assert test.run(), test.messages


@pytest.mark.parametrize("roughness", [0.1, 0.5, 1.0])
def test_what_comes_along_the_normal_is_reflected_by_the_albedos_share(roughness):
    """In closed form ρ_d + ρ_s: nothing of the lobe is cut off there."""
    count, rng = 1 << 18, np.random.default_rng(1)
    numbers = rng.random((3, count)).astype(np.float32)
    si = hit(0.0, count)
    _, weight = material(roughness).sample(
        mi.BSDFContext(), si, mi.Float(numbers[0]), mi.Point2f(numbers[1], numbers[2])
    )
    weights = np.array(weight)[0]
    error = weights.std() / np.sqrt(count)
    print(f"{weights.mean():.5f} +- {error:.5f}")
    assert abs(weights.mean() - DIFFUSE - SPECULAR) < 4 * error + 1e-4
    assert error < 2e-3


def test_derivatives_are_those_of_differences_and_always_finite():
    tilt, step = 0.5, 1e-3
    for name, value in (("diffuse", DIFFUSE), ("specular", SPECULAR), ("roughness", 0.3)):
        bsdf = material(0.3)
        params = mi.traverse(bsdf)
        key = f"{name}.value"
        si = hit(tilt, 4)
        # Near the mirror direction, beside it, where the lobe is 0, below the surface.
        wo = mi.Vector3f(
            [-0.45, 0.2, np.sin(tilt + np.pi / 2), 0.0],
            [0.05, 0.3, 0.0, 0.0],
            [0.89, 0.93, max(0.0, float(np.cos(tilt + np.pi / 2))) + 1e-3, -1.0],
        )
        wo = dr.normalize(wo)
        kind = type(params[key])

        def at(x):
            params[key] = kind(x)
            params.update()
            return np.array(bsdf.eval(mi.BSDFContext(), si, wo))[0]

        differences = (at(value + step) - at(value - step)) / (2 * step)
        leaf = kind(value)
        dr.enable_grad(leaf)
        params[key] = leaf
        params.update()
        value_there = bsdf.eval(mi.BSDFContext(), si, wo)
        dr.forward(leaf)
        found = np.array(dr.grad(value_there))[0]
        assert np.all(np.isfinite(found))
        assert np.allclose(found, differences, rtol=2e-2, atol=2e-3), (name, found, differences)
        assert np.abs(differences[:2]).min() > 1e-3
