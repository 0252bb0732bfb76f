"""What each loss claims of gradients from single samples, against closed forms and brute force."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from crosses import some
from gradient_estimates import Gradients, configured, moved, radiances
from hard_scenes import assemble, hard_problem
from montecarlo import welch, z_against
from samplers_for_tests import pixel_samplers

from isas_cli import losses
from isas_cli.config.compose import options
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime import streams
from isas_cli.scene.problem import Problem

LEVEL = 1e-4
SKY = "sky.radiance.value"
# Reflectances within each pixel, equally likely: median 0.1, mean 0.25.
VALUES = np.array([0, 2, 2, 4, 4, 6, 8, 9, 11, 12, 14, 20, 40, 60, 88, 120]) / 100
MEAN = VALUES.mean()
RADIANCE = 10.0  # radiance of the sky
TARGET = 1.7  # between the median and the mean of what is seen then, and on no value of it
BELOW = (VALUES * RADIANCE < TARGET).mean()


def panel_scene() -> dict:
    """A mirror that fills the view and reflects a sky of radiance s: L = R(texel) s, ∂L/∂s = R.

    Each pixel of the first view sees 16 texels, which hold VALUES in an order of its own. The
    second view has a pixel per texel: what it shows is free of noise.
    """
    rng = np.random.default_rng(4)
    blocks = np.array([[rng.permutation(VALUES).reshape(4, 4) for _ in range(4)] for _ in range(3)])
    texels = np.repeat(blocks.swapaxes(1, 2).reshape(12, 16, 1), 3, axis=2)

    def camera(width, height):
        return {
            "type": "perspective",
            "fov": 90,
            "fov_axis": "x",
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb"},
        }

    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sky": {"type": "constant", "radiance": RADIANCE},
        "panel": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().scale([1, 0.75, 1]),
            "bsdf": {
                "type": "conductor",
                "material": "none",
                "specular_reflectance": {
                    "type": "bitmap",
                    "data": mi.TensorXf(texels.astype(np.float32)),
                    "filter_type": "nearest",
                    "raw": True,
                },
            },
        },
        "sensor_000": camera(4, 3),
        "sensor_001": camera(16, 12),
    }


@pytest.fixture(scope="module")
def panel() -> Problem:
    """The scene as a problem; its second view, which only shows what the first is made of, has no
    weight."""
    p = assemble(panel_scene(), {SKY: RADIANCE})
    shown = Renderer(p).view(1, 1, lambda i: 1)[..., 0] / RADIANCE
    blocks = shown.reshape(3, 4, 4, 4).swapaxes(1, 2).reshape(12, 16)
    assert np.allclose(np.sort(blocks), VALUES, atol=1e-5)
    return p


class Slope:
    """∂ℒ/∂s of the panel where every pixel of the first view has the same target."""

    def __init__(self, panel: Problem, loss):
        weights = np.repeat([1.0, 0.0], [w * h for w, h in panel.film_sizes]).astype(np.float32)
        whole = mi.Float(np.full(3 * weights.size, TARGET, np.float32))
        panel.set_targets(whole, mi.Float(weights), "test")
        self.gradients = Gradients(panel, loss, 8192)

    def __call__(self, s: float, seed: int, sampler=None, repeats: int = 64) -> np.ndarray:
        """Estimates at the sky's radiance s, all its channels together, ``(repeats, 1)``."""
        made = self.gradients
        made.values = made.problem.unknowns.values_of({SKY: np.full(3, s, np.float32)})
        if sampler is None:
            rows = made.uniform(repeats, seed)
        else:
            rows = made.sampled(made.prepared(sampler), repeats, seed)
        return rows.sum(axis=1, keepdims=True)


@pytest.mark.parametrize("name", some(pixel_samplers(), ("uniform", "ours", "progress")))
def test_l1_is_the_gradient_of_fixed_noise_moved_by_its_mean(panel, name, seed):
    """E|μ(s) + n - T| with n = ⟨I⟩ - μ as it is at s: (1 - 2 P(⟨I⟩ < T)) dμ/ds, for any pmf."""
    rows = Slope(panel, losses.L1())(RADIANCE, seed, configured("sampler", name))
    ends = [np.abs(VALUES * RADIANCE + h * MEAN - TARGET).mean() for h in (-1e-3, 1e-3)]
    exact = (ends[1] - ends[0]) / 2e-3
    assert exact == pytest.approx((1 - 2 * BELOW) * MEAN)
    p_value = z_against(rows, np.array([exact]))
    print(f"{rows.mean():.4g} ± {1.96 * rows.std() / 8:.2g}, exact {exact:.4g}, p {p_value:.3g}")
    assert p_value > LEVEL


def test_l1_is_neither_the_gradient_at_the_mean_nor_of_the_noise_itself(panel, seed):
    """Of |E⟨I⟩ - T|, which has the other sign, and of E|⟨I⟩ - T| where the noise grows with s."""
    rows = Slope(panel, losses.L1())(RADIANCE, seed)
    at_the_mean = np.sign(MEAN * RADIANCE - TARGET) * MEAN
    of_the_noise = (np.sign(VALUES * RADIANCE - TARGET) * VALUES).mean()
    for other in (at_the_mean, of_the_noise):
        assert z_against(rows, np.array([other])) < LEVEL
        assert np.sign(rows.mean()) != np.sign(other)


def test_l1_comes_to_rest_where_the_target_is_the_median(panel, seed):
    """The sign of its gradient changes where the median of ⟨I⟩ = R s passes the target, while
    that of L2 changes where the mean does. Of the noise fixed at the median, moved by its mean,
    no place is better than where it stands."""
    median, mean = TARGET / np.median(VALUES), TARGET / MEAN
    for loss, rest, elsewhere in ((losses.L1(), median, mean), (losses.L2(), mean, median)):
        slope = Slope(panel, loss)
        for factor, sign in ((0.85, -1), (1.15, 1)):
            rows = slope(factor * rest, seed)
            assert np.sign(rows.mean()) == sign and z_against(rows, np.zeros(1)) < LEVEL
        assert z_against(slope(elsewhere, seed), np.zeros(1)) < LEVEL
    shifts = np.linspace(-1, 1, 201)
    brute = np.abs(VALUES * median + shifts[:, None] * MEAN - TARGET).mean(axis=1)
    assert brute[100] == pytest.approx(brute.min())


@dataclass(frozen=True)
class RenderingBelow(losses.RelativeL2):
    """What relative L2 often is: the rendering in the denominator, held fixed there."""

    def derivative(self, image, target):
        return 2 * (image - target) / (dr.square(image) + self.epsilon)


def test_relative_l2_is_unbiased_with_the_target_below_and_not_with_the_rendering(panel, seed):
    mean, weight = MEAN * RADIANCE, TARGET**2 + losses.RelativeL2().epsilon
    exact = np.array([2 * (mean - TARGET) / weight * MEAN])
    rows = Slope(panel, losses.RelativeL2())(RADIANCE, seed, repeats=256)
    assert z_against(rows, exact) > LEVEL
    # A bias of 5.5 standard errors is noticed in 95 % of such tests.
    assert 5.5 * rows.std() / 16 < 0.2 * abs(exact[0])
    loss = RenderingBelow()
    rows = Slope(panel, loss)(RADIANCE, seed)
    exact = np.array([2 * (mean - TARGET) / (mean**2 + loss.epsilon) * MEAN])
    assert z_against(rows, exact) < LEVEL


@pytest.mark.parametrize("name", options("loss"))
def test_losses_claim_what_they_keep(panel, name, seed):
    """``linear`` says whether single samples give the gradient at the mean."""
    loss = configured("loss", name)
    rows = Slope(panel, loss)(RADIANCE, seed)
    lanes = loss.windows.count if loss.windows else 1
    alike = (mi.Color3f(dr.full(mi.Float, x, lanes)) for x in (MEAN * RADIANCE, TARGET))
    at_the_mean = np.array(loss.derivative(*alike))[0].sum(keepdims=True)
    assert (z_against(rows, at_the_mean * MEAN) > LEVEL) == loss.linear


def test_l1_on_a_scene_against_brute_force(seed):
    """Glass, noise of real light paths of up to five edges: four lead through the glass to the core
    and out again to the light. Mean radiances move along a direction of all unknowns at once, by
    central differences with common random numbers; single paths are taken as they are."""
    p = hard_problem("glass", depth=5)
    p.set_targets(p.targets * 0.25 * 1.3, None, "test")  # somewhat above the mean radiances
    renderer, target = Renderer(p), np.array(p.targets, np.float64).reshape(-1, 3).T
    directions = {u.key: np.ones(u.start.shape, np.float32) for u in p.unknowns}
    exact, at_the_mean = [], []
    for i in range(64):
        lower, upper = (
            radiances(renderer, moved(p, directions, h), 64, streams.seed(seed, 2 * i, "snapshot"))
            for h in (-0.05, 0.05)
        )
        slope = (upper - lower).mean(axis=1) / 0.1
        paths = radiances(
            renderer, p.unknowns.starts(), 64, streams.seed(seed, 2 * i + 1, "snapshot")
        )
        ends = [np.abs(paths + (h * slope - target)[:, None]).mean() for h in (-1e-4, 1e-4)]
        exact.append((ends[1] - ends[0]) / 2e-4)
        at_the_mean.append((np.sign(paths.mean(axis=1) - target) * slope).mean())
    rows = Gradients(p, losses.L1(), 4096).uniform(64, seed).sum(axis=1, keepdims=True)
    outcome = welch(rows, np.array(exact)[:, None], LEVEL)
    print(outcome, rows.mean(), np.mean(exact), np.mean(at_the_mean))
    assert outcome.p_value > LEVEL
    assert outcome.always_visible < 0.05 * abs(rows.mean())
    assert welch(rows, np.array(at_the_mean)[:, None], LEVEL).p_value < LEVEL
