"""The wheel, built and installed elsewhere, is a working isas in any directory."""

import csv
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {"isas_cli": "isas_cli", "scenes": "isas_cli/scenes", "configs": "isas_cli/configs"}


def call(*command, cwd: Path) -> str:
    """Run a command away from the source tree; its output, or a failure that shows it."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=environment, text=True, capture_output=True
    )
    assert done.returncode == 0, f"{command}: {done.returncode}\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Built from a copy of the sources, without network: no stale build folder can leak in."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in PACKAGES:
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    options = ("--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", folder)
    call(sys.executable, "-m", "pip", "wheel", *options, source, cwd=folder)
    (built,) = folder.glob("isas-*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """bin folder of a new environment that holds the wheel and sees this one's other packages.

    Those are added with a .pth file. Python reads no .pth files in folders that it was given
    by one, so this environment's editable isas stays out.
    """
    home = tmp_path_factory.mktemp("elsewhere") / "environment"
    venv.create(home, with_pip=False)
    python = home / "bin" / "python"
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    packages = Path(call(python, "-c", ask, cwd=home).strip())
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    options = ("--no-deps", "--no-index", "--quiet")
    call(python, "-m", "pip", "install", "--ignore-installed", *options, wheel, cwd=home)
    return python.parent


def test_every_source_file_travels(wheel):
    packed = set(zipfile.ZipFile(wheel).namelist())
    for folder, target in PACKAGES.items():
        for file in (ROOT / folder).rglob("*"):
            # Pages are for readers of the repository.
            page = file.name == "README.md"
            if file.is_file() and "__pycache__" not in file.parts and not page:
                assert f"{target}/{file.relative_to(ROOT / folder).as_posix()}" in packed


def test_the_wheels_copy_is_the_one_that_is_imported(installed, tmp_path):
    code = (
        "import isas_cli, isas_cli.scenes; from importlib.resources import files; "
        "print(isas_cli.__file__, isas_cli.scenes.__file__, files('isas_cli.configs'), sep='\\n')"
    )
    for line in call(installed / "python", "-c", code, cwd=tmp_path).split("\n")[:3]:
        assert Path(line).is_relative_to(installed.parent)


def test_a_tiny_scene_runs_from_any_directory(installed, tmp_path):
    folder = tmp_path / "a run"
    overrides = ["scene=pottery", "size=tiny", "sampler=uniform", "effects=full", "target.spp=4"]
    overrides += ["frames.spp=2", "estimator.batch=256", "budget.iterations=3"]
    overrides += [f"hydra.run.dir='{folder}'"]
    call(installed / "isas", "run", *overrides, cwd=tmp_path)
    rows = list(csv.DictReader((folder / "history.csv").open()))
    assert int(rows[-1]["iteration"]) == 3
    assert json.loads((folder / "summary.json").read_text())["status"] == "done"
    assert [entry.name for entry in tmp_path.iterdir()] == [folder.name]
