"""Unbiasedness: every sampler with every loss that claims it, on scenes that make it hard.

Estimates are compared in shares of the norm of each unknown's gradient. LEVEL holds per test, so
that of all tests here together less than one in a hundred would fail by chance.
"""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from crosses import crossed, some
from gradient_estimates import (
    Gradients,
    WithoutWeights,
    configured,
    difference_quotients,
    looking,
    unbiased_losses,
)
from hard_scenes import SCENES, hard_problem
from montecarlo import welch
from samplers_for_tests import pixel_samplers
from scenes_for_tests import without_targets
from weights import as_mitsuba

from isas_cli.rendering import rays
from isas_cli.rendering.integrators import Integrator, Unrolled
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.runtime import streams
from isas_cli.unknowns.parameters import flat

LEVEL = 1e-4
BATCH = 4096
REPEATS = 120
LOSSES = unbiased_losses()
# The smallest bias of any component that must be visible, as a share of the norm of its unknown's
# gradient. Those of texels and lights show from about 0.01 on, those of roughnesses from 0.1.
VISIBLE = 0.1
# Whether a mistake is noticed does not hang on the scene; of all scenes the reference is dear.
ONE_SCENE = pytest.mark.parametrize("bench", some([*SCENES], ("mirror",)), indirect=True)


class Bench:
    """One scene, its uniform reference per loss, and what all its tests share."""

    def __init__(self, name: str):
        self.name, self.problem = name, hard_problem(name)
        self.losses = {loss: configured("loss", loss) for loss in LOSSES}
        self._gradients: dict[str, Gradients] = {}
        self._references: dict[str, np.ndarray] = {}

    def gradients(self, loss: str) -> Gradients:
        if loss not in self._gradients:
            made = Gradients(self.problem, self.losses[loss], BATCH)
            self._references[loss] = made.uniform(3 * REPEATS, 99)
            self._gradients[loss] = made
        return self._gradients[loss]

    def against_uniform(self, loss: str, rows: np.ndarray):
        """Welch's test of ``rows`` against the reference, printed."""
        made = self.gradients(loss)
        reference = self._references[loss]
        outcome = welch(
            made.components(rows, reference), made.components(reference, reference), LEVEL
        )
        print(self.name, loss, outcome)
        return outcome

    def reference(self, loss: str) -> np.ndarray:
        self.gradients(loss)
        return self._references[loss]


@pytest.fixture(scope="module", params=SCENES)
def bench(request):
    return Bench(request.param)


# One loss with two samplers, the other one with the next two, so that the two of a scene share a
# reference: what a sampler could do wrong, it does with all.
COMBINED = [
    (name, LOSSES[(number // 2 + other) % len(LOSSES)])
    for other in range(len(LOSSES))
    for number, name in enumerate(pixel_samplers())
]


@pytest.mark.parametrize("bench, chosen", crossed([*SCENES], COMBINED, 2), indirect=["bench"])
def test_every_sampler_is_unbiased(bench, chosen, seed):
    name, loss = chosen
    made = bench.gradients(loss)
    rows = made.sampled(made.prepared(looking(name)), REPEATS, seed)
    assert np.all(np.isfinite(rows))
    outcome = bench.against_uniform(loss, rows)
    assert outcome.p_value > LEVEL, str(outcome)
    assert outcome.always_visible < VISIBLE, str(outcome)


@ONE_SCENE
def test_reference_is_the_derivative_of_the_loss(bench, seed):
    """Uniform sampling against central differences, every unknown along a direction of its own,
    two step sizes, extrapolated to none: (4 D(h/2) - D(h)) / 3 is off by h⁴ only."""
    rng = np.random.default_rng(seed)
    for unknown in bench.problem.unknowns:
        direction = rng.uniform(0.5, 1.5, unknown.start.shape).astype(np.float32)
        quotients = difference_quotients(
            bench.problem, list(bench.losses.values()), {unknown.key: direction}, 0.15, 40
        )
        for (loss, made), (whole, half) in zip(
            ((l, bench.gradients(l)) for l in LOSSES), quotients
        ):
            entries = made.entries()[unknown.key]
            slopes = bench.reference(loss)[:, entries] @ direction.ravel()
            norm = np.linalg.norm(bench.reference(loss)[:, entries].mean(axis=0))
            norm *= np.linalg.norm(direction)
            outcome = welch(((4 * half - whole) / 3 / norm)[:, None], slopes[:, None] / norm, LEVEL)
            print(bench.name, unknown.key, loss, outcome)
            assert outcome.p_value > LEVEL, str(outcome)
            assert outcome.always_visible < VISIBLE, str(outcome)
            assert abs(whole.mean() - half.mean()) < 0.1 * norm, "steps too long to extrapolate"


@pytest.mark.parametrize("scene", some([*SCENES], ("mirror", "glass")))
def test_short_paths_differentiate_like_replayed_ones(scene, monkeypatch):
    """Both ways to differentiate the same paths of at most seven edges, through glass, mirrors and
    all, some of which end by roulette."""
    as_mitsuba(monkeypatch)
    p = without_targets(SCENES[scene].build(7), SCENES[scene].unknowns)
    assert isinstance(p.integrator, Unrolled)
    starts, found = p.unknowns.starts(), []
    weights = mi.Color3f(np.random.default_rng(1).normal(size=(3, 16 * p.views.total)))
    for both_ways in (True, False):
        integrator = p.integrator if both_ways else Integrator(p.integrator.mitsuba)
        p.unknowns.attach(starts)
        with dr.suspend_grad():
            pixel = dr.tile(dr.arange(mi.UInt32, p.views.total), 16)
            stream = rays.stream(mi.UInt32(5), dr.width(pixel))
            ray, _ = rays.spawn(p.sensors, p.views, *p.views.locate(pixel), stream)
            integrator.backward(p.scene, stream, ray, weights)
        found.append([np.array(flat(g), np.float64) for g in p.unknowns.gradients().values()])
        p.unknowns.write(starts)
    for unrolled, replayed in zip(*found):
        assert np.any(replayed != 0)
        assert np.allclose(unrolled, replayed, rtol=1e-3, atol=1e-4 * np.abs(replayed).max())


@ONE_SCENE
def test_missing_weights_are_noticed(bench, seed):
    made = Gradients(bench.problem, bench.losses["l2"], BATCH, WithoutWeights)
    rows = made.sampled(made.prepared(looking("ours")), REPEATS, seed)
    assert bench.against_uniform("l2", rows).p_value < LEVEL


@ONE_SCENE
def test_one_path_for_both_factors_is_noticed(bench, seed, monkeypatch):
    made, honest = bench.gradients("l2"), streams.seed
    monkeypatch.setattr(
        streams, "seed", lambda b, i, purpose: honest(b, i, purpose.replace("adjoint", "primal"))
    )
    rows = made.uniform(REPEATS, seed)
    assert bench.against_uniform("l2", rows).p_value < LEVEL


@ONE_SCENE
def test_pixels_out_of_reach_are_noticed(bench, seed):
    """Without a floor, and with weights that leave out the left half of every view."""
    views = bench.problem.views
    tiles = Tiles.over(views)
    view, column, _ = views.locate_slot(dr.arange(mi.UInt32, views.total))
    right = column * 2 >= dr.gather(mi.UInt32, views.width, view)
    distribution = PixelDistribution.from_weights(dr.select(right, mi.Float(1), 0), tiles)
    rows = bench.gradients("l2").drawn_from(distribution, REPEATS, seed)
    assert bench.against_uniform("l2", rows).p_value < LEVEL
