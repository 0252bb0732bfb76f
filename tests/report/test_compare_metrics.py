"""PBDR's measures by hand, and the table of methods."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas
import pytest
import synthetic_runs as synthetic

from isas_cli.report.compare import build, metrics

INF = math.inf


def test_re_adds_channels_up_and_mpea_averages_unknowns(tmp_path):
    """Against Eq. (7) and (8) on images and parameters whose errors are known one by one."""
    rng = np.random.default_rng(3)
    images = rng.normal(size=(20, 3))  # I^gt - I^r of 20 pixels
    keys = [rng.normal(size=8), rng.normal(size=1)]  # P^gt - P^est: a texture and a scalar
    image_rmse = math.sqrt(np.mean(images**2))
    parameter_rmse = math.sqrt(np.mean([np.mean(key**2) for key in keys]))
    run = synthetic.run(tmp_path, [0, 1], [9.0, image_rmse], [9.0, parameter_rmse])
    eq_7 = np.mean([np.linalg.norm(pixel) ** 2 for pixel in images])
    eq_8 = (np.mean(keys[0] ** 2) + keys[1][0] ** 2) / 2
    assert metrics.reconstruction_error(run) == pytest.approx(eq_7, rel=1e-12)
    assert metrics.material_error(run) == pytest.approx(eq_8, rel=1e-12)


def test_the_measures_take_the_last_known_value(tmp_path):
    run = synthetic.run(tmp_path, range(3), [1, 0.5, math.nan], [1, 0.25, math.nan])
    assert metrics.reconstruction_error(run) == pytest.approx(0.75)
    assert metrics.material_error(run) == pytest.approx(0.0625)


@pytest.mark.parametrize(
    "error, expected",
    [
        # The drop is 1.0, its band 0.05 around the last value; iterations are 0, 10, 20, …
        ([1.1, 0.5, 0.149, 0.12, 0.1], 20),
        ([1.1, 0.5, 0.151, 0.12, 0.1], 30),
        ([1.1, 0.12, 0.3, 0.12, 0.1], 30),  # was near, left again
        ([1.1, 0.04, 0.12, 0.09, 0.1], 20),  # below the band is outside, too
        ([1.1, 0.8, 0.6, 0.3, 0.1], INF),  # still moving when it ended
        ([1.0, 0.5, 0.7, 1.0, 1.0], INF),  # did not fall
        ([1.0, 1.5], INF),
        ([1.0, 1.0], INF),
        ([math.nan, 1.0], math.nan),
    ],
)
def test_convergence_is_when_the_error_stays_near_its_end(tmp_path, error, expected):
    found = metrics.convergence_speed(synthetic.run(tmp_path, range(len(error)), error))
    assert found == expected or (math.isnan(found) and math.isnan(expected))


def test_gradient_noise_is_the_mean_over_evaluated_iterations(tmp_path):
    noise = {"gradient_noise": [None, 4.0, math.nan, 1.0]}
    run = synthetic.run(tmp_path, range(4), [1, 0.5, 0.4, 0.3], columns=noise)
    assert metrics.gradient_noise(run) == 2.5


def summary(folder: Path) -> pandas.DataFrame:
    return build([folder]).summary.set_index("method")


def test_a_methods_row_holds_medians_over_its_seeds(tmp_path):
    for seed, final in enumerate([0.3, 0.1, 0.2], 1):
        synthetic.write(
            tmp_path / str(seed),
            [0, 1, seed * 10],
            [1, 0.5, final],
            [2, 1, 4 * final],
            seed=seed,
            columns={"nonfinite": [0, 1, seed], "gradient_noise": [None, seed, seed]},
            summary={"seconds_unbilled": {"load": 1.0, "writing": float(seed)}},
        )
    row = summary(tmp_path).loc["ours"]
    expected = {
        "scene": "pottery",
        "runs": 3,
        "seeds": "1 2 3",
        "iterations": 20,
        "paths": 20000,
        "seconds": 20,
        "image_rmse": 0.2,
        "image_rmse_low": 0.1,
        "image_rmse_high": 0.3,
        "image_rmse_share": 0.2,
        "parameter_rmse": 0.8,
        "parameter_rmse_low": 0.4,
        "parameter_rmse_high": 1.2,
        "parameter_rmse_share": 0.4,
        "RE": 3 * 0.2**2,
        "MPEA": 0.8**2,
        "CS": INF,
        "GN": 2,
        "nonfinite": 6,
        "stage1_seconds": 2,
        "step_seconds": 18,
        "unbilled_seconds": 3,
        "stage1_share": 0.1,
    }
    assert row[list(expected)].to_dict() == pytest.approx(expected)


def test_the_time_to_the_baselines_end_is_paired_and_forgives_five_per_cent(tmp_path):
    """Power laws (t / s)^(-1/2): within 5 % of the baseline's end at 1.05^-2 of its time."""
    for seed, scale in enumerate([1, 2, 3], 1):
        for sampler, factor in (("uniform", 1), ("ours", 5), ("gradient", 0.5)):
            synthetic.power_law(
                tmp_path / sampler / str(seed), scale / factor, sampler=sampler, seed=seed
            )
    frame = summary(tmp_path)
    for measure in ("image_rmse", "parameter_rmse"):
        columns = [f"{measure}_{n}" for n in ("seconds_to_baseline", "speed_up")]
        bounds = [f"{measure}_speed_up{bound}" for bound in ("_low", "_high")]
        end = 100 / 1.05**2
        assert frame.loc["uniform", columns].tolist() == pytest.approx([end, 1])
        assert frame.loc["ours", columns].tolist() == pytest.approx([end / 5, 5])
        assert frame.loc["ours", bounds].tolist() == pytest.approx([5, 5])
        assert frame.loc["gradient", columns].tolist() == [INF, 0]
    assert frame["baseline"].to_dict() == {"uniform": True, "ours": False, "gradient": False}


def test_other_seeds_aim_at_the_median_of_the_baselines_ends(tmp_path):
    for seed, scale in enumerate([1, 2, 3], 1):
        synthetic.power_law(tmp_path / "uniform" / str(seed), scale, sampler="uniform", seed=seed)
    synthetic.power_law(tmp_path / "ours", 0.5, seed=9)
    row = summary(tmp_path).loc["ours"]
    # The median end is (100 / 2)^(-1/2), 1.05 of which ours has at 25 / 1.05² s.
    assert row["image_rmse_seconds_to_baseline"] == pytest.approx(25 / 1.05**2)
    assert math.isnan(row["image_rmse_speed_up_low"])


def test_other_seeds_aim_at_a_share_of_their_own_start(tmp_path):
    """Which may lie below all that the baseline ends at."""
    synthetic.write(tmp_path / "uniform", [0, 1, 2], [1.0, 0.5, 0.4], sampler="uniform", seed=1)
    synthetic.write(tmp_path / "ours", [0, 1, 3], [0.1, 0.05, 0.04], seed=9)
    assert 1 < summary(tmp_path).loc["ours", "image_rmse_seconds_to_baseline"] < 3


def test_a_baseline_that_got_nowhere_sets_no_goal_that_the_start_meets(tmp_path):
    """It ends at 0.97 of the start's error, which 5 % above is more than the start's."""
    synthetic.write(tmp_path / "u", [0, 30, 60], [1, 1.02, 0.97], sampler="uniform")
    synthetic.write(tmp_path / "o", [0, 30, 60], [1, 0.5, 0.1])
    frame = summary(tmp_path)
    columns = ["image_rmse_seconds_to_baseline", "image_rmse_speed_up"]
    (base, one), (own, gain) = frame.loc["uniform", columns], frame.loc["ours", columns]
    assert 30 < base < 60 and one == 1
    assert 0 < own < 30 and gain == pytest.approx(base / own)


def test_the_time_of_steps_is_without_the_plan_s_probe(tmp_path):
    """The start's row has been billed what measured the plan, and nothing else."""
    synthetic.write(tmp_path, [3, 10, 20], [1, 0.5, 0.4], columns={"stage1_seconds": [0, 1, 2]})
    assert summary(tmp_path).loc["ours", "step_seconds"] == 20 - 2 - 3


def test_photographs_and_killed_runs_leave_blanks(tmp_path):
    synthetic.write(tmp_path, range(3), [1, 0.5, 0.4], status=None)
    row = summary(tmp_path).loc["ours"]
    unknown = ["parameter_rmse", "parameter_rmse_share", "parameter_rmse_speed_up"]
    assert row[[*unknown, "MPEA", "GN", "unbilled_seconds"]].isna().all()
    assert row[["RE", "image_rmse", "step_seconds"]].notna().all()
