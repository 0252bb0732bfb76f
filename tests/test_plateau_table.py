"""The races of PRDPT's tasks: what is searched, and what their tables say of records."""

import sys
from pathlib import Path

import numpy as np
import pandas
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
import _plateau  # noqa: E402
import _plateau_table as tables  # noqa: E402

STEPS = len(tables.GRID)


def test_shares_are_of_every_unknown_by_itself():
    history = pandas.DataFrame(
        {
            "parameter_rmse": [100.0, 50.0],
            "parameter_rmse/a.angle": [90.0, 45.0],
            "parameter_rmse/b.place/more": [0.2, 0.02],
        }
    )
    found = tables.shares(history)
    assert list(found) == ["a.angle", "b.place/more"]
    assert tables.together(found) == pytest.approx([1, np.sqrt((0.5**2 + 0.1**2) / 2)])


def runs(**curves) -> tuple[pandas.DataFrame, np.ndarray]:
    """Two starts each; curves given by their values at the grid's points."""
    rows = [{"method": m, "trial": t} for m in curves for t in (1, 2)]
    return pandas.DataFrame(rows), np.array([curve for pair in curves.values() for curve in pair])


def test_time_is_that_from_which_a_run_stays_below():
    falling = np.linspace(1, 0, STEPS)
    again = np.where(np.arange(STEPS) == 20, 1.0, 0.5 * falling)  # back once, late
    found, curves = runs(
        plateau=[falling + 0.1, falling + 0.5],
        mitsuba=[np.ones(STEPS), again],
        plateau_drawn=[np.minimum(falling + 0.1, 0.1), 2 * falling],
    )
    time = dict(zip(zip(found["method"], found["trial"]), tables.times(found, curves)))
    assert time["plateau", 1] == time["plateau", 2] == 1
    assert time["mitsuba", 1] == np.inf
    assert time["mitsuba", 2] == tables.GRID[21]  # not before it was back
    assert time["plateau_drawn", 1] == 0
    assert time["plateau_drawn", 2] == pytest.approx(0.76)  # 2 (1 - t) <= 0.5


def test_paces_are_of_the_same_start():
    found = pandas.DataFrame(
        {
            "method": ["plateau", "plateau", "mitsuba", "mitsuba"],
            "trial": [1, 2, 1, 2],
            "seconds": [10.0, 10.0, 10.0, 10.0],
            "iterations": [100, 50, 10, 10],
        }
    )
    assert list(tables.paces(found)) == pytest.approx([1, 1, 10, 5])


def test_a_failed_run_counts_as_one_that_did_not_arrive():
    found = pandas.DataFrame(
        {
            "method": ["mitsuba"] * 3,
            "factor": [1.0] * 3,
            "budget": [5.0] * 3,
            "image_mse": [1.0, 2.0, 3.0],
            "parameter_mse": [1.0, 2.0, 3.0],
            "share_of_start": [0.005, np.inf, 0.04],
            "together": [0.005, 0.01, 0.04],
            "time": [1.0, np.inf, np.inf],
            "pace": [2.0, 3.0, 4.0],
            "iterations": [10, 10, 10],
            "seconds": [5.0, 5.0, 5.0],
        }
    )
    (row,) = tables.table("cup", found).to_dict("records")
    assert (row["within_1_percent"], row["within_5_percent"], row["failed"]) == (1, 2, 1)
    assert row["share_of_start"] == 0.04 and row["share_of_start_high"] == np.inf
    assert tables._number(row, "time", ".2f") == "– [1.00, –]"


def test_cubes_at_each_others_places_are_sorted():
    from isas_cli.scenes import sort

    places = sort.places().reshape(3, 25, 2)
    order = np.random.default_rng(0).permutation(25)

    def found(cubes) -> dict:
        return tables.in_place((cubes - places).ravel())

    other = found(places[:, order])
    assert (other["filled"], other["unfilled"]) == (75, 0)
    assert other["sorted_mse"] == pytest.approx(0, abs=1e-12)
    assert found(places[[1, 0, 2]])["filled"] == 25  # of another colour
    two = places.copy()
    two[0, 0] = two[0, 1]  # one place, two cubes
    assert found(two)["filled"] == 74
    assert found(places + [0.4 * sort.SIDE, 0])["filled"] == 75
    assert found(places + [0.4 * sort.SIDE, 0])["sorted_mse"] == pytest.approx(
        (0.4 * sort.SIDE) ** 2 / 2
    )


def test_the_search_goes_on_where_an_end_is_best(monkeypatch, tmp_path):
    """Once, beside that end; methods of few steps have one factor more from the first."""
    best = {"plateau": 1.0, "plateau_drawn": 0.1, "mitsuba": 30.0}
    raced = {}

    def race(folder, task, wanted, seconds):
        raced[folder.name] = wanted

    def finished(folder):
        rows = [
            {"method": m, "factor": f, "unfilled": abs(np.log(f / best[m]))}
            for m, f, _ in raced[folder.name]
        ]
        return pandas.DataFrame(rows), None

    monkeypatch.setattr(_plateau, "race", race)
    monkeypatch.setattr(tables, "finished", finished)
    monkeypatch.setattr(_plateau, "RESULTS", tmp_path)
    assert _plateau.searched("sort", tmp_path, 1.0) == best
    factors = {
        name: {m: [f for n, f, _ in wanted if n == m] for m in best}
        for name, wanted in raced.items()
    }
    assert factors["rates"] == {
        "plateau": [0.3, 1.0, 3.0],
        "plateau_drawn": [0.3, 1.0, 3.0],
        "mitsuba": [0.3, 1.0, 3.0, 10.0],
    }
    assert factors["rates_beyond"] == {
        "plateau": [],
        "plateau_drawn": [0.3, 0.03, 0.1],
        "mitsuba": [10.0, 30.0, 100.0],
    }
    assert {trial for wanted in raced.values() for _, _, trial in wanted} == {_plateau.SEARCH}


def test_a_race_of_other_settings_is_not_taken_for_this_one(tmp_path):
    (tmp_path / "rates").mkdir()
    (tmp_path / "rates" / "settings.yaml").write_text("of another day")
    with pytest.raises(SystemExit, match="rates: of other settings"):
        _plateau.race(tmp_path / "rates", "cup", [("plateau", 1.0, 1)], 1.0)
