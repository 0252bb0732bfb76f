"""isas from Python: what the README shows."""

from pathlib import Path

import numpy as np
import pytest

import isas_cli
from isas_cli.runtime.errors import InputError

SMALL = [
    *("scene=pottery", "size=tiny", "sampler=gradient", "budget.iterations=4", "frames.views=1"),
    *("frames.spp=2", "target.spp=4", "estimator.batch=256", "evaluation.pixels=256"),
    *("effects=full", "report=false"),
]
KEY = "jar.bsdf.base_color.data"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("api") / "run"
    return isas_cli.run(*SMALL, "prior=smoothness", f"hydra.run.dir={folder}")


def test_a_run_comes_back_as_its_record(run):
    assert run.complete and run.summary["status"] == "done"
    assert list(run.history["iteration"])[-1] == 4 and (run.history["prior"][1:] > 0).all()
    assert run.config["sampler"]["name"] == "gradient"
    found = run.parameters()[KEY]
    assert found.dtype == np.float32 and np.isfinite(found).all() and found.shape[2] == 3
    assert run.frame("result_v00").shape[2] == 3
    with pytest.raises(InputError, match="no such frame; did you mean 'result_v00'"):
        run.frame("result_v0")


def test_a_record_is_loaded_again(run):
    again = isas_cli.load(str(run.folder))
    assert again.summary == run.summary and again.history.equals(run.history)
    assert np.array_equal(again.parameters()[KEY], run.parameters()[KEY])
    with pytest.raises(InputError, match="no such run folder"):
        isas_cli.load(Path(run.folder) / "nothing")


def test_bad_settings_are_errors_of_one_line(tmp_path):
    with pytest.raises(InputError, match="did you mean 'pottery'") as refused:
        isas_cli.run("scene=potery")
    assert "\n" not in str(refused.value)
