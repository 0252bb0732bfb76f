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
        return told | {"parameter_mse": error, "pace": 8.0, "mark": ""}

    def holds(cost: float = 8.0, nearer: int = 5) -> dict[str, str]:
        paired = {"cup": {"nearer": nearer, "of": 5, "medians": [0.005, 0.3]}}
        claims = _page_plateau.claims(by, [], {"cup": cost}, paired)
        return {each["claim"][:8]: each["holds"] for each in claims}

    by = {"cup": {"plateau": row(0.005, 4, 1e-6), "mitsuba": row(0.3, 0, 1e-5)}}
    by["cup"]["plateau_renderer"] = row(0.3, 0, 1e-5)
    found = {"arrives ": "yes", "its squa": "no", "blurring": "yes", "an itera": "yes"}
    assert holds() == found
    by["cup"]["mitsuba"] = row(0.005, 5, 1e-3)
    found = holds(cost=7.0, nearer=4)
    assert found["arrives "] == "no" and found["its squa"] == "yes"
    # With as many pixels the other way than in the races; nearer from some starts alone.
    assert found["an itera"] == "depends on the paths" and found["blurring"] == "from 4 of 5 starts"
