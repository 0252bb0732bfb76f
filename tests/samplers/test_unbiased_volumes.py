"""Unbiasedness on a volume: every sampler against uniform, and what is broken is noticed."""

import numpy as np
import pytest
from crosses import some
from gradient_estimates import Gradients, WithoutWeights, configured, looking
from montecarlo import welch
from samplers_for_tests import pixel_samplers
from scenes_for_tests import render_targets
from volumes_for_tests import problem, uneven

LEVEL, REPEATS, BATCH = 1e-4, 120, 4096
# The smallest bias of an entry that must be visible, as a share of the norm of its grid's gradient.
VISIBLE = 0.1


@pytest.fixture(scope="module")
def bench():
    """At the coarsest level of two: what samplers see of a grid there is what they see later."""
    made = problem(*uneven(), "emission", levels=2)
    render_targets(made, 256)
    gradients = Gradients(made, configured("loss", "l2"), BATCH)
    gradients.values = made.unknowns.starts(made.unknowns.shapes(0))
    return gradients, gradients.uniform(3 * REPEATS, 99)


def against_uniform(gradients: Gradients, reference: np.ndarray, rows: np.ndarray):
    outcome = welch(
        gradients.components(rows, reference), gradients.components(reference, reference), LEVEL
    )
    print(outcome)
    return outcome


@pytest.mark.parametrize("name", some(pixel_samplers(), ("ours", "progress")))
def test_every_sampler_is_unbiased(bench, name, seed):
    gradients, reference = bench
    rows = gradients.sampled(gradients.prepared(looking(name)), REPEATS, seed)
    assert np.all(np.isfinite(rows))
    outcome = against_uniform(gradients, reference, rows)
    assert outcome.p_value > LEVEL, str(outcome)
    assert outcome.always_visible < VISIBLE, str(outcome)


def test_missing_weights_are_noticed(bench, seed):
    gradients, reference = bench
    broken = Gradients(gradients.problem, gradients.loss, BATCH, WithoutWeights)
    broken.values = gradients.values
    rows = broken.sampled(broken.prepared(looking("ours")), REPEATS, seed)
    assert against_uniform(gradients, reference, rows).p_value < LEVEL
