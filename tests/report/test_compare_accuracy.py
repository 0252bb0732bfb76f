"""What accuracy costs: levels, medians, intervals, ratios, halvings and slopes, in closed form."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas
import pytest
import synthetic_runs as synthetic
from scipy import stats

from isas_cli.report.compare import accuracy, bootstrap, build, curves, price, series
from isas_cli.report.compare.series import Series

INF = math.inf


def made(error, seconds=None, seed: int | None = 1) -> Series:
    seconds = np.arange(len(error)) if seconds is None else seconds
    cost = np.asarray(seconds, dtype=float)
    return Series(seed, np.asarray(error, dtype=float), {"seconds": cost, "paths": 1000 * cost})


def rows(frame: pandas.DataFrame, **values) -> pandas.DataFrame:
    """The rows with these values."""
    for name, value in values.items():
        frame = frame[frame[name] == value]
    return frame


# One run


def test_a_power_law_is_interpolated_exactly():
    law = made([1, 1, 0.1], [0, 1, 100])
    for level in (0.9, 0.5, 0.3, 0.1):
        assert law.reached(level, "seconds") == pytest.approx(level**-2, rel=1e-12)
        assert law.reached(level, "paths") == pytest.approx(1000 * level**-2, rel=1e-12)
    t = np.geomspace(1, 100, 9)
    np.testing.assert_allclose(law.at(t, "seconds"), t**-0.5, rtol=1e-12)


def test_in_the_first_gap_exponential_decay_is_interpolated_exactly():
    decay = made([1, math.exp(-5)], [0, 5])
    assert decay.reached(0.5, "seconds") == pytest.approx(math.log(2), rel=1e-12)
    t = np.linspace(0.1, 5, 7)
    np.testing.assert_allclose(decay.at(t, "seconds"), np.exp(-t), rtol=1e-12)


def test_a_curve_ends_with_its_last_evaluation():
    assert np.isnan(made([1, 0.5]).at(np.array([1.0, 1.0001]), "seconds")).tolist() == [False, True]


@pytest.mark.parametrize(
    "error, expected",
    [
        ([1, 0.01, 0.9, 0.5, 0.4], 3),  # swings through the truth, comes back, then arrives
        ([1, 0.4, 0.6], INF),  # passes the level on its way to a worse end
        ([1, 0.9, 0.8], INF),
        ([1, 0.8, 0.5], 2),  # at the level counts
        ([1, 0.5, 0.5, 0.5], 1),
    ],
)
def test_a_level_is_reached_when_the_error_stays_there(error, expected):
    assert made(error).reached(0.5, "seconds") == pytest.approx(expected)


def test_an_error_of_zero_counts_as_the_smallest_that_was_measured(tmp_path):
    run = synthetic.run(tmp_path / "1", [0, 1, 2], [1.0, 0.25, 0.0])
    read = series.read(run, "image_rmse")
    assert read.error.tolist() == [1, 0.25, 0.25]
    assert accuracy.levels_of({"a": [read]}).tolist() == [0.5, 0.25, 0.125]
    at_once = synthetic.run(tmp_path / "2", [0, 1, 2], [1.0, 0.0, 0.0])
    assert series.read(at_once, "image_rmse").error.tolist() == [1, 0.5, 0.5]


def test_evaluations_that_are_not_finite_are_left_out(tmp_path):
    image = [1.0, math.nan, 0.25, math.inf, 0.125]
    read = series.read(synthetic.run(tmp_path, range(5), image), "image_rmse")
    assert read.error.tolist() == [1, 0.25, 0.125]
    assert read.cost["seconds"].tolist() == [0, 2, 4]


@pytest.mark.parametrize(
    "image", [[math.nan, 1.0, 0.5], [0.0, 0.5, 0.5], [1.0, math.nan, math.nan]]
)
def test_without_a_start_or_anything_after_it_there_is_no_series(tmp_path, image):
    assert series.read(synthetic.run(tmp_path, range(3), image), "image_rmse") is None


# Medians and intervals


@pytest.mark.parametrize(
    "values, value, low, high",
    [
        ([4, 8, INF], 8, 4, INF),
        ([4, INF, INF], INF, 4, INF),
        ([4, 8, INF, INF], INF, 4, INF),
        ([INF, INF, INF], INF, INF, INF),
        ([1, 2, 3, 4], 2.5, 1, 4),
        ([7, 7, 7], 7, 7, 7),
    ],
)
def test_median_and_interval_know_infinity(values, value, low, high):
    assert bootstrap.median(np.array(values)) == (value, low, high)


def test_one_run_has_no_interval_and_none_has_no_median():
    value, low, high = bootstrap.median(np.array([3.0]))
    assert value == 3 and np.isnan(low) and np.isnan(high)
    assert np.isnan(bootstrap.median(np.empty((2, 0)))).all()


@pytest.mark.parametrize(
    "above, below, expected",
    [
        ([4, 4], [2, 2], 2),
        ([INF, INF], [2, 2], INF),
        ([4, 4], [INF, INF], 0),
        ([INF, INF], [INF, INF], math.nan),
    ],
)
def test_a_ratio_knows_which_side_has_reached_the_level(above, below, expected):
    for paired in (True, False):
        estimate = bootstrap.ratio(np.array(above), np.array(below), paired)
        np.testing.assert_equal(list(estimate), [expected] * 3)


def test_a_resample_in_which_neither_side_arrives_says_nothing_of_the_ratio():
    value, low, high = bootstrap.ratio(np.array([4, 4, INF]), np.array([2, 2, INF]), paired=True)
    assert (value, low, high) == (2, 0, INF)


@pytest.mark.parametrize(
    "seeds, held", [(3, 0.75), (5, 0.9375), (7, 1 - 2 / 128), (10, 1 - 22 / 1024)]
)
def test_the_interval_holds_the_true_median_as_often_as_it_says(rng, seeds, held):
    """Exactly as often as `held` says, at least 95 % from six seeds on, and by no wider interval
    than that needs."""
    repetitions = 2500
    samples = rng.lognormal(sigma=1.0, size=(repetitions, seeds))
    _, low, high = bootstrap.median(samples)
    inside = int(((low <= 1) & (1 <= high)).sum())
    print(f"held in {inside} of {repetitions}")
    assert bootstrap.held(seeds) == pytest.approx(held)
    assert stats.binomtest(inside, repetitions, held).pvalue > 1e-3
    ordered, end = np.sort(samples, axis=1), int(seeds > 8)
    np.testing.assert_array_equal(low, ordered[:, end])
    np.testing.assert_array_equal(high, ordered[:, -1 - end])


def test_pairs_take_what_seeds_do_to_both_sides_out_of_the_ratio(rng):
    """Seeds differ by a factor of e, the ratio of one seed by 10 %: pairs must hold the true ratio
    of 2 and see it several times as sharply as sides drawn apart."""
    repetitions, seeds = 200, 15
    difficulty = rng.lognormal(sigma=1.0, size=(repetitions, seeds))
    above = 2 * difficulty * rng.lognormal(sigma=0.05, size=(repetitions, seeds))
    below = difficulty * rng.lognormal(sigma=0.05, size=(repetitions, seeds))
    _, low, high = bootstrap.ratio(above, below, paired=True)
    _, low_apart, high_apart = bootstrap.ratio(above, below, paired=False)
    inside = int(((low <= 2) & (2 <= high)).sum())
    assert stats.binomtest(inside, repetitions, 0.93, "less").pvalue > 5e-4, inside / repetitions
    assert np.median(np.log(high / low)) < np.median(np.log(high_apart / low_apart)) / 4


# Tables


def race(folder: Path, uniform: list[float], ours: list[float]) -> Path:
    """Power laws with these scales, seeds 1, 2, …"""
    for sampler, scales in (("uniform", uniform), ("ours", ours)):
        for seed, scale in enumerate(scales, 1):
            synthetic.power_law(folder / sampler / str(seed), scale, sampler=sampler, seed=seed)
    return folder


def test_levels_costs_and_ratios_of_power_laws(tmp_path):
    """(t / s)^(-1/2) reaches 2^-k at t = s 4^k."""
    frame = build([race(tmp_path, [1, 2, 3], [0.5, 0.5, 20])]).accuracy
    # Of [0, 100] s: with s = 0.5 down to 1/8 (32 s), with s = 20 down to 1/2 (80 s).
    for measure in ("image_rmse", "parameter_rmse"):
        part = rows(frame, measure=measure)
        assert part["level"].unique().tolist() == [0.5, 0.25, 0.125, 0.0625]
        half = rows(part, level=0.5).set_index("method")
        assert half.index.tolist() == ["uniform", "ours"], "the baseline first"
        uniform, ours = half.loc["uniform"], half.loc["ours"]
        assert uniform[["seconds", "seconds_low", "seconds_high"]].tolist() == pytest.approx(
            [8, 4, 12]
        )
        assert ours[["seconds", "seconds_low", "seconds_high"]].tolist() == pytest.approx(
            [2, 2, 80]
        )
        assert ours[["paths", "paths_low", "paths_high"]].tolist() == pytest.approx(
            [2000, 2000, 80000], abs=2
        )
        assert uniform[["ratio", "ratio_low", "ratio_high"]].tolist() == [1, 1, 1]
        assert ours["ratio"] == pytest.approx(4)
        assert (uniform["runs"], uniform["reached"]) == (3, 3)
        eighth = rows(part, level=0.125).set_index("method")
        assert eighth.loc["uniform", "seconds"] == INF and eighth.loc["uniform", "reached"] == 1
        assert eighth.loc["ours", "seconds"] == pytest.approx(32)
        assert eighth.loc["ours", "reached"] == 2
        assert eighth.loc["ours", "ratio"] == INF, "only this method reached it"
        deepest = rows(part, level=0.0625)
        assert (deepest["reached"] == 0).all() and deepest["ratio"].isna().all()


def test_ratios_are_paired_where_the_seeds_are_the_same(tmp_path):
    """Each seed is four times as fast: the pairs' ratio is 4 without any doubt."""
    scales = [0.25, 0.5, 1, 2, 4, 5, 6]
    paired = build([race(tmp_path / "same", scales, [s / 4 for s in scales])]).accuracy
    ours = rows(paired, method="ours", measure="image_rmse", level=0.5)
    assert ours[["ratio", "ratio_low", "ratio_high"]].values.tolist() == [pytest.approx([4, 4, 4])]
    race(tmp_path / "other", scales, [])
    for seed, scale in enumerate(scales, 101):
        synthetic.power_law(tmp_path / "other" / str(seed), scale / 4, sampler="ours", seed=seed)
    apart = build([tmp_path / "other"]).accuracy
    ours = rows(apart, method="ours", measure="image_rmse", level=0.5).iloc[0]
    assert ours["ratio"] == pytest.approx(4)
    assert ours["ratio_low"] < 3 and ours["ratio_high"] > 5


def test_one_run_each_gives_values_without_bounds(tmp_path):
    frame = build([race(tmp_path, [1], [0.5])]).accuracy
    ours = rows(frame, method="ours", measure="image_rmse", level=0.5).iloc[0]
    assert (ours["seconds"], ours["ratio"]) == (pytest.approx(2), pytest.approx(2))
    bounds = [name for name in frame if name.endswith(("_low", "_high"))]
    assert len(bounds) == 6 and ours[bounds].isna().all()


def test_photographs_have_image_errors_only(tmp_path):
    synthetic.write(tmp_path, [0, 1, 2, 3], [1, 0.5, 0.3, 0.2])
    comparison = build([tmp_path])
    for frame in (comparison.accuracy, comparison.price, comparison.curves):
        assert set(frame["measure"]) == {"image_rmse"}


def test_levels_are_each_scenes_own(tmp_path):
    synthetic.power_law(tmp_path / "a", 1)
    synthetic.power_law(tmp_path / "b", 10, settings={"scene.name": "dodoco"})
    depth = build([tmp_path]).accuracy.groupby("scene")["level"].min()
    assert depth["pottery"] == 0.0625 and depth["dodoco"] == 0.25


def test_curves_are_medians_on_one_grid_without_extrapolation(tmp_path):
    for seed, (scale, end) in enumerate([(1, 100), (4, 100), (9, 50)], 1):
        synthetic.power_law(tmp_path / str(seed), scale, end, seed=seed)
    frame = rows(build([tmp_path]).curves, measure="image_rmse", axis="seconds")
    assert list(frame.columns) == curves.COLUMNS
    x = frame["x"].to_numpy()
    assert (x[0], x[-1]) == (1, 100)
    assert np.ptp(np.diff(np.log(x))) < 1e-9, "evenly spaced in the logarithm"
    all_run = frame[(frame["x"] >= 9) & (frame["x"] < 50)]
    assert (all_run["runs"] == 3).all()
    for name, scale in (("median", 4), ("low", 1), ("high", 9)):
        np.testing.assert_allclose(all_run[name], (scale / all_run["x"]) ** 0.5, rtol=1e-9)
    assert (frame[frame["x"] > 50]["runs"] == 2).all()
    paths = rows(build([tmp_path]).curves, measure="image_rmse", axis="paths")
    assert paths["x"].max() == 100_000


def test_a_single_run_is_a_curve_without_a_band(tmp_path):
    synthetic.power_law(tmp_path)
    frame = build([tmp_path]).curves
    assert frame["median"].notna().all() and frame[["low", "high"]].isna().all().all()


# Price


def test_halvings_of_a_power_law_cost_four_times_the_one_before(tmp_path):
    for seed, scale in enumerate([0.5, 1, 1.5], 1):
        synthetic.power_law(tmp_path / str(seed), scale, seed=seed)
    part = rows(build([tmp_path]).price, measure="parameter_rmse")
    assert list(part.columns) == price.COLUMNS
    assert part["level"].tolist() == [0.5, 0.25, 0.125, 0.0625]
    assert part["seconds"].tolist() == pytest.approx([4, 12, 48, INF])
    assert part["seconds_low"].tolist() == pytest.approx([2, 6, 24, INF])
    assert part["paths"].tolist() == pytest.approx([4000, 12000, 48000, INF], rel=1e-3)
    for axis in ("seconds", "paths"):
        columns = [f"slope_{axis}{bound}" for bound in ("", "_low", "_high")]
        np.testing.assert_allclose(part[columns], -0.5, atol=2e-3)
    assert (part["slope_monte_carlo"] == -0.5).all()


@pytest.mark.parametrize("power", [-1.0, -0.5, -0.2])
def test_the_late_slope_does_not_see_how_the_run_began(power):
    t = np.geomspace(1, 1000, 31)
    error = np.where(t < 90, 1.0, (t / 90) ** power)
    assert price.late_slope(made(error, t), "seconds") == pytest.approx(power, abs=1e-9)


@pytest.mark.parametrize("seconds", [[0, 1], [0, 1, 100, 101], [0, 0, 0, 0], [0, 5, 5, 5]])
def test_a_slope_needs_three_late_evaluations_apart(seconds):
    assert math.isnan(price.late_slope(made(np.linspace(1, 0.5, len(seconds)), seconds), "seconds"))


def test_a_noisy_slope_is_found_within_its_interval(tmp_path, rng):
    """Twelve seeds of t^(-0.7) with 5 % noise: the interval is near -0.7 and narrow enough to tell
    it from Monte Carlo's."""
    t = np.concatenate([[0], np.geomspace(1, 100, 40)])
    for seed in range(12):
        error = np.maximum(t, 1) ** -0.7 * rng.lognormal(sigma=0.05, size=len(t))
        synthetic.write(tmp_path / str(seed), t, error, seed=seed)
    row = build([tmp_path]).price.iloc[0]
    assert row["slope_seconds_low"] < -0.7 + 0.02 and row["slope_seconds_high"] > -0.7 - 0.02
    assert row["slope_seconds_high"] < -0.6
