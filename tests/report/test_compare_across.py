"""All scenes together: expected running times, arrivals, profiles and tests, in closed form."""

from __future__ import annotations

import sys

import numpy as np
import pandas
import pytest
import synthetic_runs as synthetic
from scipy import stats

from isas_cli.report.compare import across, build, facts, read_accuracy, tables, write
from isas_cli.report.compare.series import Series

SECONDS = np.concatenate([[0.0], np.geomspace(0.5, 32, 49)])


def law(speed: float) -> np.ndarray:
    """Error 1 at the start, then (speed · t)^-1/2: between evaluations exact."""
    return np.concatenate([[1.0], (speed * SECONDS[1:]) ** -0.5])


def recorded(folder, speeds: dict[str, dict[str, list[float]]], rates=None) -> None:
    """Scene → sampler → the speed of each of its seeds."""
    for scene, samplers in speeds.items():
        for sampler, of_seeds in samplers.items():
            for seed, speed in enumerate(of_seeds, 1):
                settings = {"scene.name": scene}
                if rates:
                    settings["optimizer.lr"] = rates[scene][sampler]
                synthetic.write(
                    folder / scene / sampler / str(seed),
                    SECONDS,
                    law(speed),
                    law(speed),
                    sampler=sampler,
                    seed=seed,
                    settings=settings,
                )


def table(folder) -> pandas.DataFrame:
    found = build([folder]).across
    assert [each.measure for each in found] == ["image_rmse", "parameter_rmse"]
    made = across.table(found)
    return made[made["measure"] == "parameter_rmse"].set_index("method")


def test_a_baseline_s_run_that_ended_early_is_not_its_budget(tmp_path):
    speeds = {"uniform": [4.0] * 3, "ours": [8.0] * 3}
    recorded(tmp_path, {"bowl": speeds, "pottery": speeds})
    short = {"sampler": "uniform", "seed": 3, "settings": {"scene.name": "bowl"}}
    synthetic.write(tmp_path / "bowl/uniform/killed", [0, 1], [1, 0.5], [1, 0.5], **short)
    (tmp_path / "bowl/uniform/3/manifest.json").unlink()
    (tmp_path / "bowl/uniform/3/history.csv").unlink()
    (tmp_path / "bowl/uniform/3/summary.json").unlink()
    assert build([tmp_path]).across[0].budgets["bowl"] == 32


def test_the_run_that_gives_a_level_reaches_it(tmp_path, rng):
    """Whatever the digits of its error round to."""
    for scene in (f"scene{number}" for number in range(12)):
        for sampler in ("uniform", "ours"):
            error = np.sort(rng.uniform(0.01, 0.9, len(SECONDS)))[::-1]
            where = tmp_path / scene / sampler
            own = {"sampler": sampler, "settings": {"scene.name": scene}}
            synthetic.write(where, SECONDS, error, error, **own)
    assert table(tmp_path).loc["uniform", "reached"] == 1


def test_a_table_of_all_scenes_does_not_outlive_them(tmp_path, no_plots):
    """And why there is none is said."""
    speeds = {"uniform": [4.0], "ours": [8.0], "gradient": [2.0]}
    recorded(tmp_path / "runs", {"bowl": speeds, "pottery": speeds})
    output = tmp_path / "comparison"
    write(build([tmp_path / "runs"]), output)
    assert (output / "across.csv").exists()
    recorded(tmp_path / "runs", {"earth": {"gradient": [4.0], "ours": [8.0]}})
    found = build([tmp_path / "runs"])
    (said,) = [line for line in found.warnings if "nothing is said of all scenes" in line]
    assert said.endswith("names one of gradient, ours")
    assert build([tmp_path / "runs"], "ours").across
    write(found, output)
    assert not (output / "across.csv").exists() and (output / "methods.csv").exists()


def test_twice_as_fast_is_a_speed_up_of_two(tmp_path):
    """On all scenes, at all levels; the slower one is a half and never gets to the end."""
    speeds = {"uniform": [4.0] * 3, "ours": [8.0] * 3, "gradient": [2.0] * 3}
    recorded(tmp_path, {"bowl": speeds, "pottery": speeds})
    found = table(tmp_path)
    assert list(found.index) == ["uniform", "gradient", "ours"]
    assert found.loc["ours", "speed_up"] == pytest.approx(2)
    assert found.loc["uniform", "speed_up"] == 1 and found.loc["ours", "reached"] == 1
    for share in across.SHARES:
        assert found.loc["ours", f"time_{share:g}"] == pytest.approx(0.5)
    assert found.loc["gradient", "reached"] == 0.75 and found.loc["gradient", "bound"] == "at most"
    # The last level costs all that three seeds spent.
    assert found.loc["gradient", "time_0.75"] == pytest.approx(4)
    assert found.loc["gradient", "bound_0.75"] == "at least"
    assert found.loc["gradient", "time_0.5"] == pytest.approx(2)
    assert found.loc["gradient", "bound_0.5"] == ""
    assert found.loc["ours", "bound"] == found.loc["uniform", "bound"] == ""
    low, high = found.loc["ours", ["speed_up_low", "speed_up_high"]]
    assert low == pytest.approx(2) and high == pytest.approx(2)


def test_a_baseline_that_is_worse_than_its_start_at_first_leaves_ratios_finite(
    tmp_path, monkeypatch
):
    """A level above the start would be reached at no cost."""

    def overshoot(speed: float) -> np.ndarray:
        error = (speed * SECONDS[1:]) ** -0.5
        return np.concatenate([[1.0], np.where(SECONDS[1:] < 5, 1.5, error)])

    monkeypatch.setattr(sys.modules[__name__], "law", overshoot)
    speeds = {"uniform": [2.0] * 3, "ours": [3.0] * 3}
    recorded(tmp_path, {"bowl": speeds, "pottery": speeds})
    found = table(tmp_path)
    assert np.isfinite(found["speed_up"]).all() and found.loc["ours", "speed_up"] >= 1


def test_speeds_of_scenes_have_a_geometric_mean(tmp_path):
    """And each scene's own best rate does not make another method of it."""
    speeds = {
        "bowl": {"uniform": [4.0, 4.0], "ours": [16.0, 16.0]},
        "pottery": {"uniform": [4.0, 4.0], "ours": [4.0, 4.0]},
    }
    rates = {
        "bowl": {"uniform": 0.01, "ours": 0.02},
        "pottery": {"uniform": 0.02, "ours": 0.01},
    }
    recorded(tmp_path, speeds, rates)
    assert table(tmp_path).loc["ours", "speed_up"] == pytest.approx(2)


def test_methods_of_one_law_look_alike(rng):
    """At every level: at the baseline's own end its seeds would reach theirs by definition."""

    def runs() -> dict[str, list[Series]]:
        return {
            scene: [
                Series(seed, law(speed), {"seconds": SECONDS})
                for seed, speed in enumerate(rng.lognormal(1, 0.3, 5))
            ]
            for scene in "abcd"
        }

    found = [across._reached("image_rmse", "x", {"x": runs(), "y": runs()}) for _ in range(60)]
    made = across.table(found)
    for column in made.filter(like="time_"):
        mean = np.exp(np.log(made.loc[made["method"] == "y", column]).mean())
        assert 0.92 < mean < 1.15, column


def test_methods_that_are_not_on_all_scenes_are_named(tmp_path):
    speeds = {"uniform": [4.0], "ours": [8.0]}
    recorded(tmp_path, {"bowl": speeds, "pottery": {**speeds, "gradient": [2.0]}})
    found = build([tmp_path])
    assert found.across and any(
        line.endswith("not in the table of these: gradient") for line in found.warnings
    )


def test_methods_whose_names_differ_by_scene_are_told(tmp_path):
    speeds = {"uniform": [4.0], "ours": [8.0]}
    recorded(tmp_path, {"bowl": speeds, "pottery": speeds})
    for sampler in speeds:
        own = {"scene.name": "bowl", "budget.seconds": 15.0}
        where = tmp_path / "more" / sampler
        synthetic.write(where, SECONDS, law(3), law(3), sampler=sampler, settings=own)
    found = build([tmp_path])
    assert found.across == []
    assert any("settings tell ours, uniform apart" in line for line in found.warnings)


def test_of_several_uniforms_the_lowest_is_the_baseline(tmp_path):
    for factor, speed in ((0.1, 2.0), (2.0, 8.0), (3.0, 4.0)):
        synthetic.write(
            *(tmp_path / f"{factor}", SECONDS, law(speed), law(speed)),
            **{"sampler": "uniform", "settings": {"optimizer.factor": factor}},
        )
    found = build([tmp_path])
    (chosen,) = found.baseline.values()
    assert chosen.endswith("optimizer.factor=2")
    (said,) = [line for line in found.warnings if "3 methods are uniform" in line]
    assert f"the baseline is {chosen}" in said


def test_scenes_too_few_for_any_p_are_told(tmp_path):
    speeds = {"uniform": [4.0], "ours": [8.0]}
    scenes = ["bowl", "pottery", "earth", "cup", "caustic", "lego"]
    recorded(tmp_path, dict.fromkeys(scenes[:4], speeds))
    assert any("no p over all scenes can be below 0.12" in x for x in build([tmp_path]).warnings)
    recorded(tmp_path, dict.fromkeys(scenes[4:], speeds))
    found = build([tmp_path])
    assert not any("no p over" in line for line in found.warnings)
    (p,) = {p for each in found.across for p in across.pairs(each).values()}
    assert p == pytest.approx(2 / 2**6)


def test_expected_running_time_counts_what_failures_spent():
    times = np.array([[2.0, np.inf, 4.0], [np.inf] * 3])
    value, solved = across.expected(times, np.array([5.0, 10.0, 6.0]))
    assert value.tolist() == [(2 + 10 + 4) / 2, 21] and solved.tolist() == [True, False]


def problems(times: dict[str, list], finals=None) -> across.Problems:
    """One scene of budget 8 with one level."""
    arrays = {name: {"bowl": np.array([t])} for name, t in times.items()}
    spent = {name: {"bowl": np.full(len(t), 8.0)} for name, t in times.items()}
    finals = finals or {name: [1.0] * len(t) for name, t in times.items()}
    ends = {name: {"bowl": np.array(f)} for name, f in finals.items()}
    return across.Problems("image_rmse", "uniform", arrays, spent, ends, {"bowl": 8.0})


def test_arrivals_are_the_share_reached_by_then():
    at, share = across.arrivals(problems({"uniform": [2.0, 8.0, 4.0, np.inf]}))["uniform"]
    assert at.tolist() == [0.25, 0.5, 1.0] and share.tolist() == [0.25, 0.5, 0.75]


def test_profiles_compare_with_the_soonest():
    found = across.profiles(
        problems({"uniform": [4.0, 4.0], "ours": [1.0, 3.0], "x": [np.inf] * 2})
    )
    assert found["ours"][0].tolist() == [1.0] and found["uniform"][0].tolist() == [2.0]
    assert found["ours"][1].tolist() == [1.0] and found["x"][0].size == 0


def test_a_baseline_that_leaves_its_level_again_bounds_from_below(tmp_path, monkeypatch):
    def rising(speed: float) -> np.ndarray:
        error = (speed * SECONDS[1:]) ** -0.5
        dips = np.where(SECONDS[1:] < 20, error, 0.9) if speed == 4.0 else error
        return np.concatenate([[1.0], dips])

    monkeypatch.setattr(sys.modules[__name__], "law", rising)
    speeds = {"uniform": [4.0] * 3, "ours": [8.0] * 3}
    recorded(tmp_path, {"bowl": speeds, "pottery": speeds})
    assert table(tmp_path).loc["ours", "bound"] == "at least"


def of_scenes(finals: dict[str, dict[str, np.ndarray]]) -> across.Problems:
    scenes = list(next(iter(finals.values())))
    one = {name: {s: np.ones((1, 3)) for s in scenes} for name in finals}
    budgets = dict.fromkeys(scenes, 1.0)
    return across.Problems("image_rmse", "uniform", one, one, finals, budgets)


def test_pairs_are_tested_and_corrected(rng):
    """Holm: the least p times three, the next times two, never falling."""
    levels = {"uniform": 1.0, "ours": 0.5, "x": 0.8}
    finals = {
        name: {s: level * rng.lognormal(sigma=0.3, size=3) for s in "abcdefgh"}
        for name, level in levels.items()
    }
    found = across.pairs(of_scenes(finals))
    raw = {}
    for pair in (("uniform", "ours"), ("uniform", "x"), ("ours", "x")):
        a, b = (np.log([np.median(each) for each in finals[name].values()]) for name in pair)
        raw[frozenset(pair)] = stats.wilcoxon(a, b).pvalue
    ordered = sorted(raw, key=raw.get)
    assert found[ordered[0]] == pytest.approx(3 * raw[ordered[0]])
    assert found[ordered[1]] == pytest.approx(max(2 * raw[ordered[1]], found[ordered[0]]))
    assert found[ordered[2]] == pytest.approx(max(raw[ordered[2]], found[ordered[1]]))


@pytest.mark.parametrize("by_scene, seeds", [(0.0, 1.0), (0.5, 0.01)], ids=["equal", "by scene"])
def test_equal_methods_are_told_apart_as_rarely_as_they_should(by_scene, seeds, rng):
    """Of scenes as unlike as may be; and of methods each of which is ahead on some scenes, by far
    more than seeds differ: seeds of one scene are no evidence of the next."""
    rejected = []
    for _ in range(300):
        finals = {
            name: {
                s: 10.0**k * rng.lognormal(rng.normal(0, by_scene), seeds, 3)
                for k, s in enumerate("abcdefgh")
            }
            for name in ("uniform", "ours")
        }
        rejected.append(across.pairs(of_scenes(finals))[frozenset(finals)] < 0.05)
    assert stats.binomtest(sum(rejected), len(rejected), 0.05).pvalue > 1e-3


def test_one_scene_or_one_method_is_no_comparison_of_scenes(tmp_path):
    recorded(tmp_path, {"bowl": {"uniform": [4.0], "ours": [8.0]}})
    assert build([tmp_path]).across == []
    recorded(tmp_path, {"pottery": {"uniform": [4.0]}})
    assert build([tmp_path]).across == []


def test_the_table_reads_back_as_it_was(tmp_path):
    speeds = {"uniform": [4.0] * 2, "ours": [0.5] * 2}  # which never arrives at the later levels
    recorded(tmp_path / "runs", {"bowl": speeds, "pottery": speeds})
    comparison = build([tmp_path / "runs"])
    tables.write(comparison, tmp_path)
    wanted = across.table(comparison.across)
    assert {"", "at least"} <= set(wanted["bound_0.75"])
    read = read_accuracy(tmp_path / "across.csv")
    pandas.testing.assert_frame_equal(read, wanted, check_dtype=False, check_exact=True)


def test_page_table_and_plots_are_written(tmp_path):
    speeds = {"uniform": [4.0] * 2, "ours": [8.0] * 2}
    recorded(tmp_path / "runs", {"bowl": speeds, "pottery": speeds})
    page = write(build([tmp_path / "runs"]), tmp_path / "out")
    assert "All scenes together" in page.read_text()
    assert f"<b>{facts.times(2.0)}</b>" in page.read_text()
    assert len(pandas.read_csv(tmp_path / "out" / "across.csv")) == 4
    for name in ("arrivals", "profiles"):
        assert (tmp_path / "out" / "plots" / f"all_{name}.png").stat().st_size > 1000
