"""The plan of effects in a medium: what it costs, and how often light needs to scatter."""

import math

import numpy as np
import pytest
from gradient_estimates import configured
from scenes_for_tests import render_targets
from volumes_for_tests import ALBEDO, DENSITY, problem

from isas_cli import effects
from isas_cli.effects.settings import Effects
from isas_cli.losses import L2
from isas_cli.rendering import volume
from isas_cli.rendering.integrators import Paths
from isas_cli.runtime.errors import InputError


def decided(p, seconds=None, **settings):
    made = configured("estimator", "two_path")
    return effects.decide(p, Effects(**settings), made, L2(), seconds)


def filled(density: float, albedo: float, times: float = 0.6):
    """From ``times`` the density that it has."""
    start = {"density": times * density, "albedo": 0.8 * albedo}
    p = problem(density, albedo, "prbvolpath", 8, **start)
    render_targets(p, 64)
    return p


def test_thin_media_need_fewer_scatterings_than_thick_ones():
    found = {}
    for name, of in {"thin": (0.03, 0.5, 4.0), "thick": (3.0, 0.95, 0.5)}.items():
        p = filled(*of)
        plan = found[name] = decided(p, 60.0)
        p.unknowns.write(p.unknowns.starts())
        print(name, plan.paths, plan.work, plan.statements)
        assert plan.statements["light samples"].startswith("none:")
        assert "collisions a path at the start" in plan.statements["media"]
        assert "scatters" in plan.statements["paths"] and plan.samples == ()
    first = {name: plan.derivatives[0].gradient[DENSITY].value for name, plan in found.items()}
    assert first["thin"] < 0.2 < first["thick"]
    assert found["thin"].paths.derivative < found["thick"].paths.derivative
    # By the least majorant on ways of at most √12 where nothing scatters, some of which miss.
    least = volume._FEWEST["scatters"] / 2
    assert 0.25 * least < found["thin"].work < least * math.sqrt(12)
    assert found["thick"].work > 0.25 * least


def test_a_start_that_is_as_good_as_empty_shortens_no_paths():
    """Light scatters once there, if at all, and many times in what it is to become."""
    p = filled(3.0, 0.95, 1e-3)
    plan = decided(p, 60.0)
    p.unknowns.write(p.unknowns.starts())
    assert plan.paths.depth == plan.paths.derivative == 8 and plan.work > 0


def test_depths_can_be_set_and_no_light_samples():
    p = filled(1.0, 0.6)
    plan = decided(p, max_depth=3, derivative_depth=2)
    assert plan.paths == Paths(3, 2)
    shown = plan.on(p).integrator
    assert (shown.max_depth, shown.paths.derivative) == (3, 2)
    assert decided(p).paths == Paths(8, 8), "without a budget in seconds nothing is left out"
    assert plan.statements["caustics"].startswith("not met")
    with pytest.raises(InputError, match="caustics=false: no mirror or glass lights a"):
        decided(p, caustics=False)
    with pytest.raises(InputError, match="light_samples=.*no light is sampled in a medium"):
        decided(p, light_samples=[4, 4])
    with pytest.raises(InputError, match="directions=4: no light is sampled in a medium"):
        decided(p, directions=4)
    with pytest.raises(InputError, match=f"max_depth=1: no path of so few edges meets '{ALBEDO}'"):
        decided(p, max_depth=1)
    p.unknowns.write(p.unknowns.starts())


def test_nothing_of_a_glow_can_be_left_out():
    p = problem(1.0, 0.6, "emission")
    render_targets(p, 64)
    plan = decided(p, 60.0)
    assert plan.paths == p.integrator.paths and "nothing scatters" in plan.statements["paths"]
    with pytest.raises(InputError, match="effects.*only emits has no part.*take effects=full"):
        decided(p, max_depth=1)
    assert np.isfinite(plan.seconds)
