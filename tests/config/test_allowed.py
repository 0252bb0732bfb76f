"""A configuration or a record chooses no code: what isas ships, or a user allows, is imported."""

import shutil
import sys
from pathlib import Path

import pytest
import yaml

from isas_cli.cli.app import main
from isas_cli.config.compose import compose, instantiate
from isas_cli.runtime import allowed
from isas_cli.runtime.errors import InputError

TINY = ["scene=dodoco", "size=tiny", "sampler=uniform", "effects=full", "report=false"]
TINY += ["budget.iterations=1", "frames.views=0", "target.spp=2", "evaluation.pixels=16"]


@pytest.fixture
def trap(tmp_path, monkeypatch):
    """A module on the path that leaves a file when it is imported, under a name of its own."""
    name = f"trap_{tmp_path.name.replace('-', '_')}"
    text = f"open({str(tmp_path / 'sprung')!r}, 'w')\ndef build(**arguments): return {{}}\n"
    (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    return name


def sprung(tmp_path) -> bool:
    return (tmp_path / "sprung").exists()


def test_a_module_in_the_present_folder_is_found(trap, tmp_path, monkeypatch):
    """As `isas`, a script elsewhere, would not."""
    monkeypatch.setattr(sys, "path", [each for each in sys.path if each != str(tmp_path)])
    monkeypatch.setenv("ISAS_ALLOW", trap)
    assert allowed.named(f"{trap}.build", "isas_cli.scenes", "scene.builder")() == {}


def test_a_builder_of_nobodys_is_not_imported(trap, tmp_path, refused, monkeypatch):
    refused(["run", *TINY, f"scene.builder={trap}.build"], f"set ISAS_ALLOW={trap}")
    assert not sprung(tmp_path)
    monkeypatch.setenv("ISAS_ALLOW", f"other, {trap}")
    assert allowed.named(f"{trap}.build", "isas_cli.scenes", "scene.builder")() == {}
    assert sprung(tmp_path)


@pytest.mark.parametrize(
    "path, message",
    [
        ("os.system", "set ISAS_ALLOW=os "),
        ("system", "set ISAS_ALLOW=system "),
        ("", "set ISAS_ALLOW= "),
        ("isas_cli_evil.build", "set ISAS_ALLOW=isas_cli_evil "),
        ("isas_cli.cli.clean.main", "set ISAS_ALLOW=isas_cli.cli.clean "),
        ("isas_cli.scenes.pottery.Any", "names what another module defines"),
        ("isas_cli.scenes.nothing.build", "cannot be imported"),
        ("isas_cli.scenes.pottery.nothing", "cannot be imported"),
        ("isas_cli.scenes..build", "cannot be imported"),
    ],
)
def test_only_builders_are_builders(path, message):
    with pytest.raises(InputError, match=f"scene.builder={path}: .*{message}"):
        allowed.named(path, "isas_cli.scenes", "scene.builder")


@pytest.mark.parametrize(
    "target, message",
    [
        ("os.system", "ISAS_ALLOW=os"),
        ("isas_cli.runtime.cache.cached", "no choice of settings"),
        ("isas_cli.runtime.errors.InputError", "no choice of settings"),
        (None, "ISAS_ALLOW"),
    ],
)
def test_only_settings_are_instantiated(target, message):
    node = compose(["scene=dodoco"]).loss
    node["_target_"] = target
    with pytest.raises(InputError, match=f"loss._target_=.*{message}"):
        instantiate(node, "loss")


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("finished") / "run"
    assert main(["run", *TINY, f"hydra.run.dir={folder}"]) == 0
    return folder


@pytest.mark.parametrize("place", ["target", "tag", "builder"])
def test_a_records_configuration_runs_nothing(finished, place, tmp_path, refused, trap):
    folder = tmp_path / "run"
    shutil.copytree(finished, folder)
    config = yaml.safe_load((folder / "config.yaml").read_text())
    if place == "target":
        config["loss"]["_target_"] = f"{trap}.build"
    if place == "builder":
        config["scene"]["builder"] = f"{trap}.build"
    text = yaml.safe_dump(config)
    if place == "tag":
        text += f"extra: !!python/object/apply:{trap}.build []\n"
    (folder / "config.yaml").write_text(text)
    error = refused(["run", f"resume={folder}", "budget.iterations=2"])
    assert not sprung(tmp_path), error
