"""Targets: means are those of independent paths, the measured noise is the noise, halves go on."""

from functools import cache as once

import mitsuba as mi
import numpy as np
import pytest
from problems_for_tests import built

from isas_cli.rendering import stratified, targets
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime import cache, streams

# Of surfaces and of media, unrolled, replayed and by Mitsuba's own integrators.
SCENES = {
    "pottery": ["scene=pottery", "size=tiny"],
    "replayed": ["scene=pottery", "size=tiny", "scene.max_depth=10"],
    "media": ["scene=smoke", "size=tiny"],
}
OTHERS = {name: [f"scene={name}", "size=tiny"] for name in ("dodoco_a", "earth")}


@once
def at_truth(name: str):
    problem = built(*{**SCENES, **OTHERS}[name], "target.spp=1")
    problem.unknowns.write(problem.unknowns.truths())
    return problem


@pytest.fixture(scope="module", params=SCENES)
def truth(request):
    """A problem whose scene is at the truth."""
    return at_truth(request.param)


@pytest.fixture
def pottery():
    return at_truth("pottery")


def rendered(problem, spp=None, noise=None, seed=0, told=lambda done, total: None, **more):
    return stratified.render(problem, noise, spp, seed, told, **more)


def test_means_are_those_of_independent_paths(truth):
    """Block by block, where many pixels' noise has become small."""
    spp, pixels = 256, truth.views.total
    found = rendered(truth, spp)
    renderer = Renderer(truth)
    seeds = lambda half: lambda i: streams.seed(7 + half, i, "evaluation")  # noqa: E731
    halves = [renderer.range(0, pixels, spp // 2, seeds(half)) for half in (0, 1)]
    other, spread = np.mean(halves, 0), (halves[0] - halves[1]) ** 2 / 4
    blocks = np.array_split(np.arange(pixels), 32)
    off = np.array([(found.images[b] - other[b]).mean() for b in blocks])
    error = np.array(
        [np.sqrt(found.variance[b].sum() + spread[b].mean(1).sum()) / b.size for b in blocks]
    )
    print("standard scores", np.round(off / np.maximum(error, 1e-9), 1))
    assert np.all(np.abs(off) <= 5 * error + 1e-6)
    total = np.sqrt(np.sum((error / len(blocks)) ** 2))
    assert abs(off.mean()) < 4 * total
    # And 2 % would show.
    assert 4 * total < 0.02 * other.mean()


@pytest.mark.parametrize("spp", [2, 16, 64])
def test_the_noise_that_is_told_is_that_of_many_renderings(truth, spp):
    many = [rendered(truth, spp, seed=seed) for seed in range(8)]
    seen = np.var([each.images for each in many], axis=0, ddof=1).mean(1)
    told = np.mean([each.variance for each in many], axis=0)
    # Without the few pixels whose rare paths eight renderings cannot tell the variance of.
    kept = np.argsort(told + seen)[: int(0.98 * told.size)]
    print("told over seen", told[kept].mean() / seen[kept].mean())
    assert 0.8 < told[kept].mean() / seen[kept].mean() < 1.25


def test_the_noise_that_is_wanted_is_reached(truth):
    few = rendered(truth, noise=0.1)
    many = rendered(truth, noise=0.05)
    for found, wanted in ((few, 0.1), (many, 0.05)):
        assert stratified.noise(found.images, found.variance) <= wanted
    assert many.paths >= few.paths
    # Half the noise takes four times the paths, in rounds that may overshoot by as much again.
    assert many.paths <= 16 * few.paths


def test_noisy_blocks_get_more_paths(pottery):
    found = rendered(pottery, 256)
    even = rendered(pottery, 256, seed=1)
    counts = found.counts
    assert counts.min() >= 1 and counts.max() >= 2 * np.median(counts)
    assert 0.8 < found.paths / (256 * pottery.views.total) < 1.3
    noisy = even.variance * even.sequences  # of one
    assert noisy[counts > np.median(counts)].mean() > 2 * noisy[counts <= np.median(counts)].mean()


@pytest.mark.parametrize("spp", [1, 2, 3, 5, 16])
def test_few_paths_are_as_many_as_asked_for(pottery, spp):
    found = rendered(pottery, spp)
    assert spp <= found.paths / pottery.views.total <= 1.7 * spp
    assert np.all(np.isfinite(found.variance)) == (spp > 1)


def test_progress_goes_on_to_the_end(truth):
    told = []
    found = rendered(truth, noise=0.06, told=lambda *each: told.append(each))
    done, total = np.array(told).T
    assert np.all(np.diff(done) >= 0) and np.all(done <= total)
    assert done[-1] == total[-1] == found.paths


def test_pixels_without_a_finite_path_are_left_out_of_the_noise():
    images, variance = np.ones((8, 3), np.float32), np.full(8, 0.04, np.float32)
    assert stratified.noise(images, variance) == pytest.approx(0.2)
    variance[2] = np.nan
    assert stratified.noise(images, variance) == pytest.approx(0.2)
    assert np.isnan(stratified.noise(images, variance * np.nan))
    assert stratified.noise(0 * images, variance) == 0


@pytest.mark.parametrize("name, lights", [("dodoco_a", 4), ("earth", 1), ("media", 1)])
def test_several_light_samples_are_taken_where_pilots_see_that_they_pay(name, lights, monkeypatch):
    """A matt figure under the sky, a globe under glass, and a volume, which has no first vertex."""
    problem = at_truth(name)
    assert rendered(problem, 64).lights == 1  # so few paths that nobody asks
    monkeypatch.setattr(stratified, "_MANY", 0)
    found, spp = rendered(problem, 1024), 1024
    assert found.lights == lights
    if lights > 1:
        monkeypatch.setattr(stratified, "_MANY", 1 << 40)
        other = rendered(problem, spp, seed=1)
        off = found.images.astype(np.float64) - other.images
        both = found.variance + other.variance
        # Channels of a pixel share their noise: at worst as if they were one.
        assert abs(off.mean()) < 4 * np.sqrt(both.sum()) / both.size
        assert found.variance.mean() < 0.7 * other.variance.mean()
        kept = rendered(problem, spp, kept=stratified.Sums.of(found.arrays()))
        assert kept.lights == lights and np.array_equal(kept.images, found.images)


class _Stopped(Exception):
    pass


def test_half_a_rendering_goes_on_to_the_same_bits(truth):
    whole, parts = rendered(truth, 64), []

    def stop(sums):
        parts.append({name: array.copy() for name, array in sums.arrays().items()})
        if len(parts) == 2:
            raise _Stopped

    with pytest.raises(_Stopped):
        rendered(truth, 64, keep=stop)
    rest = []
    found = rendered(
        truth, 64, kept=stratified.Sums.of(parts[-1]), told=lambda done, total: rest.append(done)
    )
    assert np.array_equal(found.images, whole.images)
    assert np.array_equal(found.variance, whole.variance)
    assert found.paths == whole.paths
    assert min(rest) > parts[-1]["paths"]


def test_what_stops_is_kept_and_taken_up(pottery, tmp_path, monkeypatch):
    """Ctrl-C while targets are rendered: the next run goes on, and then nothing is left over."""
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    target = targets.TargetConfig(spp=128)

    def interrupted(done, total):
        if done > total / 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        targets.render(pottery, target, interrupted)
    assert [path.name.endswith("-part.npz") for path in tmp_path.iterdir()] == [True]
    done = []
    images, variance, key = targets.render(pottery, target, lambda *told: done.append(told))
    assert done[0][0] > done[0][1] / 3
    assert [path.name for path in tmp_path.iterdir()] == [f"target-{key}-{mi.variant()}.npz"]
    assert variance.shape == (pottery.views.total,)
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path / "other"))
    again, _, _ = targets.render(pottery, target, lambda *told: None)
    assert np.array_equal(images, again)


def test_what_is_kept_is_written_now_and_then(tmp_path, monkeypatch):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(cache, "_KEPT_EVERY", 0.0)
    with cache.unfinished("long") as (found, keep):
        assert found == {}
        keep(lambda: {"a": np.arange(3)})
        assert (tmp_path / "long.npz").exists()
    assert not (tmp_path / "long.npz").exists()
