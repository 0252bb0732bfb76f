"""A scene for each of Mitsuba's plugins, run in a process of its own: it is done, or refused in one
line, and never a traceback."""

import json
from pathlib import Path

import mitsuba as mi
import pytest
from _plugins import SCENES, write
from processes import isas

from isas_cli.runtime import backend
from isas_cli.runtime.errors import InputError
from isas_cli.scene import scene_file
from isas_cli.unknowns import parameters

# Those that Dr.Jit or Mitsuba treat unlike others.
FAST = "hair", "spot-textured", "sggx", "batch", "timed_sunsky"


@pytest.fixture(scope="module")
def scenes(tmp_path_factory) -> dict[str, Path]:
    with backend.loading():
        return write(tmp_path_factory.mktemp("plugins"))


def unknown(path: Path) -> str:
    """What can be differentiated by: of the thing on trial where it has any."""
    with backend.loading():
        params = mi.traverse(scene_file.load(str(path), None)[0])
    keys = [key for key in params.keys() if parameters.is_differentiable(params, key)]
    keys = [key for key in keys if not parameters.moves_geometry(params, key)]
    return min(keys, key=lambda key: "thing" not in key.split("."))


def ended(path: Path, folder: Path, key: str, *more: str) -> int:
    """A run of two iterations ends in status 0, or in 2 with a line of its own. Which."""
    unknowns = json.dumps({key: {"start": 0.4}})
    settings = [f"scene.path={path}", f"scene.unknowns={unknowns}", f"hydra.run.dir={folder}"]
    settings += ["scene=file", "sampler=uniform", "effects=full", "budget.iterations=2"]
    settings += ["target.spp=2", "frames.spp=2", "estimator.batch=256", "report=false", *more]
    done = isas(folder.parent, "run", *settings)
    assert done.returncode in (0, 2), done.stderr
    assert "Traceback" not in done.stderr
    if done.returncode == 2:
        assert done.stderr.splitlines()[-1].startswith("isas: "), done.stderr
    return done.returncode


@pytest.mark.parametrize(
    "name",
    [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in SCENES],
)
def test_a_plugin_is_run_or_refused(scenes, tmp_path, name):
    path = scenes[name]
    try:
        key = unknown(path)
    except InputError:  # the command says so as well
        key = "nothing"
    assert ended(path, tmp_path / "run", key) == 0 or name != "hair"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["thinlens", "orthographic", "area-textured", "tabphase"])
@pytest.mark.parametrize("method", ["sampler=ours", "sampler=plateau", "sampler=mitsuba", "probe"])
def test_what_is_hard_to_freeze_is_run_or_refused_by_other_methods(scenes, tmp_path, name, method):
    key = unknown(scenes[name])
    more = ["effects=auto", "sampler=uniform"] if method == "probe" else [method]
    ended(scenes[name], tmp_path / "run", key, *more)
