"""PSNR, SSIM and FLIP over the pixels that count."""

import numpy as np
import pytest
from PIL import Image

from isas_cli.runtime import images, likeness

RNG = np.random.default_rng(3)
PICTURE = images.srgb_decode(RNG.random((24, 32, 3))).astype(np.float32)
ALL = np.ones((24, 32), np.float32)


def test_a_picture_is_like_itself():
    found = likeness.metrics(PICTURE, PICTURE, ALL)
    assert found["psnr"] == np.inf and found["ssim"] == pytest.approx(1)
    assert found["flip"] is None or found["flip"] == pytest.approx(0, abs=1e-4)


def test_psnr_is_of_what_a_screen_shows():
    """A shift of 0.1 of the encoded values: 20 dB."""
    flat = np.full((24, 32, 3), images.srgb_decode(np.float64(0.5)), np.float32)
    shifted = np.full((24, 32, 3), images.srgb_decode(np.float64(0.6)), np.float32)
    assert likeness.metrics(shifted, flat, ALL)["psnr"] == pytest.approx(20, abs=1e-3)


def test_what_does_not_count_changes_nothing():
    mask = ALL.copy()
    mask[:, :12] = 0
    ruined = PICTURE.copy()
    ruined[:, :12] = 50
    worse = np.clip(PICTURE + 0.1, 0, 1)
    both = worse.copy()
    both[:, :12] = np.nan
    assert likeness.metrics(ruined, PICTURE, mask)["psnr"] == np.inf
    assert likeness.metrics(both, ruined, mask) == likeness.metrics(worse, PICTURE, mask)


def test_what_a_screen_shows_is_in_range():
    assert likeness.in_range(PICTURE) and likeness.in_range(np.ones((4, 4, 3)))
    assert not likeness.in_range(0.04 * PICTURE) and not likeness.in_range(100 * PICTURE)
    assert not likeness.in_range(np.zeros((0, 3)))


def test_ssim_by_hand():
    """One window, summed up without a filter: Wang et al. 2004, Eq. 13."""
    a, b = RNG.random((2, 11, 11))
    weight = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    weight = np.outer(weight, weight) / weight.sum() ** 2
    ma, mb = (weight * a).sum(), (weight * b).sum()
    va, vb = (weight * a * a).sum() - ma**2, (weight * b * b).sum() - mb**2
    vab = (weight * a * b).sum() - ma * mb
    wanted = (2 * ma * mb + 1e-4) * (2 * vab + 9e-4)
    wanted /= (ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4)
    pictures = (images.srgb_decode(np.repeat(x[..., None], 3, axis=2)) for x in (a, b))
    found = likeness.metrics(*pictures, np.ones((11, 11)))["ssim"]
    assert found == pytest.approx(wanted, abs=1e-5)


def test_flip_grows_with_the_difference():
    pytest.importorskip("flip_evaluator")
    noise = RNG.normal(size=PICTURE.shape)
    errors = [
        likeness.metrics(np.clip(PICTURE + s * noise, 0, 1), PICTURE, ALL)["flip"]
        for s in (0.01, 0.05, 0.2)
    ]
    assert 0 < errors[0] < errors[1] < errors[2] < 1


def test_flip_is_that_of_the_files(tmp_path):
    flip = pytest.importorskip("flip_evaluator")
    rng = np.random.default_rng(2)
    shown = [rng.integers(0, 256, (8, 8, 3)).repeat(6, 0).repeat(6, 1) for _ in range(2)]
    for name, picture in zip("ab", shown):
        Image.fromarray(picture.astype(np.uint8)).save(tmp_path / f"{name}.png")
    _, wanted, _ = flip.evaluate(str(tmp_path / "b.png"), str(tmp_path / "a.png"), "LDR")
    pictures = (images.srgb_decode(np.float32(each) / 255) for each in shown)
    found = likeness.metrics(*pictures, np.ones((48, 48)))["flip"]
    assert found == pytest.approx(wanted, rel=1e-3)
