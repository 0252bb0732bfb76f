"""Ranges that lie apart, and rates at an end of those tried."""

import _page_plateau
import _ranges
import pandas
import pytest


@pytest.mark.parametrize(
    "own, side", [((1, 2), "below"), ((7, 9), "above"), ((2, 3), "level"), ((4, 5), "level")]
)
def test_where_a_range_lies(own, side):
    rows = ({"x_low": low, "x_high": high} for low, high in (own, (3, 6)))
    assert _ranges.apart(*rows, "x") == side


def test_best_rates_at_an_end_are_marked_by_scene_and_method():
    table = pandas.DataFrame(
        {"scene": ["a", "a", "b"], "method": ["m", "n", "m"], "factor": [1.0, 1.0, 1.0]}
    )
    rates = pandas.DataFrame(
        [("a", "m", f) for f in (0.3, 1.0, 3.0)]
        + [("a", "n", f) for f in (0.3, 1.0)]
        + [("b", "m", f) for f in (1.0, 3.0)],
        columns=["scene", "method", "factor"],
    )
    assert list(_ranges.marked(table, rates)["mark"]) == ["", r"\*", r"\*"]


def test_claims_of_a_task_hold_by_what_arrives():
    def row(left: float, within: int, error: float) -> dict:
        told = {"share_of_start": left, "within_1_percent": within, "starts": 5}
        return told | {"parameter_mse": error, "image_mse": error, "pace": 8.0, "mark": ""}

    def holds(cost: float = 8.0, nearer: int = 5, again: float = 0.2) -> dict[str, str]:
        paired = {"cup": {"nearer": nearer, "of": 5, "medians": [0.005, 0.3]}}
        claims = _page_plateau.claims(by, [], {"cup": cost}, paired, {"cup": [again, 0.5]})
        return {each["claim"].replace("its squared ", "")[:8]: each["holds"] for each in claims}

    by = {"cup": {"plateau": row(0.005, 4, 1e-6), "mitsuba": row(0.3, 0, 1e-5)}}
    by["cup"]["plateau_renderer"] = row(0.3, 0, 1e-5)
    found = {"arrives ": "yes", "paramete": "no", "image er": "no", "and does": "yes"}
    assert holds() == found | {"blurring": "yes", "an itera": "yes"}
    assert holds(again=0.005)["and does"] == "no"
    by["cup"]["mitsuba"] = row(0.005, 5, 1e-3)
    found = holds(cost=7.0, nearer=4)
    assert found["arrives "] == "no" and found["paramete"] == found["image er"] == "yes"
    # With as many pixels the other way than in the races; nearer from some starts alone.
    assert found["an itera"] == "depends on the paths" and found["blurring"] == "from 4 of 5 starts"
    by["sort"] = {name: each | {"filled": 60.0} for name, each in by["cup"].items()}
    for each in by["sort"].values():
        each |= {"filled_low": 60.0, "filled_high": 60.0}
    claims = _page_plateau.claims(by, [], {"cup": 8.0}, {}, {})
    unraced = [each["holds"] for each in claims if each["claim"].startswith("blurring")]
    assert unraced == ["cannot be told"] * 2


def test_of_sort_the_renderers_derivative_is_judged_by_places(tmp_path):
    names, share, unfilled = ("plateau", "plateau_renderer"), (1.0, 0.5), (12, 30)
    rows = [{"trial": 1, "method": m, "share_of_start": s} for m, s in zip(names, share)]
    rows = pandas.DataFrame(rows).assign(unfilled=unfilled)
    for task in ("cup", "sort"):
        rows.to_csv(tmp_path / f"plateau_{task}_runs.csv", index=False)
    nearer = [_page_plateau.beside_renderer(tmp_path, task)["nearer"] for task in ("cup", "sort")]
    assert nearer == [0, 1]


@pytest.mark.parametrize(
    ("first", "second", "holds"),
    [
        ((1.2, 1.1, 1.3), (1.5, 1.2, 1.9), True),
        ((1.2, 1.1, 1.3), (0.9, 0.8, 1.1), "at 0.35 of the budget alone"),
        ((0.8, 0.7, 0.9), (0.9, 0.8, 0.95), "no, the other way round"),
        ((0.8, 0.7, 1.1), (0.9, 0.8, 0.95), "level (intervals hold 1)"),
    ],
)
def test_variances_are_larger_where_their_intervals_say_so(first, second, holds):
    assert _page_plateau.larger({0.35: [*first], 0.9: [*second]}) == holds
