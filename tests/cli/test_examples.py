"""The scripts under examples/, as they stand, at tiny sizes."""

import importlib.util
from pathlib import Path

from isas_cli.records import load

EXAMPLES = Path(__file__).parents[2] / "examples"
FEW = ["budget.iterations=3", "effects=full", "report=false", "frames.views=0", "target.spp=2"]
FEW += ["evaluation.pixels=64", "evaluation.count=3", "estimator.batch=256"]


def script(name: str):
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_scene_of_one_s_own(tmp_path, capsys):
    own = script("own_scene")
    run = own.main(*FEW, f"hydra.run.dir={tmp_path / 'run'}")
    assert set(run.parameters()) == {own.COLOUR, own.ROUGHNESS}
    assert f"{own.ROUGHNESS}: [" in capsys.readouterr().out
    assert run.history.iteration.iloc[-1] == 3


def test_a_race_to_its_plot(tmp_path):
    race = script("race")
    plot = race.main(tmp_path / "race", "size=tiny", *FEW)
    assert plot.stat().st_size > 1000
    found = {load(path.parent).config["sampler"]["name"] for path in tmp_path.rglob("summary.json")}
    assert found == set(race.SAMPLERS)


def test_a_renderer_that_is_not_mitsuba(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(EXAMPLES)
    monkeypatch.delenv("ISAS_ALLOW", raising=False)
    box = script("black_box")
    monkeypatch.setenv("ISAS_ALLOW", "")  # put back at the end, whatever the script sets
    run = box.main(*FEW, f"hydra.run.dir={tmp_path / 'run'}")
    assert set(run.parameters()) == set(box.TRUTH)
    assert "radius: " in capsys.readouterr().out
