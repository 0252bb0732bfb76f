"""isas from Python: what the README shows."""

from pathlib import Path

import drjit as dr
import numpy as np
import pytest
from hydra import compose as hydra_compose
from hydra import initialize_config_dir, version
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig

import isas_cli
from isas_cli.cli import one
from isas_cli.cli.run import folder_of
from isas_cli.engine import experiment
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


def test_records_have_a_type(run):
    assert "Run" in isas_cli.__all__ and type(run) is isas_cli.Run
    assert not hasattr(isas_cli, "Runs")


def test_a_record_is_loaded_again(run):
    again = isas_cli.load(str(run.folder))
    assert again.summary == run.summary and again.history.equals(run.history)
    assert np.array_equal(again.parameters()[KEY], run.parameters()[KEY])
    with pytest.raises(InputError, match="no such run folder"):
        isas_cli.load(Path(run.folder) / "nothing")


def test_a_record_stays_where_it_is_when_the_program_goes_elsewhere(run, tmp_path, monkeypatch):
    monkeypatch.chdir(run.folder.parent)
    again = isas_cli.load(run.folder.name)
    monkeypatch.chdir(tmp_path)
    assert again.folder == run.folder and again.parameters().keys() == run.parameters().keys()


def test_a_program_that_uses_hydra_itself_keeps_what_it_has_there(tmp_path, monkeypatch):
    (tmp_path / "config.yaml").write_text("mine: 1\n")
    monkeypatch.setattr(one, "run", lambda cfg, folder: 0)
    monkeypatch.setattr(HydraConfig.instance(), "cfg", None)
    with initialize_config_dir(str(tmp_path), version_base="1.2", job_name="theirs"):
        known = GlobalHydra.instance()
        HydraConfig.instance().set_config(hydra_compose("config", return_hydra_config=True))
        before = [known.hydra, HydraConfig.instance().cfg, version.getbase()]
        assert folder_of(["scene=dodoco", "hydra.run.dir=here"]) == "here"
        assert GlobalHydra.instance() is known
        after = [known.hydra, HydraConfig.instance().cfg, version.getbase()]
        assert [id(each) for each in after] == [id(each) for each in before]
        assert hydra_compose("config").mine == 1
        assert hydra_compose("config", return_hydra_config=True).hydra.job.name == "theirs"


def test_bad_settings_are_errors_of_one_line(tmp_path):
    with pytest.raises(InputError, match="did you mean 'pottery'") as refused:
        isas_cli.run("scene=potery")
    assert "\n" not in str(refused.value)


def test_settings_that_are_no_texts_are_refused():
    for wrong in (SMALL, {"scene": "pottery"}, Path("a")):
        with pytest.raises(InputError, match="give texts"):
            isas_cli.run(wrong)


def test_a_process_makes_one_run_at_a_time(monkeypatch):
    def within(settings):
        with pytest.raises(InputError, match="another run goes on in this process"):
            isas_cli.run(*settings)
        raise KeyboardInterrupt

    monkeypatch.setattr("isas_cli.cli.run.folder_of", within)
    for _ in range(2):  # the first was broken off
        with pytest.raises(KeyboardInterrupt):
            isas_cli.run("scene=pottery")


def test_a_run_that_is_broken_off_leaves_its_scene_as_it_was_loaded(tmp_path, monkeypatch):
    """Of its gradients other scenes would hear, and of its values who holds its objects."""
    left = []

    def broken(recorder, begin):
        left.append(recorder.loop.problem.unknowns)
        left[0].attach(left[0].starts())
        raise KeyboardInterrupt

    monkeypatch.setattr(experiment, "_go", broken)
    with pytest.raises(KeyboardInterrupt):
        isas_cli.run(*SMALL, f"hydra.run.dir={tmp_path / 'run'}")
    (unknowns,) = left
    assert not any(map(dr.grad_enabled, unknowns.leaves.values()))
    found = unknowns.arrays(unknowns.leaves)[KEY]
    np.testing.assert_array_equal(found, unknowns[KEY].truth)
    assert not np.array_equal(found, unknowns[KEY].start)
