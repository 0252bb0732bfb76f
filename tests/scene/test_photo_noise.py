"""How noisy photographs are: of white noise on slopes and edges, of pairs, and what is not told;
and where light is cut off in them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isas_cli.config.schema import PhotosConfig
from isas_cli.runtime import images
from isas_cli.scene.photos import clipped, importing, noise
from isas_cli.scene.photos.camera import Camera
from isas_cli.scene.photos.importing import Photograph
from isas_cli.scene.photos.lens import Lens

SIGMA = 0.02


def camera(name: str = "a.png", exposure: float = 1.0, shift: float = 0.0) -> Camera:
    place = np.eye(4)
    place[0, 3] = shift
    size = 160, 120
    numbers = *size, 150.0, 150.0, 80.0, 60.0, place
    return Camera(name, Path(name), *numbers, exposure=(exposure,) * 3)


def scene(seed: int, sigma: float = SIGMA, exposure: float = 1.0) -> np.ndarray:
    """A slope, an edge and a part that is all texture, seen with white noise."""
    clean = np.zeros((120, 160, 3))
    clean += np.linspace(0.2, 0.6, 160)[None, :, None]
    clean[60:, :80] = 0.1
    clean[:40, 100:] = np.random.default_rng(99).uniform(0, 1, (40, 60, 3))
    return clean * exposure + np.random.default_rng(seed).normal(0, sigma, clean.shape)


def photograph(seed: int = 0, exposure: float = 1.0, told: bool = True, **where) -> Photograph:
    image = scene(seed, exposure=exposure).astype(np.float32)
    mask = np.ones(image.shape[:2], np.float32)
    variance = noise.of_one(image, mask) if told else None
    return Photograph(camera(exposure=exposure, **where), image, mask, {}, variance=variance)


@pytest.mark.parametrize("sigma", [0.005, 0.02, 0.05])
def test_white_noise_is_found_beside_slopes_edges_and_texture(sigma):
    found = [noise.of_one(scene(seed, sigma), np.ones((120, 160))) for seed in range(8)]
    print("quotient", np.sqrt(found) / sigma)
    assert np.all(np.abs(np.sqrt(found) / sigma - 1) < 0.15)
    assert np.sqrt(np.mean(found)) == pytest.approx(sigma, rel=0.06)


def test_only_what_counts_is_asked():
    image = scene(0)
    mask = np.zeros((120, 160))
    assert noise.of_one(image, mask) is None
    mask[60:, :80] = 1
    image[:60] = np.random.default_rng(5).normal(0, 1, (60, 160, 3))
    assert np.sqrt(noise.of_one(image, mask)) == pytest.approx(SIGMA, rel=0.15)


def test_two_of_one_camera_tell_it_by_their_difference():
    # Of twice the exposure, whose own noise is half as large for the same radiance.
    first, second = photograph(1), photograph(2, exposure=2.0)
    expected = np.sqrt((SIGMA**2 + (SIGMA / 2) ** 2) / 2)
    second.image[:5] = 0.9  # something that has moved
    assert np.sqrt(noise.of_two(first, second)) == pytest.approx(expected, rel=0.1)
    assert noise.of_two(first, photograph(2, shift=0.1)) is None
    found, how = noise.of_all([first, second, photograph(3, shift=0.1)])
    assert found == pytest.approx(expected, rel=0.1) and how == "from 1 pair of one camera"


def test_one_alone_tells_it_by_its_flat_parts_or_why_not():
    first, second = photograph(1), photograph(2, shift=0.1, told=False)
    found, how = noise.of_all([first, second])
    assert found == pytest.approx(SIGMA, rel=0.1) and how.endswith("of 1 photographs")
    assert noise.of_all([second])[0] is None
    # In units of radiance: of twice the exposure it is half of what the picture has.
    found, _ = noise.of_all([photograph(1, exposure=2.0), second])
    assert found == pytest.approx(SIGMA / 2, rel=0.1)
    for name in ("a.JPG", "a.hif"):
        lossy = replace(second, camera=replace(second.camera, image=Path(name)))
        found, why = noise.of_all([lossy])
        assert found is None and why.startswith("JPEG")


@pytest.mark.parametrize("width", [160, 80, 53, 200])
def test_what_resampling_leaves_of_it_is_told(width, tmp_path):
    """Against the noise that is there: the photograph less the same without noise."""
    made = []
    for sigma in (SIGMA, 0.0):
        file = tmp_path / f"{sigma}.exr"
        images.write_exr(file, scene(1, sigma).astype(np.float32), ["R", "G", "B"], {})
        seen = replace(camera(), image=file, lens=Lens(radial=(0.02, 0.0, 0.0, 0.0)))
        made.append(importing.load(seen, PhotosConfig(width=width)))
    noisy, clean = made
    counts = (noisy.mask > 0) & (clean.mask > 0)
    there = np.std((noisy.image - clean.image)[counts])
    assert np.sqrt(noisy.variance) == pytest.approx(there, rel=0.15)


def test_where_light_is_cut_off(rng):
    """Told from a flat face or background, from what is smooth, and from a picture's own noise."""
    rows, columns = np.mgrid[:60, :80] / 60
    smooth = np.stack([1.2 - (rows - 0.5) ** 2, 0.8 * columns, 0.3 + 0 * rows], 2)
    assert not clipped.cut_off(smooth.astype(np.float16).astype(np.float32)).any()
    bright = (smooth * rng.uniform(0.5, 1.5, (60, 80, 1))).astype(np.float32)
    assert not clipped.cut_off(bright).any()
    assert (clipped.cut_off(np.minimum(bright, 0.9)) == (bright >= 0.9).any(axis=2)).all()
    for face in ((0.9, 0.4, 0.3), (2.0, 2.0, 2.0)):
        flat = bright / 2
        flat[:20] = face
        assert not clipped.cut_off(flat).any()
    assert not clipped.cut_off(np.full((60, 80, 3), 3.0, np.float32)).any()
