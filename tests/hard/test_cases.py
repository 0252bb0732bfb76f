"""Hard cases end to end: see ``support/hard_cases.py``."""

import hard_cases
import numpy as np
import pytest

import isas_cli
from isas_cli.runtime.errors import NumericalError


@pytest.mark.parametrize("case", hard_cases.CASES, ids=lambda case: case.name)
def test_it_stays_stable(case, tmp_path):
    if case.ends:
        with pytest.raises(NumericalError, match=r"not finite.*view 0, column \d+, row \d+"):
            case.run(tmp_path)
        run = isas_cli.load(tmp_path / "run")
        assert run.summary["status"] == "numerical failure"
        assert all(np.isfinite(array).all() for array in run.parameters().values())
        return
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
    assert last.loss <= first.loss * 1.01
    assert last.nonfinite == 0 and not run.summary["warnings"]
