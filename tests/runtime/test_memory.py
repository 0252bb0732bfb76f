"""What is computed part by part, so that films of many millions of pixels fit, is what it was."""

import mitsuba as mi
import numpy as np
import pytest
from scenes_for_tests import ROUGHNESS, TEXTURE, problem

from isas_cli.config.schema import OptimizerConfig
from isas_cli.engine.optimiser import Stepper
from isas_cli.rendering.stratified import Sums
from isas_cli.runtime import images, memory
from isas_cli.unknowns.parameters import flat, unflat


@pytest.fixture(params=[7, 1 << 20], ids=["small parts", "one part"])
def size(request, monkeypatch):
    monkeypatch.setattr(memory, "_PART", request.param)


@pytest.mark.parametrize("count", [0, 1, 6, 7, 8, 700])
def test_parts_are_all_entries_once(count, monkeypatch):
    monkeypatch.setattr(memory, "_PART", 7)
    found = [np.arange(count)[part] for part in memory.parts(count)]
    assert all(0 < each.size <= 7 for each in found)
    assert np.array_equal(np.concatenate([np.zeros(0), *found]), np.arange(count))


def test_pictures_for_display(size, rng):
    image = rng.uniform(-0.2, 1.4, (9, 5, 3)).astype(np.float32)
    image[0, 0] = np.nan, np.inf, -np.inf
    with np.errstate(invalid="ignore"):
        x = np.clip(np.nan_to_num(image * 0.7, nan=0.0, posinf=1.0, neginf=0.0), 0, 1)
    want = np.rint(255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055))
    shown = images.to_display(image, 0.7)
    assert shown.dtype == np.uint8 and shown.shape == image.shape
    # In single precision a value may lie on the other side of a half.
    assert np.abs(shown.astype(int) - want).max() <= 1 and np.mean(shown != want) < 0.02
    assert images.to_display(np.float32(0.5)).shape == ()
    assert np.array_equal(images.to_display(image[:, ::-2], 0.7), shown[:, ::-2]), "any strides"


def test_means_and_variances_of_targets(size, rng):
    means = rng.uniform(0, 2, (30, 4, 3))  # of four sequences a pixel
    counts = np.full(30, 4, np.int32)
    counts[3:5] = 0, 1
    used = np.arange(4) < counts[:, None]
    first = (means * used[..., None]).sum(1)
    sums = Sums(first, ((means**2).sum(-1) * used).sum(1), counts, counts)
    several = counts > 1
    assert sums.images[several] == pytest.approx(means[several].mean(1))
    assert np.all(sums.images[3] == 0) and sums.images[4] == pytest.approx(means[4, 0])
    assert sums.variance[several] == pytest.approx(means[several].var(1, ddof=1).mean(-1) / 4)
    assert np.all(np.isnan(sums.variance[~several]))
    large = np.full(30, 100_000, np.int32)  # whose squares no 32 bits hold
    assert Sums(first, first.sum(1) + 1e9, large, large).variance == pytest.approx(
        1e9 / 3e10, rel=1e-4
    )


def test_scales_and_noise_of_gradients(size, rng):
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.5})
    settings, starts = OptimizerConfig(schedule="constant"), p.unknowns.starts().items()
    stepper = Stepper(p.unknowns, settings)
    first, second = (
        {k: unflat(v, mi.Float(rng.normal(size=len(flat(v))))) for k, v in starts} for _ in range(2)
    )
    stepper.calibrate([first, second])
    for key, scale in stepper.scale.items():
        both = np.concatenate([np.array(each[key]).ravel() for each in (first, second)])
        assert scale == pytest.approx(1 / np.sqrt(np.mean(both.astype(np.float64) ** 2)))
    for each in (first, second):
        stepper.step(each, 0.0)
    β, total, count = settings.beta_1, 0.0, 0
    for key in first:
        g, h = (np.array(each[key], np.float64).ravel() for each in (first, second))
        smoothed = (β * (1 - β) * g + (1 - β) * h) / (1 - β**2)
        total, count = total + np.sum((smoothed - h) ** 2), count + h.size
    assert stepper.noise(second) == pytest.approx(total / count, rel=1e-4)
