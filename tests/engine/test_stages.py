"""Stages: light first, then materials, then both."""

import hard_cases
import pytest
from runs_for_tests import resumed

LIGHT, COLOUR = "sky.radiance.value", hard_cases.REFLECTANCE


def test_each_moves_in_its_stages_and_both_are_found(tmp_path):
    unknowns = {
        LIGHT: {"start": 0.5, "during": [0, 0.3, 0.6, 1]},
        COLOUR: {"start": 0.2, "during": [0.3, 1]},
    }
    case = hard_cases.Case("stages", "", unknowns, 0.05)
    history = case.run(tmp_path, "evaluation.count=40", "optimizer.lr=0.1").history
    errors = history.set_index("iteration")[[f"parameter_rmse/{k}" for k in unknowns]]
    errors.columns = ["light", "colour"]

    def still(name: str, begin: float, end: float) -> bool:
        rows = errors.loc[120 * begin : 120 * end, name]
        assert len(rows) > 3
        return rows.nunique() == 1

    assert still("colour", 0, 0.3) and not still("light", 0, 0.3)
    assert still("light", 0.3, 0.6) and not still("colour", 0.3, 0.6)
    assert not still("light", 0.6, 1) and not still("colour", 0.6, 1)
    assert errors.iloc[-1].max() == pytest.approx(0, abs=case.within)


def test_a_larger_budget_says_which_stages_come_again(tmp_path):
    unknowns = {
        LIGHT: {"start": 0.5, "during": [0, 0.5]},
        COLOUR: {"start": 0.2, "during": [0.5, 1]},
    }
    case = hard_cases.Case("stages", "", unknowns, 0.05)
    folder = case.run(tmp_path, "budget.iterations=4").folder
    warnings = resumed(folder, "budget.iterations=20").summary["warnings"]
    (told,) = [each for each in warnings if "the budget was iterations=4" in each]
    assert f"'{LIGHT}' began to move" in told and f"'{COLOUR}' came to rest" in told
