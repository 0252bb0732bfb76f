"""Every command as a user starts it: in a process of its own, where nothing has started Mitsuba."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from processes import isas
from xml_for_tests import camera, paths

from isas_cli.cli import app

SCENE = f"""<scene version="3.0.0">{paths(2)}{camera(width=12)}
<emitter type="constant"/><shape type="sphere" id="ball"><bsdf type="diffuse"/></shape></scene>"""
UNKNOWN = (
    'scene.unknowns={"ball.bsdf.reflectance.value": '
    '{"start": 0.3, "blur": {"start": 0.1, "end": 0.05}}}'
)
PROBLEM = ["scene=file", "scene.path=scene.xml", UNKNOWN]
SETTINGS = [*PROBLEM, "budget.iterations=2", "target.spp=2", "frames.spp=2", "estimator.batch=64"]
SETTINGS += ["effects=full", "report=false"]
ONE = [*SETTINGS, "sampler=uniform"]

# By command: what is typed after it, in the folder of a scene and of a run of it, ``run``, and what
# it prints or leaves there.
TYPED = {
    "run": [*ONE, "hydra.run.dir=another"],
    "race": [*SETTINGS, "samplers=[uniform,gradient]", "hydra.run.dir=race"],
    "variance": [*PROBLEM, "samplers=[uniform]", "repeats=2", "best=0", "hydra.run.dir=var"],
    "effects": [*PROBLEM, "effects=full"],
    "photos": ["chessboard", "output=sheet.png"],
    "compare": ["run", "--output", "compared"],
    "watch": ["run", "--once"],
    "scenes": [],
    "doctor": [],
    "replay": ["run", "iteration=1"],
    "landscape": ["run", "--spp", "1"],
    "report": ["run"],
    "export": ["run", "--output", "exported"],
    "relight": ["run", "set", "--spp", "4"],
    "unknowns": ["scene.xml"],
}
LEFT = {
    "run": "another/summary.json",
    "race": "race/comparison/report.html",
    "variance": "var/manifest.json",
    "photos": "sheet.png",
    "compare": "compared/report.html",
    "landscape": "run/landscape.csv",
    "report": "run/report.html",
    "export": "exported/scene.xml",
    "relight": "run/relit/scores.json",
}
SAID = {
    "effects": "effects of a run",
    "watch": "uniform",
    "scenes": "pottery",
    "doctor": "this machine can run isas",
    "replay": "iteration 1",
    "unknowns": "scene.unknowns",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    made = tmp_path_factory.mktemp("commands")
    (made / "scene.xml").write_text(SCENE)
    done = isas(made, "run", *ONE, "hydra.run.dir=run")
    assert done.returncode == 0, done.stderr
    # A picture of the ball from where the scene's camera is, alpha where it is.
    rows, columns = np.mgrid[:12, :12] - 5.5
    pixels = np.full((12, 12, 4), 90, np.uint8)
    pixels[..., 3] = 255 * (np.hypot(rows, columns) < 4.2)
    (made / "set").mkdir()
    Image.fromarray(pixels).save(made / "set/0.png")
    place = np.eye(4)
    place[2, 3] = 4
    frames = [{"file_path": "0.png", "transform_matrix": place.tolist()}]
    content = json.dumps({"camera_angle_x": 0.7, "frames": frames})
    (made / "set/transforms.json").write_text(content)
    return made


def test_every_command_is_tried():
    assert set(TYPED) == set(app._SUMMARIES) == {*LEFT, *SAID}


@pytest.mark.parametrize("command", TYPED)
def test_a_command_starts_by_itself(folder, command):
    done = isas(folder, command, *TYPED[command])
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    if command in LEFT:
        assert (folder / LEFT[command]).is_file()
    else:
        assert SAID[command] in done.stdout


# Each where nothing has imported Mitsuba; the last does so before it looks.
REFUSED = """
import sys
from isas_cli.cli import app
for command in ("export", "report", "landscape", "relight", "replay"):
    assert "mitsuba" not in sys.modules, command
    assert app.main([command, "nowhere", *["set"] * (command == "relight")]) == 2, command
"""


def test_a_folder_without_a_run_is_refused_in_one_line(folder):
    done = isas(folder, "-c", REFUSED, by=[sys.executable])
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"(isas: nowhere.*\n){5}", done.stderr)
