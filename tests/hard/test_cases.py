"""Hard cases end to end: see ``support/hard_cases.py``."""

import drjit as dr
import hard_cases
import numpy as np
import pytest

from isas_cli.estimators.two_path import TwoPath
from isas_cli.runtime.errors import InputError

PLAIN = hard_cases.CASES[0]


@pytest.mark.parametrize("case", hard_cases.everywhere(), ids=lambda case: case.name)
def test_it_stays_stable(case, tmp_path):
    run = case.run(tmp_path)
    history = run.history
    first, last = history.iloc[0], history.iloc[-1]
    print(f"{case.name}: parameter error {last.parameter_rmse:.4g}, loss {last.loss:.4g}")
    assert run.summary["status"] == "done" and len(history) >= 4
    assert np.isfinite(history[["loss", "image_rmse", "parameter_rmse"]]).all(axis=None)
    for key, array in run.parameters().items():
        low, high = run.manifest["unknowns"][key]["range"]
        assert np.isfinite(array).all()
        assert (low is None or array.min() >= low) and (high is None or array.max() <= high)
    assert last.parameter_rmse <= case.within, case.provokes
    assert all(last[column] <= bound for column, bound in case.below.items()), case.below
    warnings = run.summary["warnings"]
    # What is said to be no result need not be one, and a loss that was noise alone goes either way.
    assert warnings or first.loss <= 0 or last.loss <= first.loss * 1.01
    assert last.nonfinite == 0
    told = case.warns.split("|")
    assert all(any(word in w for word in told) for w in warnings), warnings
    assert bool(warnings) == bool(case.warns) or not case.sure, warnings


def test_a_gradient_that_is_no_number_for_one_iteration_costs_that_iteration(tmp_path, monkeypatch):
    honest = TwoPath.estimate

    def once(self, values, distribution, seed, iteration, spent):
        found = honest(self, values, distribution, seed, iteration, spent)
        return {k: g * dr.nan for k, g in found.items()} if iteration == 50 else found

    monkeypatch.setattr(TwoPath, "estimate", once)
    run = PLAIN.run(tmp_path)
    last = run.history.iloc[-1]
    assert last.parameter_rmse <= PLAIN.within and last.nonfinite == 3


def test_a_scene_without_light_is_refused(tmp_path):
    """A black environment: every residual and every gradient would be 0."""
    dark = np.zeros((16, 32, 3))
    case = hard_cases.Case(
        "no light", "", hard_cases.GREY_FROM, 0, emitter=hard_cases.MAP, sky=dark
    )
    with pytest.raises(InputError, match="no view sees it"):
        case.run(tmp_path)


def test_what_no_image_tells_is_said(tmp_path):
    """A plateau without end: the object is out of sight wherever its blur puts it."""
    turn = {"kind": "translation", "objects": ["thing"], "directions": [[1, 0, 0]]}
    case = hard_cases.Case(
        *("out of sight", "", {"shift": {"start": 50.0, "blur": {"start": 1.0, "end": 0.1}}}, 0),
        shapes=hard_cases.PLATE,
        poses={"shift": turn},
        settings=hard_cases.BLURRED,
    )
    run = case.run(tmp_path)
    assert run.parameters()["shift"].tolist() == [50.0]
    assert any("'shift' had no gradient in any step" in w for w in run.summary["warnings"])


@pytest.mark.slow
def test_a_hundred_thousand_steps_neither_drift_nor_grow(tmp_path):
    run = PLAIN.run(tmp_path, "budget.iterations=100000", "estimator.batch=64")
    late = run.history.iloc[-1]
    assert late.iteration == 100_000 and late.parameter_rmse <= PLAIN.within
    assert late.nonfinite == 0
