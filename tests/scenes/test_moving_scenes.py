"""Every scene whose objects move, with every gradient that can move them: three iterations at the
size `tiny`, as configured; and one that is solved."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from crosses import crossed
from problems_for_tests import configured, iterated, workshops
from test_tiny_scenes import ITERATIONS, MOVING, SMALL

from isas_cli.engine.loop import Hooks
from isas_cli.engine.workshop import Workshop
from isas_cli.rendering.integrators import Unrolled

GRADIENTS = {
    "plateau": ["sampler=plateau"],
    "drawn": ["sampler=plateau", "sampler.base=differences"],
    "loss": ["sampler=plateau", "sampler.smooth=loss", "sampler.base=gradient"],
    "renderer": ["sampler=plateau", "sampler.gradient=renderer", "sampler.silhouettes=direct"],
    "mitsuba": ["sampler=mitsuba", "sampler.silhouettes=direct"],
    "finite_differences": ["sampler=finite_differences"],
}


workshop = workshops(*SMALL)

# Finite differences of sort take 300 renderings a step; the other scenes show that they run.
CROSSED = [
    pair
    for pair in crossed(MOVING, [*GRADIENTS], 1, always=["plateau"])
    if pair.values != ("sort", "finite_differences")
]


@pytest.mark.parametrize("workshop, name", CROSSED, indirect=["workshop"])
def test_three_iterations(workshop, name):
    # On a plateau the baselines stay where they are; that is the point. Of a gradient that is zero
    # there is no noise.
    least = 1e-4 if name in ("plateau", "drawn", "loss") else -1
    still = name in ("renderer", "mitsuba")
    loop, _ = iterated(workshop, [*GRADIENTS[name], *SMALL], least, still)
    assert loop.position.iteration == ITERATIONS and loop.warnings == []


@pytest.mark.parametrize("workshop", ["occlusion"], indirect=True)
@pytest.mark.parametrize("spp, share", ((1, 1.0), (2, 0.1)))
def test_a_path_that_is_not_a_number_costs_its_pixel(monkeypatch, workshop, spp, share):
    """It is left out and counted; all steps are taken."""
    whole = Unrolled.primal

    def broken(integrator, scene, sampler, ray):
        radiance, state = whole(integrator, scene, sampler, ray)
        first = dr.arange(mi.UInt32, dr.width(ray.o)) == 0
        return dr.select(first & (sampler.next_1d() < share), np.nan, radiance), state

    settings = [*SMALL, "budget.iterations=40", f"sampler.spp={spp}"]
    workshop = Workshop(workshop.problem)  # its kernels are recorded with what is broken
    loop = workshop.loop(*configured("scene=occlusion", "sampler=plateau", *settings))
    monkeypatch.setattr(Unrolled, "primal", broken)
    values, bad = [], []

    def watched(loop, progress):
        values.append(float(loop.stepper.values["red.depth"][0]))
        bad.append(sum(loop.stepper.lost.values()))

    assert loop.run(Hooks(stepped=watched)) == "done"
    print(loop.lost_in_steps, "pixels left out of", len(bad), "steps")
    assert not any(bad) and 0 < loop.lost_in_steps
    assert np.all(np.diff(values) != 0)
