"""The joint sampler: residual times derivative against brute force, from independent paths."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from brute_force import PerPath, cell_means
from montecarlo import welch, z_against
from scenes_for_tests import ROUGHNESS, TEXTURE, UNKNOWNS, problem

from isas_cli import losses
from isas_cli.runtime import streams
from isas_cli.samplers.balanced import Balanced
from isas_cli.samplers.joint import Joint
from isas_cli.samplers.relevant import Relevant
from isas_cli.samplers.sampler import Stage1Settings
from isas_cli.samplers.stage1.cell_moments import random_signs
from isas_cli.samplers.stage1.cells import Cells
from isas_cli.samplers.stage1.product import Product
from isas_cli.unknowns.parameters import flat


def exact(p, loss, cells, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Cell means, on stage 1's own paths, of Σ_k (Σ_c r_c ∂I_c/∂θ_k)², and of it without the
    products of different channels, Σ_k Σ_c (r_c ∂I_c/∂θ_k)²."""
    paths = PerPath(p, loss, cells, samples)
    residual = paths.residuals(1, 0)
    derivative = paths.derivatives(1, 0, "product_adjoint")
    product = residual * derivative
    joint = (product.sum(axis=1) ** 2).sum(axis=0)
    return cell_means(joint, samples), cell_means((product**2).sum(axis=(0, 1)), samples)


@pytest.mark.parametrize(
    "unknowns, shared",
    [({TEXTURE: 0.5}, False), ({ROUGHNESS: 0.5}, True), (UNKNOWNS, True)],
    ids=["texture", "roughness", "both"],
)
@pytest.mark.parametrize(
    "loss",
    [losses.RelativeL2(), pytest.param(losses.L2(), marks=pytest.mark.slow)],
    ids=["relative_l2", "l2"],
)
def test_moment_matches_brute_force(unknowns, shared, loss):
    """Over many probes on the very same paths. Products of channels vanish for a texture, whose
    entries belong to one channel each, and count where all channels share a roughness."""
    p = problem(unknowns, size=2)
    cells, samples, probes = Cells.over(p.film_sizes, 4), 8, 256 if shared else 1024
    wanted, apart = exact(p, loss, cells, samples)
    product = Product(p, loss, cells, samples)
    starts = p.unknowns.starts()
    rows = np.array(
        [
            np.array(product.along(starts, random_signs(starts, 77 + probe), 1, 0), np.float64)
            for probe in range(probes)
        ]
    )
    p.unknowns.write(starts)
    relative = rows.sum(axis=1) / wanted.sum() - 1
    error = relative.std() / np.sqrt(probes)
    print(f"relative error of the sum {relative.mean():.3g} ± {error:.2g}")
    assert abs(relative.mean()) < max(4 * error, 1e-4)
    assert np.corrcoef(rows.mean(axis=0), wanted)[0, 1] > 0.995
    noisy = rows.std(axis=0) > 1e-3 * rows.mean(axis=0).max()
    assert not noisy.any() or z_against(rows[:, noisy], wanted[noisy]) > 1e-4
    difference = np.abs(apart - wanted).sum() / wanted.sum()
    print(f"products of channels: {difference:.3g} of the whole")
    assert difference > 0.3 if shared else difference < 1e-5


class OneStream(Product):
    """Broken on purpose: one path for residual and derivative."""

    def along(self, values, tangents, base, iteration):
        honest = streams.seed
        streams.seed = lambda b, i, purpose: honest(
            b, i, purpose.replace("product_adjoint", "stage1_primal")
        )
        try:
            return super().along(values, tangents, base, iteration)
        finally:
            streams.seed = honest


def test_residual_and_derivative_are_independent_within_a_pixel():
    """E(Σ_c r_c d_c)² = Σ_cc' E[r_c r_c'] E[d_c d_c'] pixel by pixel, the right-hand side from
    residuals and derivatives of repetitions that share nothing."""
    p, loss = problem({ROUGHNESS: 0.5}, resolution=(6, 4)), losses.L2()
    cells, spp, repeats = Cells.over(p.film_sizes, 6), 64, 64
    paths, starts, wanted = PerPath(p, loss, cells, spp), p.unknowns.starts(), []
    for i in range(repeats):
        r, d = paths.residuals(6, i), paths.derivatives(7, i)[0]
        both = [cell_means(x[:, None] * x[None], spp) for x in (r, d)]
        wanted.append((both[0] * both[1]).sum(axis=(0, 1)))
    for kind in (Product, OneStream):
        product = kind(p, loss, cells, spp)
        found = [
            product.second_moment(starts, 1, 5, i).numpy().astype(np.float64)
            for i in range(repeats)
        ]
        outcome = welch(np.array(found), np.array(wanted))
        print(kind.__name__, outcome)
        assert (outcome.p_value > 0.001) == (kind is Product), str(outcome)
    p.unknowns.write(starts)


def test_scaled_signs_weigh_the_unknowns():
    """With ±√w in place of ±1 an unknown counts w times; here the texture not at all."""
    p, loss = problem(UNKNOWNS), losses.L2()
    cells, starts = Cells.over(p.film_sizes, 4), p.unknowns.starts()
    scale = {k: dr.full(mi.Float, 0, dr.width(flat(v))) for k, v in starts.items()}
    scale[ROUGHNESS] = mi.Float(3)
    found = Product(p, loss, cells, 8).second_moment(starts, 1, 1, 0, scale).numpy()
    paths = PerPath(p, loss, cells, 8)
    residual = paths.residuals(1, 0)
    derivative = paths.derivatives(1, 0, "product_adjoint")[-1]
    p.unknowns.write(starts)
    wanted = 9 * cell_means((residual * derivative).sum(axis=0) ** 2, 8)
    assert np.allclose(found, wanted, rtol=1e-3, atol=1e-6 * wanted.max())


def test_a_look_is_the_root_of_the_moment():
    p, loss = problem(UNKNOWNS), losses.L2()
    settings = Stage1Settings(resolution=4, spp=4, probes=3, denoise="none")
    starts, found = p.unknowns.starts(), []
    for freeze in (True, False):
        sampler = Joint(stage1=settings).on(p, loss, 512, freeze)
        found += [np.array(sampler.look(starts, 3, i)) for i in (0, 7, 14)]
    moment = Product(p, loss, sampler.cells, 4).second_moment(starts, 3, 3, 14)
    p.unknowns.write(starts)
    assert np.allclose(found[:3], found[3:], rtol=1e-4, atol=1e-6 * np.max(found))
    assert np.allclose(found[-1] ** 2, moment.numpy(), rtol=1e-4)
    assert sampler.paths_per_look == sampler.cells.count * 4 * 3 * 2


@pytest.mark.parametrize("kind", [Joint, Relevant, Balanced])
def test_masked_pixels_draw_nothing(kind):
    p = problem(UNKNOWNS)
    mask = np.ones(p.views.total, np.float32)
    mask[: p.views.total // 2] = 0  # the first view
    p.set_targets(p.targets, mi.Float(mask), "test")
    sampler = kind(stage1=Stage1Settings(resolution=4, spp=4, denoise="none"))
    sampler = sampler.on(p, losses.L2(), 512)
    weights = np.array(sampler.look(p.unknowns.starts(), 1, 0))
    p.unknowns.write(p.unknowns.starts())
    half = sampler.cells.sizes[0][0] * sampler.cells.sizes[0][1]
    assert np.all(weights[:half] == 0) and weights[half:].sum() > 0
