"""The table of the paper's claims: each verdict from numbers that call for it."""

from pathlib import Path

import _claims
import _contest
import pandas
import pytest


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


def test_time_to_an_error_counts_from_where_it_stays_below():
    history = pandas.DataFrame(
        {"seconds": [0, 1, 2, 3, 4], "parameter_rmse": [1.0, 0.2, 0.6, 0.2, 0.1]}
    )
    assert _contest.reached(history, 0.4) == pytest.approx(2.5)
    assert _contest.reached(history, 0.05) == float("inf")
    assert _contest.reached(history, 2.0) == 0
