"""The races of PRDPT's tasks: what is searched, and what their tables say of records."""

import argparse
import io
import shutil
from pathlib import Path

import _page_plateau
import _plateau
import _plateau_paper
import _plateau_table as tables
import numpy as np
import pandas
import pytest
import synthetic_runs
from omegaconf import OmegaConf

from isas_cli.config import schema

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


def test_no_time_is_taken_to_a_place_farther_off_than_the_start():
    away, arrived = np.linspace(1, 2, STEPS), np.linspace(1, 0.1, STEPS)
    found, curves = runs(plateau=[away, arrived], mitsuba=[arrived, away])
    time = dict(zip(zip(found["method"], found["trial"]), tables.times(found, curves)))
    assert np.isnan(time["plateau", 1]) and np.isnan(time["mitsuba", 1])
    assert time["mitsuba", 2] == np.inf


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
    assert _page_plateau._number(row, "time", ".2f") == "– [1.00, –]"


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
        assert all(trial == int(folder.name) for *_, trial in wanted)
        raced.setdefault(folder.parent.name, []).extend(wanted)

    def finished(folder):
        rows = [
            {"method": m, "factor": f, "unfilled": abs(np.log(f / best[m])), "sorted_mse": 1.0}
            for m, f, _ in raced[folder.name]
        ]
        return pandas.DataFrame(rows), None

    monkeypatch.setattr(_plateau, "race", race)
    monkeypatch.setattr(tables, "finished", finished)
    monkeypatch.setattr(_plateau, "RESULTS", tmp_path)
    chosen, found = _plateau.searched("sort", tmp_path, 1.0, tuple(best))
    assert chosen == best and set(found["method"]) == set(best)
    factors = {
        name: {m: [f for n, f, t in wanted if (n, t) == (m, _plateau.SEARCH[0])] for m in best}
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
    trials = {trial for wanted in raced.values() for _, _, trial in wanted}
    assert trials == set(_plateau.SEARCH)


@pytest.mark.parametrize(
    ("shares", "expected"),
    [
        # Not that of the single luckiest run.
        ({0.3: (0.02, 0.02, 9.0), 1.0: (0.011, 0.5, np.inf), 3.0: (0.03, 0.03, 0.03)}, 0.3),
        # Nor that from which some do not arrive.
        ({0.3: (0.001, 0.001, 0.05), 1.0: (0.009, 0.008, 0.007)}, 1.0),
        # As many of a race with more starts.
        ({0.3: (0.004, 0.004), 1.0: (0.003, 0.003, 0.003, 0.003)}, 1.0),
    ],
)
def test_the_best_rate_arrives_from_most_starts_then_has_the_least_median(shares, expected):
    rows = [
        {"method": "mitsuba", "factor": factor, "share_of_start": share}
        for factor, found in shares.items()
        for share in found
    ]
    assert _plateau.best(pandas.DataFrame(rows)) == {"mitsuba": expected}


def test_the_best_rate_of_sort_fills_most_places():
    """Of those, that with nearer cubes."""
    cubes = {"unfilled": [12, 11, 11], "sorted_mse": [0.1, 0.3, 0.2], "factor": [0.3, 1.0, 3.0]}
    assert _plateau.best(pandas.DataFrame(cubes | {"method": "plateau"})) == {"plateau": 3.0}


@pytest.mark.parametrize("task", _plateau.TASKS)
def test_all_methods_of_a_trial_begin_at_the_same_place(task):
    starts = {}
    for method in _plateau.TASKS[task].methods:
        for trial in (1, 2, *_plateau.TASKS[task].search):
            cfg = _plateau.configured(task, method, trial, 3.0, 7.0)
            assert (cfg.seed, cfg.optimizer.factor, cfg.budget.seconds) == (trial, 3.0, 7.0)
            given = OmegaConf.to_yaml(cfg.scene.unknowns)
            starts.setdefault(trial, set()).add(given)
        schema.typed(cfg)
    assert all(len(same) == 1 for same in starts.values())
    assert len(set.union(*starts.values())) == 2 + len(_plateau.TASKS[task].search)


@pytest.mark.parametrize("task", _plateau.TASKS)
def test_methods_are_judged_on_starts_that_their_rates_were_not_chosen_on(
    task, monkeypatch, tmp_path
):
    """Variants, unless they are to be judged on all, on the first five of the others' twenty; of
    sort all methods."""
    methods = _plateau.TASKS[task].methods
    judged = {method: [] for method in methods}

    def race(folder, _, wanted, seconds):
        for method, _, trial in wanted:
            assert folder == tmp_path / task / "starts" / str(trial)
            judged[method].append(trial)

    monkeypatch.setattr(_plateau, "race", race)
    monkeypatch.setattr(_plateau, "searched", lambda *_: (dict.fromkeys(methods, 1.0), None))
    for name in ("write", "save"):
        monkeypatch.setattr(tables, name, lambda *_: None)
    asked = argparse.Namespace(starts=20, seconds=None, again=False, add=None)
    _plateau.compared(task, tmp_path, asked)
    first = _plateau.TASKS[task].first
    for method, trials in judged.items():
        few = task == "sort" or method in _plateau.VARIANTS
        few = few and method not in _plateau.TASKS[task].whole
        assert trials == list(range(first, first + (5 if few else 20)))
        assert not set(trials) & set(_plateau.TASKS[task].search)


def test_a_race_anew_takes_the_rates_of_the_table(monkeypatch, tmp_path):
    methods = _plateau.TASKS["cup"].methods
    rates = {method: 1.0 + number for number, method in enumerate(methods)}
    table = pandas.DataFrame({"method": list(rates), "factor": list(rates.values())})
    table.to_csv(tmp_path / "plateau_cup.csv", index=False)
    raced = []
    monkeypatch.setattr(_plateau, "RESULTS", tmp_path)
    monkeypatch.setattr(_plateau, "race", lambda folder, _, wanted, seconds: raced.append(wanted))
    monkeypatch.setattr(tables, "write", lambda *_: None)
    asked = argparse.Namespace(starts=1, seconds=None, again=True, add=None)
    _plateau.compared("cup", tmp_path, asked)
    assert raced == [[(method, rate, 1) for method, rate in rates.items()]]


def test_a_method_alone_is_added_to_the_tables(monkeypatch, tmp_path):
    """Its own rate is searched; it is judged beside `plateau` at that one's rate."""
    own = "plateau_renderer"
    table = pandas.DataFrame({"method": ["plateau", own, "mitsuba"], "factor": [3.0, 9.0, 1.0]})
    for name in ("", "_rates"):
        table.to_csv(tmp_path / f"plateau_cup{name}.csv", index=False)
    raced = []
    monkeypatch.setattr(_plateau, "RESULTS", tmp_path)
    monkeypatch.setattr(tables, "RESULTS", tmp_path)
    monkeypatch.setattr(_plateau, "race", lambda folder, _, wanted, seconds: raced.append(wanted))
    monkeypatch.setattr(tables, "write", lambda *_: None)
    found = pandas.DataFrame({"method": ["plateau", own], "factor": [5.0, 30.0]})
    searched = []
    monkeypatch.setattr(
        _plateau, "searched", lambda *given: searched.append(given[3]) or ({own: 30.0}, found)
    )
    asked = argparse.Namespace(starts=20, seconds=None, again=False, add=own)
    _plateau.compared("cup", tmp_path, asked)
    first = _plateau.TASKS["cup"].first
    assert searched == [(own,)]
    assert raced == [[("plateau", 3.0, first + n), (own, 30.0, first + n)] for n in range(5)]
    kept = pandas.read_csv(tmp_path / "plateau_cup_rates.csv")
    assert dict(zip(kept["method"], kept["factor"])) == {"plateau": 3.0, own: 30.0, "mitsuba": 1.0}


def test_rows_of_another_unit_are_not_added_to(monkeypatch, tmp_path):
    columns = {"method": ["plateau"], "trial": [1], "iterations": [9]}
    before = pandas.DataFrame({**columns, "start_mse": [193.3]})
    before.to_csv(tmp_path / "plateau_cup_runs.csv", index=False)
    monkeypatch.setattr(tables, "RESULTS", tmp_path)
    found = pandas.DataFrame({**columns, "start_mse": [1.0]})
    monkeypatch.setattr(tables, "finished", lambda folder: (found, []))
    monkeypatch.setattr(tables, "times", lambda *_: 1.0)
    monkeypatch.setattr(tables, "paces", lambda *_: 1.0)
    with pytest.raises(SystemExit, match="cup: errors at the start are others"):
        tables.write("cup", tmp_path, "plateau_renderer")


def test_cup_stands_beside_the_paper_in_its_unit():
    """20° · θ; what was not raced has no number, what our copy lacks none of the paper's."""
    made = {"image_mse": 1e-6, "parameter_mse": 4.0, "sorted_mse": 2.0, "pace": 8.0}
    rows = _plateau_paper.beside({task: {"plateau": made} for task in ("cup", "shadows", "sort")})
    errors = {row["task"].split(",")[0]: row["error"] for row in rows if row["column"] == "∂κP"}
    assert errors == {"cup": 0.01, "shadows": 4.0, "sort": 2.0}
    stock = {row["task"][:3]: row for row in rows if row["column"] == "Mitsuba"}
    assert stock["cup"]["times"] == pytest.approx(11.2) and stock["cup"]["ours"] is None
    assert stock["sor"]["parameters"] == "unreadable"


def test_the_authors_scene_has_an_image_error_where_its_table_has():
    table = pandas.read_csv(tables.RESULTS / "prdpt_shadows.csv").drop(
        columns="image_rmse", errors="ignore"
    )
    for own, image in ((table, None), (table.assign(image_rmse=0.25), 0.25)):
        buffer = io.StringIO(own.to_csv(index=False))
        assert {row["image"] for row in _page_plateau.authors(buffer)} == {image}


@pytest.mark.parametrize("task", _plateau.TASKS)
def test_methods_that_draw_pixels_have_the_same_of_them(task):
    own = _plateau.TASKS[task]
    for method in own.methods:
        cfg = _plateau.configured(task, method, 1, 1.0, 1.0)
        if method in _plateau.RENDERED:
            assert cfg.estimator.batch == own.pixels * own.spp
        else:
            assert (cfg.estimator.batch, cfg.estimator.spp) == (own.pixels, own.spp)
        if method.startswith("plateau"):
            whole = method in ("plateau_joint", "plateau_renderer")
            assert cfg.estimator.scheme == ("joint" if whole else own.scheme)
        assert (cfg.target.spp, cfg.optimizer.schedule) == (own.target_spp, own.schedule)


def raced(folder: Path) -> None:
    """Two starts; Mitsuba fails from the second, the third was interrupted."""
    ends = {("plateau", 1): 0.5, ("plateau", 2): 1.5, ("mitsuba", 1): 80.0, ("mitsuba", 2): 0.1}
    for (method, trial), end in ends.items():
        errors = [100.0, 50.0, end]
        synthetic_runs.write(
            folder / str(trial) / f"{method}_0.3_{trial}",
            [0.0, 5.0, 10.1],
            [0.2, 0.1, 0.01],
            errors,
            status="numerical failure" if (method, trial) == ("mitsuba", 2) else "done",
            settings={"scene.name": "cup", "budget.seconds": 10},
            columns={"parameter_rmse/cup.angle": errors},
        )
    shutil.copytree(folder / "1", folder / "3.unfinished")


def test_from_records_to_the_tables(tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "RESULTS", tmp_path / "results")
    tables.RESULTS.mkdir()
    raced(tmp_path / "starts")
    made = tables.write("cup", tmp_path / "starts").set_index("method")
    assert list(made["starts"]) == [2, 2] and list(made["failed"]) == [0, 1]
    ours, theirs = made.loc["plateau"], made.loc["mitsuba"]
    assert (ours["within_1_percent"], ours["within_5_percent"]) == (1, 2)
    assert (ours["share_of_start_low"], ours["share_of_start_high"]) == (0.005, 0.015)
    assert (ours["time_low"], ours["time_high"], ours["pace"]) == (1, 1, 1)
    assert ours["image_mse_low"] == pytest.approx(1e-4)
    # What the failed run left, though near, is nothing.
    assert theirs["within_1_percent"] == theirs["together_within_1_percent"] == 0
    assert theirs["share_of_start_low"] == 0.8
    lost = ("share_of_start", "image_mse", "parameter_mse", "together", "time")
    assert all(np.isinf(theirs[f"{name}_high"]) for name in lost)
    curves = pandas.read_csv(tables.RESULTS / "plateau_cup_curves.csv")
    own = curves[(curves["method"] == "plateau") & (curves["quartile"] == 0.25)].iloc[0]
    # An evaluation stands until the next; the last is the end's, though it came late.
    assert (own["0.00"], own["0.48"], own["0.52"], own["0.96"]) == (1, 1, 0.5, 0.5)
    assert own["1.00"] == pytest.approx(0.0075)  # a quarter of the way to the other start's
    rows = _page_plateau.overview({"cup": pandas.read_csv(tables.RESULTS / "plateau_cup.csv")})
    assert rows[-1] == "| cup, 10 s | 0.005, 1 of 2 | – | 0.8, 0 of 2 | – |"
    assert (tables.RESULTS / "plateau_errors.png").stat().st_size > 0


def test_a_race_of_other_settings_is_not_taken_for_this_one(tmp_path):
    (tmp_path / "rates").mkdir()
    (tmp_path / "rates" / "settings.yaml").write_text("of another day")
    with pytest.raises(SystemExit, match="rates: of other settings"):
        _plateau.race(tmp_path / "rates", "cup", [("plateau", 1.0, 1)], 1.0)
