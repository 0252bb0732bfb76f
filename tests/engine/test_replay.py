"""A run that ends for a number that is not finite says where it came from, and shows it again."""

import re
from pathlib import Path

import numpy as np
import pytest
from xml_for_tests import camera, paths

from isas_cli import records
from isas_cli.cli.app import main
from isas_cli.engine import experiment
from isas_cli.runtime import images

SCENE = f"""<scene version="3.0.0">{paths(3)}{camera(fov=20)}
  <emitter type="constant" id="sky"><rgb name="radiance" value="1"/></emitter>
  <shape type="rectangle" id="wall"><bsdf type="diffuse">
    <texture type="bitmap" name="reflectance">
      <string name="filename" value="wall.exr"/><boolean name="raw" value="true"/>
      <string name="filter_type" value="nearest"/>
    </texture>
  </bsdf></shape>
</scene>"""
SKY = "sky.radiance.value"


def run(folder: Path, wall: np.ndarray, *settings: str) -> int:
    images.write_exr(folder / "wall.exr", wall.astype(np.float32), [*"RGB"], {})
    (folder / "scene.xml").write_text(SCENE)
    unknown = f'scene.unknowns={{"{SKY}": {{"start": 0.5}}}}'
    common = ["scene=file", f"scene.path={folder / 'scene.xml'}", unknown, "sampler=uniform"]
    common += ["estimator.batch=256", "target.spp=4", "evaluation.pixels=64", "frames.views=0"]
    common += ["effects=full", "report=false", "budget.iterations=6", "evaluation.count=3"]
    return main(["run", *common, *settings, f"hydra.run.dir={folder / 'run'}"])


def test_it_names_unknown_iteration_and_pixel_and_can_be_had_again(tmp_path, capsys):
    """A wall whose right half reflects so much that residual times derivative overflows."""
    wall = np.full((16, 16, 3), 0.5)
    wall[:, 8:] = 1e30
    assert run(tmp_path, wall) == 3
    error = capsys.readouterr().err.strip().splitlines()[-1]
    print(error)
    assert f"of 3 entries of '{SKY}'" in error and f"isas replay {tmp_path / 'run'}" in error
    place = re.search(r"iteration (\d+) again.*view 0, column (\d+), row (\d+): gradient by", error)
    assert int(place[2]) >= 7 and int(place[3]) < 16
    kept = records.load(tmp_path / "run")
    assert kept.summary["status"] == "numerical failure"
    arrays, _ = records.load_checkpoint(tmp_path / "run")
    assert all(np.isfinite(array).all() for array in arrays.values())
    assert main(["replay", str(tmp_path / "run")]) == 3
    out = capsys.readouterr().out
    assert f"iteration {place[1]}," in out and "gradient by" in out and "paths to blame" in out
    assert main(["replay", str(tmp_path / "run"), "iteration=1"]) == 3
    assert "iteration 1," in capsys.readouterr().out


def test_paths_are_shown_whose_part_is_left_out(tmp_path, capsys):
    """What is no number at all is added to no gradient."""
    wall = np.full((16, 16, 3), 0.5)
    wall[:, 8:] = np.nan
    assert run(tmp_path, wall, "budget.iterations=2") == 0
    assert main(["replay", str(tmp_path / "run"), "iteration=1"]) == 3
    assert "128 paths to blame" in capsys.readouterr().out
    (told,) = [w for w in records.load(tmp_path / "run").summary["warnings"] if "of steps" in w]
    assert told.startswith("512 residuals"), "of both paths of a pixel, in two steps"


def test_of_a_loss_of_windows_the_pixels_of_these_are_named(tmp_path):
    wall = np.full((16, 16, 3), 0.5)
    wall[:, 8:] = np.nan
    assert run(tmp_path, wall, "budget.iterations=2", "loss=structure", "loss.side=3") == 0
    again = experiment.replay(tmp_path / "run", 1)
    columns = [place.column for place in again.places]
    assert len(columns) > 3 and min(columns) >= 8, "not what else is in their windows"


def test_a_sound_run_has_nothing_to_show(tmp_path, capsys):
    assert run(tmp_path, np.full((16, 16, 3), 0.5), "budget.iterations=2") == 0
    assert main(["replay", str(tmp_path / "run"), "iteration=1"]) == 0
    assert "to blame" not in capsys.readouterr().out


@pytest.mark.parametrize("which", ["iteration=-1", "3", "iteration=x", "iteration=1e9"])
def test_a_wrong_iteration_is_refused(which, tmp_path, capsys):
    assert main(["replay", str(tmp_path), which]) == 2
    assert "give iteration=N" in capsys.readouterr().err
    assert main(["replay", str(tmp_path)]) == 2
