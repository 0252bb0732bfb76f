"""Stage 1: second moments against brute force, and what the samplers make of them."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from brute_force import PerPath, cell_means
from scenes_for_tests import ROUGHNESS, TEXTURE, problem

from isas_cli import losses
from isas_cli.samplers.balanced import Balanced
from isas_cli.samplers.gradient import Gradient
from isas_cli.samplers.relevant import Relevant
from isas_cli.samplers.sampler import Stage1Settings
from isas_cli.samplers.stage1.cell_moments import Stage1, random_signs
from isas_cli.samplers.stage1.cells import Cells
from isas_cli.samplers.stage1.denoise import Denoiser


def test_signs_are_random_and_those_of_two_unknowns_independent():
    signs = random_signs(dict.fromkeys("ab", dr.zeros(mi.Float, 4096)), 3)
    a, b = (np.array(each) for each in signs.values())
    assert set(a) == set(b) == {-1.0, 1.0}
    assert np.abs([a.mean(), b.mean(), (a * b).mean(), (a[1:] * a[:-1]).mean()]).max() < 4 / 64


def test_the_sum_is_squared_after_it_is_taken():
    """A single unknown that a path may meet more than once: the moment of its whole derivative."""
    p = problem({ROUGHNESS: 0.5})
    cells = Cells.over(p.film_sizes, 4)
    derivative = PerPath(p, losses.L2(), cells, 8).derivatives(1, 0)[0]
    exact = (derivative**2).reshape(3, cells.count, 8).mean(axis=2)
    stage1 = Stage1(p, losses.L2(), cells, 8)
    starts = p.unknowns.starts()
    _, second = stage1.derivative(starts, random_signs(starts, 5), 1, 0)
    p.unknowns.write(starts)
    assert np.allclose(np.array(second), exact, rtol=1e-3, atol=1e-6 * exact.max())


def test_residual_moment_counts_the_noise_of_the_paths():
    """p_j1 is E[⟨∂ℓ⟩²] of single paths: at the truth, where the mean vanishes, noise is left."""
    p = problem({ROUGHNESS: 0.4}, constant_target=None)
    stage1 = Stage1(p, losses.L2(), Cells.over(p.film_sizes, 4), 64)
    _, second = stage1.residual(p.unknowns.truths(), 1, 0)
    assert float(dr.max(dr.max(second))[0]) > 1e-4


def test_gradient_looks_at_sizes_of_residuals_and_not_at_their_squares():
    p = problem({ROUGHNESS: 0.5})
    settings = Stage1Settings(resolution=4, spp=4, denoise="none")
    sampler, starts = Gradient(stage1=settings).on(p, losses.L2(), 512), p.unknowns.starts()
    (found,) = (np.array(each) for each in sampler.measured(starts, 3, 7))
    single = PerPath(p, losses.L2(), sampler.cells, 4).residuals(3, 7)
    size, square = (cell_means(each, 4) for each in (np.abs(single), single**2))
    p.unknowns.write(starts)
    assert np.allclose(found, size, rtol=1e-3)
    assert not np.allclose(found, square, rtol=0.1)


def test_relevant_leaves_out_the_sky_only():
    p = problem({ROUGHNESS: 0.5}, resolution=(32, 32), depth=2)
    sampler = Relevant(stage1=Stage1Settings(resolution=32, spp=4, denoise="none"))
    sampler = sampler.on(p, losses.L2(), 512)
    weights = np.array(sampler.look(p.unknowns.starts(), 1, 0)).reshape(2, 32, 32)
    p.unknowns.write(p.unknowns.starts())
    assert set(np.unique(weights)) == {0.0, 1.0}
    assert weights[0, 14, 16] == 1  # the wall, in the middle of the first view
    assert weights[0, 0, 0] == 0 and weights[0, 31, 16] == 0  # sky; floor before the wall


def test_balanced_matches_brute_force():
    """p_j ∝ Σ_k J_jk / c_k with power 1, against derivatives taken one unknown at a time on other
    paths; and the texels, which differ in how many pixels see them, get mass alike."""
    p = problem({TEXTURE: 0.5}, size=4, resolution=(48, 32), depth=2)
    settings = Stage1Settings(resolution=48, spp=32, denoise="none")
    sampler = Balanced(floor=0.0, power=1.0, passes=4, least=1e-3, stage1=settings)
    sampler = sampler.on(p, losses.L2(), 512)
    starts = p.unknowns.starts()
    weights = np.array(sampler.look(starts, 1, 0), np.float64)
    exact = np.abs(PerPath(p, losses.L2(), sampler.cells, 32).derivatives(9, 0)).sum(axis=1)
    p.unknowns.write(starts)
    j = exact.reshape(len(exact), sampler.cells.count, 32).mean(axis=2)
    total = j.sum(axis=1)
    assert total.max() / total.min() > 2, "the case is not hard enough to show anything"
    wanted = (j / total[:, None]).sum(axis=0)
    difference = np.abs(weights / weights.sum() - wanted / wanted.sum()).sum() / 2
    uniform = np.abs(1 / weights.size - wanted / wanted.sum()).sum() / 2
    assert difference < 0.1 < uniform


def test_balanced_sees_what_lights_that_start_dark_will_light():
    settings, found = Stage1Settings(resolution=8, spp=16, denoise="none"), []
    for start in (0.0, 1.0):
        lamps = dict.fromkeys(("sky.radiance.value", "lamp.emitter.radiance.value"), start)
        p = problem({TEXTURE: 0.5} | lamps)
        sampler = Balanced(stage1=settings).on(p, losses.L2(), 512)
        found.append(np.array(sampler.look(p.unknowns.starts(), 1, 0)))
        p.unknowns.write(p.unknowns.starts())
    dark, lit = found
    assert dark.any() and np.allclose(dark, lit, rtol=1e-3)


@pytest.mark.parametrize("quality", ["fast", "balanced", "high"])
def test_denoising_keeps_energy_and_sign(quality, rng):
    cells = Cells.over([(64, 64), (64, 32), (20, 64)], 32)
    smooth = np.linspace(0.5, 2, cells.count)
    noisy = (smooth * rng.exponential(1, (3, cells.count))).astype(np.float32)
    noisy[0, 3] = np.nan
    clean = np.array(Denoiser(cells, quality)(mi.Color3f(noisy)))
    assert np.all(np.isfinite(clean)) and np.all(clean >= 0)
    assert abs(clean.mean() / np.nanmean(noisy) - 1) < 0.25
    assert clean.std() < 0.7 * np.nanstd(noisy)


def test_denoising_does_not_depend_on_scale(rng):
    cells = Cells.over([(64, 64)], 64)
    image = rng.uniform(0.5, 2, (3, cells.count)).astype(np.float32)
    denoise = Denoiser(cells, "fast")
    plain = np.array(denoise(mi.Color3f(image)))
    tiny = np.array(denoise(mi.Color3f(image * np.float32(1e-12))))
    assert np.allclose(tiny * 1e12, plain, rtol=1e-3)
