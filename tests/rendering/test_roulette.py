"""Russian roulette and the derivatives of what is nearly black."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scenes_for_tests import dictionary, without_targets

from isas_cli.rendering import rays, roulette
from isas_cli.rendering.kernels import recorded

BLACK, SEEDS, COPIES = 1e-6, 16, 192
MATTE = {"type": "diffuse", "reflectance": 0.7}
PANE = {"type": "thindielectric", "specular_transmittance": BLACK}


def black(key: str, bsdf: dict, depth: int, rr_depth: int):
    """A floor of next to black before a bright wall, and a pane of it before both."""
    scene = dictionary(depth=depth)
    scene["integrator"]["rr_depth"] = rr_depth
    scene["wall"]["bsdf"] = MATTE
    scene["floor"]["bsdf"] = {"type": "diffuse", "reflectance": BLACK}
    scene["ceiling"] = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 3.5, 0]).rotate([1, 0, 0], 90).scale(3),
        "bsdf": MATTE,
    }
    scene["pane"] = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 0.5, 1.2]),
        "bsdf": bsdf,
    }
    return without_targets(scene, {key: BLACK})


def derivatives(p) -> np.ndarray:
    """Of the mean picture by the one unknown, ``(SEEDS,)``."""
    (key,) = p.unknowns.keys
    like, found = p.unknowns[key].start, []
    values = p.unknowns.values_of({key: np.full_like(like, BLACK)})
    pixel = dr.tile(dr.arange(mi.UInt32, p.views.total), COPIES)
    lanes, integrator = dr.width(pixel), p.integrator

    def kernel(scene, sensors, views, leaves, pixel, seed):
        with dr.suspend_grad():
            stream = rays.stream(seed, lanes)
            ray, _ = rays.spawn(sensors, views, *views.locate(pixel), stream)
            moved = integrator.forward(scene, stream, ray)
            dr.eval(moved)
            return moved

    run = recorded(kernel, p)
    for seed in range(SEEDS):
        p.unknowns.push_tangent(values, p.unknowns.values_of({key: np.ones_like(like)}))
        seed = dr.opaque(mi.UInt32, seed)
        moved = run(p.scene, p.sensors, p.views, p.unknowns.leaves, pixel, seed)
        found.append(np.array(moved).mean())
    return np.array(found, np.float64)


@pytest.mark.parametrize("depth", [8, 10], ids=["unrolled", "replayed"])
@pytest.mark.parametrize(
    "key, pane",
    [("floor.bsdf.reflectance.value", MATTE), ("pane.bsdf.specular_transmittance.value", PANE)],
    ids=["reflectance", "transmittance"],
)
def test_derivatives_of_what_is_black_are_those_without_roulette(depth, key, pane, monkeypatch):
    without = derivatives(black(key, pane, depth, 1000))
    with_it = derivatives(black(key, pane, depth, 1))
    error = np.hypot(*(each.std(ddof=1) / np.sqrt(SEEDS) for each in (without, with_it)))
    assert 4 * error < 0.1 * without.mean()
    assert abs(with_it.mean() - without.mean()) < 4 * error
    # By the throughput alone all that goes on from there is lost.
    monkeypatch.setattr(roulette, "_DARK", 0.0)
    lost = derivatives(black(key, pane, depth, 1))
    assert lost.mean() < 0.9 * without.mean()
