"""The table of the paper's claims: each verdict from numbers that call for it."""

import math
import subprocess
from pathlib import Path

import _claims
import _contest
import _overview
import pandas
import pytest
import reproduce
import synthetic_runs
import yaml

from isas_cli.runtime.errors import NumericalError


def rows(tmp_path: Path, scene: str, measure: str = "parameter_rmse", **samplers) -> None:
    """A table of (median, low, high, share of the start) per sampler."""
    columns = [measure, f"{measure}_low", f"{measure}_high", "share_of_start"]
    made = [{"sampler": name, **dict(zip(columns, v))} for name, v in samplers.items()]
    if measure != "parameter_rmse":
        for row in made:
            row["parameter_rmse"] = 1.0
    pandas.DataFrame(made).to_csv(tmp_path / f"{scene}.csv", index=False)


def judged(tmp_path: Path, figure: str, scene: str) -> tuple[str, str]:
    """Measurement and verdict in the row of ``figure`` that speaks of ``scene``."""
    for line in _claims.lines(tmp_path):
        cells = [cell.strip() for cell in line.split(" | ")]
        if cells[0] == f"| {figure}" and scene in cells[2]:
            return cells[2], cells[3].rstrip(" |")
    raise AssertionError(f"no row of figure {figure} about {scene}")


@pytest.mark.parametrize(
    ("ours", "verdict"),
    [((1, 0.9, 1.1), "yes"), ((3, 2.6, 3.1), "no"), ((2, 1.6, 2.2), "level (ranges overlap)")],
)
def test_better_means_that_the_seeds_ranges_lie_apart(ours, verdict, tmp_path):
    rows(tmp_path, "bowl", ours=(*ours, 0.5), uniform=(2, 1.5, 2.5, 0.5))
    assert judged(tmp_path, "9", "bowl")[1] == f"parameters: `uniform` {verdict}"


def test_the_image_is_judged_by_itself(tmp_path):
    made = {"parameter_rmse": [1.0, 2.0], "image_rmse": [4.0, 3.0]}
    for measure, values in list(made.items()):
        made |= {f"{measure}_low": [0.9 * v for v in values], f"{measure}_high": values}
    table = pandas.DataFrame({"sampler": ["ours", "uniform"], **made})
    table.to_csv(tmp_path / "bowl.csv", index=False)
    assert judged(tmp_path, "9", "bowl")[1] == "parameters: `uniform` yes; image: `uniform` no"


def test_where_the_least_is_below_noise_none_is_best(tmp_path):
    made = {"sampler": ["ours", "uniform"]}
    for end, values in (("", [0, 0.3]), ("_low", [0, 0.2]), ("_high", [0.1, 0.4])):
        made |= {f"parameter_rmse{end}": [1.0, 2.0], f"image_rmse{end}": values}
    table = pandas.DataFrame(made)
    table.to_csv(tmp_path / "bowl.csv", index=False)
    words = judged(tmp_path, "9", "bowl")[0]
    assert "image: `ours` below noise [0.0000, 0.1000]" in words
    assert words.endswith("best: cannot be told") and "best: `ours` 1.0000" in words
    by = table.set_index("sampler")
    cells = [_overview._error(by, name, "image_rmse") for name in ("ours", "uniform")]
    assert cells == ["below noise [0.000, 0.100]", "0.300 [0.200, 0.400]"]


def test_what_was_not_run_is_said(tmp_path):
    assert judged(tmp_path, "9", "bowl") == ("bowl: not run yet", "–")
    rows(tmp_path, "bowl", ours=(1, 1, 1, 0.5))
    assert judged(tmp_path, "9", "bowl") == ("bowl: no run of `uniform`", "–")
    rows(tmp_path, "multires", ours=(1, 1, 1, 0.5), multiresolution=(1, 1, 1, 0.5))
    assert judged(tmp_path, "5", "multires")[1] == "–"


@pytest.mark.parametrize(
    ("uniform", "ours", "verdict"),
    [
        (0.95, 0.02, "yes"),
        (0.5, 0.02, "in part: `ours` converges, `uniform` is not stuck"),
        (0.5, 0.4, "no: `ours` does not converge, `uniform` is not stuck"),
        (0.5, 0.5, "cannot be told: where either ends is chance, their ranges overlap"),
    ],
)
def test_a_small_budget(uniform, ours, verdict, tmp_path):
    rows(tmp_path, "trashcan", ours=(*[ours] * 3, ours), uniform=(*[uniform] * 3, uniform))
    assert judged(tmp_path, "6", "trashcan")[1] == verdict


@pytest.mark.parametrize(("with_", "verdict"), [((1, 0.9, 1.1), "yes"), ((2, 1, 3), "level")])
def test_levels_are_judged_by_the_texture(with_, verdict, tmp_path):
    key = "parameter_rmse/cake.bsdf.base_color.data"
    rows(tmp_path, "multires", key, multiresolution=(*with_, 1), ours=(2, 1.5, 2.5, 1))
    words, found = judged(tmp_path, "5", "multires")
    assert found.startswith(verdict) and words.startswith("multires: cake ")


def test_every_figure_of_the_paper_has_a_row():
    assert {str(number) for number in range(1, 10)} < {each.figure for each in _claims.CLAIMS}


@pytest.mark.parametrize(("bin", "verdict"), [(0.3, "most do, but with it as well"), (0.1, "yes")])
def test_where_draws_go_is_judged_by_what_the_scheme_changes(bin, verdict, tmp_path):
    table = {"scene": ["multires"] * 3, "object": ["bin", "cake", "all else"], "pixels": [0.2] * 3}
    shares = {"ours": [0.4, 0.1, 0.5], "multiresolution": [bin, 0.1, 0.9 - bin]}
    pandas.DataFrame(table | shares).to_csv(tmp_path / "draws.csv", index=False)
    words, found = _claims._drawn(tmp_path)
    assert "bin has 80% without" in words and found == verdict


@pytest.mark.parametrize(("least", "verdict"), [(0.2, "yes: no bias seen"), (0.01, "no")])
def test_of_several_means_one_may_be_off_by_chance(least, verdict, tmp_path):
    table = {"sampler": ["uniform", "gradient", "ours"], "bias_z": [None, 0.5, 1.0]}
    table = pandas.DataFrame(table | {"bias_p": [None, 0.6, least]})
    table.to_csv(tmp_path / "variance_dodoco.csv", index=False)
    assert _claims._unbiased(tmp_path) == (
        "dodoco: means of 2 densities against uniform pixels': z 0.5 to 1.0",
        verdict,
    )


@pytest.mark.parametrize(("low", "verdict"), [(1.1, "yes"), (0.9, "yes, but for roughness 0.8")])
def test_directions_for_the_derivative_are_judged_by_their_intervals(low, verdict, tmp_path):
    table = {"roughness": [0.8, 0.2], "loss_variance": [1.2, 6.0], "loss_low": [low, 4.0]}
    pandas.DataFrame(table).to_csv(tmp_path / "derivative_sampling.csv", index=False)
    words, found = _claims._differential(tmp_path)
    assert words.endswith("by roughness: 1.2 (0.8), 6.0 (0.2)") and found == verdict


@pytest.mark.parametrize(
    ("low", "high", "verdict"), [(1.0, 1.4, "yes"), (2.5, 3.0, "no"), (1.5, 2.5, "level")]
)
def test_a_density_is_near_the_best_by_its_interval(low, high, verdict, tmp_path):
    ratio = "ratio_to_best"
    table = {"sampler": ["ours"], ratio: [2.0], f"{ratio}_low": [low], f"{ratio}_high": [high]}
    pandas.DataFrame(table).to_csv(tmp_path / "variance_dodoco.csv", index=False)
    assert _claims._densities(tmp_path)[1] == verdict


def test_time_to_an_error_counts_from_where_it_stays_below():
    history = pandas.DataFrame(
        {"seconds": [0, 1, 2, 3, 4], "parameter_rmse": [1.0, 0.2, 0.6, 0.2, 0.1]}
    )
    assert _contest.reached(history, 0.4) == pytest.approx(2.5)
    assert _contest.reached(history, 0.05) == float("inf")
    assert _contest.reached(history, 2.0) == 0


def test_a_run_that_failed_has_no_result(tmp_path):
    errors = [0, 1, 2], [1.0, 0.5, 0.25], [2.0, 1.0, 0.5]
    done = _contest.counted(synthetic_runs.run(tmp_path / "1", *errors))
    failed = synthetic_runs.run(tmp_path / "2", *errors, status=NumericalError.ended)
    history = _contest.counted(failed).history
    measures = ["image_rmse", "parameter_rmse"]
    assert done.history[measures].iloc[-1].tolist() == [0.25, 0.5]
    assert history[measures].iloc[-2:].values.tolist() == [[0.5, 1.0], [math.inf, math.inf]]
    assert _contest.reached(history, 1.0) == math.inf == _contest.reached(history, math.inf)
    settings = {"target.noise": 0.02}
    for name, status in (("a", "done"), ("b", NumericalError.ended)):
        synthetic_runs.write(tmp_path / "race" / name, *errors, status=status, settings=settings)
    assert reproduce.runs(tmp_path / "race")["final"].tolist() == [0.5, math.inf]


def test_a_race_with_a_failed_contestant_is_told(tmp_path, monkeypatch):
    for name, status in (("ours", "done"), ("uniform", NumericalError.ended)):
        error = [1.0, 0.5]
        synthetic_runs.write(tmp_path / name, [0, 1], error, error, sampler=name, status=status)
    planned = {"entries": [{"folder": "ours"}, {"folder": "uniform"}]}
    (tmp_path / "race.yaml").write_text(yaml.safe_dump(planned))
    statuses = iter((NumericalError.status, 2))
    ended = lambda command, **_: subprocess.CompletedProcess(command, next(statuses))
    monkeypatch.setattr(_contest.subprocess, "run", ended)
    both = [(name, {"sampler": name}) for name in ("ours", "uniform")]
    asked = "dodoco", tmp_path, [], both, [1], 1.0
    found = _contest.race(*asked, lambda run: {"end": run.history["image_rmse"].iloc[-1]})
    assert found["end"].tolist() == [0.5, math.inf]
    with pytest.raises(subprocess.CalledProcessError):
        _contest.race(*asked, lambda run: {})
