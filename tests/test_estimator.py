"""The loss gradient: against finite differences, and the same for every sampler."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from montecarlo import welch
from scenes_for_tests import ROUGHNESS, TEXTURE, problem

from isas_cli import losses, streams
from isas_cli.estimators.two_path import TwoPath
from isas_cli.pixels import PixelDistribution
from isas_cli.render import Renderer
from isas_cli.samplers.balanced import Balanced
from isas_cli.samplers.base import Stage1Settings
from isas_cli.samplers.gradient import Gradient
from isas_cli.samplers.ours import Ours
from isas_cli.samplers.relevant import Relevant
from isas_cli.samplers.uniform import Uniform
from isas_cli.unknowns import flat

UNKNOWNS = {TEXTURE: 0.5, ROUGHNESS: 0.5}
REPEATS = 128
BATCH = 512
STAGE1 = Stage1Settings(resolution=4, spp=4, denoise="none")
SAMPLERS = {
    "uniform": Uniform(),
    "relevant": Relevant(stage1=STAGE1),
    # Per pixel: the targets differ from pixel to pixel, and coarser cells would even that out.
    "gradient": Gradient(stage1=Stage1Settings(resolution=12, spp=8, denoise="none")),
    "ours": Ours(stage1=STAGE1),
    "ours denoised": Ours(stage1=Stage1Settings(resolution=4, spp=4)),
    "balanced": Balanced(stage1=STAGE1),
}


def estimates(p, loss, sampler, estimator=None, repeats=REPEATS, base=1) -> np.ndarray:
    """``repeats`` independent gradient estimates at the start values, ``(repeats, m)``.

    The distribution is looked up afresh for each, as in a run."""
    sampler.prepare(p, loss, BATCH)
    estimator = estimator or TwoPath(p, loss, BATCH)
    starts, rows = p.unknowns.starts(), []
    for i in range(repeats):
        distribution = sampler.distribution(sampler.look(starts, base, 10 * i))
        p.unknowns.attach(starts)
        estimator.accumulate(distribution, base, 10 * i)
        gradients = p.unknowns.gradients()
        rows.append(np.concatenate([np.array(flat(gradients[k])) for k in p.unknowns.keys]))
    p.unknowns.write(starts)  # detach: other tests' scenes live in the same process
    return np.array(rows, np.float64)


def loss_by_halves(renderer: Renderer, values, spp: int) -> float:
    """Unbiased L2 with common random numbers: two independent halves, so that the noise of the
    images does not add to it."""
    p = renderer.problem
    p.unknowns.write(values)
    copies = 64  # of every pixel in one wavefront
    pixel = dr.tile(dr.arange(mi.UInt32, p.views.total), copies)
    target = np.array(p.targets, np.float64).reshape(-1, 3).T
    a, b = (
        np.array(renderer.pixels(pixel, spp // copies, lambda s, h=h: 10_000 * h + s), np.float64)
        .reshape(3, copies, -1)
        .mean(axis=1)
        for h in (1, 2)
    )
    return float(((a - target) * (b - target)).mean())


@pytest.mark.parametrize("step", [0.02, 0.05])
def test_gradient_matches_central_differences(step):
    """Along one direction per unknown, and single texels, with common seeds and two step sizes."""
    p = problem(UNKNOWNS, resolution=(12, 8), size=2)
    rows = estimates(p, losses.L2(), Uniform(), repeats=256)
    mean, error = rows.mean(axis=0), rows.std(axis=0, ddof=1) / np.sqrt(len(rows))
    starts = {u.key: u.start for u in p.unknowns}
    renderer = Renderer(p)
    texels = starts[TEXTURE].size

    directions = {
        "all texels": (TEXTURE, np.ones(starts[TEXTURE].shape, np.float32), slice(0, texels))
    }
    for index in (0, 4, 8):
        one = np.zeros(texels, np.float32)
        one[index] = 1
        directions[f"texel {index}"] = (
            TEXTURE,
            one.reshape(starts[TEXTURE].shape),
            slice(index, index + 1),
        )
    directions["roughness"] = (ROUGHNESS, np.ones(1, np.float32), slice(texels, texels + 1))

    for name, (key, direction, entries) in directions.items():
        ends = []
        for sign in (-1, 1):
            moved = starts | {key: starts[key] + sign * step * direction}
            ends.append(loss_by_halves(renderer, p.unknowns.values_of(moved), 4096))
        difference = (ends[1] - ends[0]) / (2 * step)
        got = mean[entries].sum()
        noise = (
            np.sqrt((error[entries] ** 2).sum())
            if entries.stop - entries.start == 1
            else (rows[:, entries].sum(axis=1).std(ddof=1) / np.sqrt(len(rows)))
        )
        # 2 %: curvature of the loss over the step, and the noise of the differences themselves.
        assert abs(got - difference) < 4 * noise + 0.02 * abs(difference), (
            f"{name}: estimate {got:.5g} ± {noise:.2g}, differences {difference:.5g}"
        )


@pytest.fixture(scope="module")
def reference():
    p = problem(UNKNOWNS)
    return {
        name: estimates(p, loss, Uniform(), base=99)
        for name, loss in (("l2", losses.L2()), ("relative_l2", losses.RelativeL2()))
    }


@pytest.mark.parametrize("loss_name", ["l2", "relative_l2"])
@pytest.mark.parametrize("name", SAMPLERS)
def test_every_sampler_estimates_the_same_gradient(name, loss_name, reference):
    loss = {"l2": losses.L2(), "relative_l2": losses.RelativeL2()}[loss_name]
    rows = estimates(problem(UNKNOWNS), loss, SAMPLERS[name])
    outcome = welch(rows, reference[loss_name])
    print(outcome)
    assert np.all(np.isfinite(rows))
    assert outcome.p_value > 0.001, str(outcome)


class WithoutWeights(TwoPath):
    """Broken on purpose: pretends that every pixel was drawn uniformly."""

    def accumulate(self, distribution, base, iteration):
        uniform = self.problem.views.total
        honest = PixelDistribution._probability
        PixelDistribution._probability = lambda d, mass, pixels: dr.full(
            mi.Float, 1 / uniform, dr.width(mass)
        )
        try:
            super().accumulate(distribution, base, iteration)
        finally:
            PixelDistribution._probability = honest


# Not `relevant`: nearly every pixel of this scene sees an unknown, so its pmf is uniform here.
@pytest.mark.parametrize("name", ["gradient", "ours", "balanced"])
def test_the_test_notices_missing_weights(name, reference):
    p = problem(UNKNOWNS)
    broken = WithoutWeights(p, losses.L2(), BATCH)
    rows = estimates(p, losses.L2(), SAMPLERS[name], broken, repeats=512)
    outcome = welch(rows, reference["l2"])
    print(outcome)
    assert outcome.p_value < 0.001


class OnePath(TwoPath):
    """Broken on purpose: one path for residual and derivative."""

    def accumulate(self, distribution, base, iteration):
        honest = streams.seed
        streams.seed = lambda b, i, purpose: honest(b, i, purpose.replace("adjoint", "primal"))
        try:
            super().accumulate(distribution, base, iteration)
        finally:
            streams.seed = honest


def test_the_test_notices_a_reused_seed(reference):
    p = problem(UNKNOWNS)
    rows = estimates(p, losses.L2(), Uniform(), OnePath(p, losses.L2(), BATCH))
    outcome = welch(rows, reference["l2"])
    print(outcome)
    assert outcome.p_value < 0.001


def test_freezing_changes_nothing():
    p = problem(UNKNOWNS)
    loss = losses.L2()
    frozen = estimates(p, loss, Uniform(), TwoPath(p, loss, BATCH, freeze=True), repeats=6)
    traced = estimates(p, loss, Uniform(), TwoPath(p, loss, BATCH, freeze=False), repeats=6)
    assert np.abs(frozen - traced).max() <= 1e-6 * np.abs(traced).max()


def test_masked_pixels_do_not_count():
    p = problem({ROUGHNESS: 0.5})
    whole = estimates(p, losses.L2(), Uniform(), repeats=2)
    p.set_targets(p.targets, dr.full(mi.Float, 0.5, p.views.total), "test")
    half = estimates(p, losses.L2(), Uniform(), repeats=2)
    # A constant weight is normalised away: ℒ is a weighted mean.
    assert np.allclose(whole, half, rtol=1e-5)
    mask = np.zeros(p.views.total, np.float32)
    mask[0] = 1
    p.set_targets(p.targets, mi.Float(mask), "test")
    # The corner sees the sky only.
    assert np.all(estimates(p, losses.L2(), Uniform(), repeats=2) == 0)
