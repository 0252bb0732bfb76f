"""Parts from outside: an installed package's, and those of a folder that is named."""

import importlib.util
import json
import os
import shutil
import site
import subprocess
import sys
import venv
from pathlib import Path

import pytest
import yaml
from isas_cli.scenes.library import ASSETS

import isas_cli
from isas_cli import records
from isas_cli.cli.app import main
from isas_cli.cli.sweeps import race
from isas_cli.config import searchpath
from isas_cli.config.compose import compose, translate
from isas_cli.config.method import options
from isas_cli.runtime import allowed, guests
from isas_cli.runtime.errors import InputError

EXAMPLE = Path(__file__).parents[2] / "examples/plugin"
TINY = ["size=tiny", "effects=full", "report=false", "budget.iterations=2", "frames.views=0"]
TINY += ["target.spp=2", "evaluation.pixels=16", "estimator.batch=256"]
# What the example has none of: a prior, and a format of cameras.
PRIOR = """
from dataclasses import dataclass
from isas_cli.losses.priors import OnUnknowns, Prior

class Level(OnUnknowns):
    def __init__(self, height):
        self.height = height

    def value(self, values):
        return self.height

    def add(self, values, gradients):
        return gradients

@dataclass(frozen=True)
class Settings(Prior):
    height: float = 1.0

    def on(self, unknowns):
        return Level(self.height)
"""
CAMERAS = """
from isas_cli.scene.photos.ours import read

def claims(file):
    return file.name == "mine.rig"

def find(folder):
    return next(filter(claims, folder.iterdir()), None)
"""
ENTRIES = "[isas.configs]\nlevel = level.configs\n[isas.cameras]\nlevel = level.cameras\n"
SECOND = {
    "level/__init__.py": "",
    "level/prior.py": PRIOR,
    "level/cameras.py": CAMERAS,
    "level/configs/__init__.py": "",
    "level/configs/prior/level.yaml": "# so high\n_target_: level.prior.Settings\nheight: 1.0\n",
    "level-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: level\nVersion: 1.0\n",
    "level-1.0.dist-info/entry_points.txt": ENTRIES,
}


@pytest.fixture
def folder(tmp_path):
    """With a loss of its own settings, and a scene that is another by its builder's arguments."""
    made = tmp_path / "mine"
    (made / "loss").mkdir(parents=True)
    (made / "scene").mkdir()
    soft = "# softer\nname: soft\n_target_: isas_cli.losses.RelativeL2\nepsilon: 0.5\n"
    (made / "loss/soft.yaml").write_text(soft)
    scene = yaml.safe_load((Path(searchpath.files("scene")["dodoco"])).read_text())
    scene |= {"name": "small", "description": "small"}
    (made / "scene/small.yaml").write_text(yaml.safe_dump(scene))
    return made


def test_a_folder_s_choices_are_found_by_every_command(
    folder, tmp_path, capsys, monkeypatch, no_plots
):
    monkeypatch.chdir(tmp_path)
    flag = ["--config-dir", str(folder)]
    chosen = ["scene=small", "sampler=uniform", "loss=soft", *TINY]
    assert main(["run", *flag, *chosen, "hydra.run.dir=run"]) == 0
    assert records.load(Path("run")).config["loss"]["epsilon"] == 0.5
    # A record says all: it needs the folder no more.
    assert main(["run", "resume=run", "budget.iterations=3"]) == 0
    assert main(["run", "scene=small", "hydra.run.dir=other"]) == 2
    assert "scene=small: no such scene" in capsys.readouterr().err
    race = ["race", *chosen[:1], *chosen[2:], "samplers=[uniform,relevant]", "hydra.run.dir=race"]
    assert main([*race, f"hydra.searchpath=[file://{folder}]"]) == 0
    sweep = [f"--config-dir={folder}", "-m", *chosen, "seed=2", "hydra.sweep.dir=sweep"]
    assert main(["run", *sweep]) == 0
    assert len(list(Path("sweep").rglob("summary.json"))) == 1
    capsys.readouterr()
    assert main(["scenes", *flag]) == 0
    told = capsys.readouterr().out
    assert "small" in told and "softer" in told
    assert main(["run", *flag, *chosen, "--cfg", "job"]) == 0
    assert "epsilon: 0.5" in capsys.readouterr().out
    found = isas_cli.run(f"hydra.searchpath=[{folder}]", *chosen, "hydra.run.dir=python")
    assert found.config["loss"]["epsilon"] == 0.5
    assert searchpath.VARIABLE not in os.environ


def test_names_are_asked_where_the_choices_lie(folder, monkeypatch):
    assert "soft" not in options("loss")
    monkeypatch.setenv(searchpath.VARIABLE, str(folder))
    assert "soft" in options("loss")
    assert compose(translate(["scene=small", "loss=soft"])).loss.epsilon == 0.5
    with pytest.raises(InputError, match="loss=sofd: no such loss; did you mean 'soft'"):
        compose(translate(["scene=small", "loss=sofd"]))


def test_a_choice_is_called_as_its_file_is(folder, monkeypatch):
    monkeypatch.setenv(searchpath.VARIABLE, str(folder))
    (folder / "loss/soft.yaml").write_text("_target_: isas_cli.losses.RelativeL2\n")
    scene = yaml.safe_load((folder / "scene/small.yaml").read_text())
    del scene["name"]
    (folder / "scene/small.yaml").write_text(yaml.safe_dump(scene))
    cfg = compose(translate(["scene=small", "loss=soft"]), hydra=True)
    assert cfg.loss.name == "soft" and cfg.hydra.run.dir.startswith("runs/small/progress/")
    (folder / "sampler").mkdir()
    mine = "defaults: [ours, _self_]\n_target_: isas_cli.samplers.gradient.Gradient\n"
    (folder / "sampler/mine.yaml").write_text(mine)
    base = ["sampler=multiresolution", "sampler.base=mine"]
    for choice, words in (("sampler", ["sampler=mine"]), ("sampler.base", base)):
        with pytest.raises(InputError, match=rf"^{choice}=mine: its file says name: ours.*mine"):
            compose(translate(["scene=small", *words]))
    (folder / "sampler/mine.yaml").write_text(f"{mine}name: mine\n")
    assert compose(translate(["scene=small", "sampler=mine"])).sampler.name == "mine"


@pytest.mark.parametrize("written", ["{}", "[{}]", "['{}']"])
def test_a_folder_s_name_may_end_in_a_bracket(folder, written):
    place = folder.rename(folder.with_name("exp[2]"))
    with searchpath.asked([f"hydra.searchpath={written.format(place)}"]):
        assert searchpath.typed() == [str(place)]


def test_two_of_one_name_are_refused(folder, capsys):
    (folder / "loss/l2.yaml").write_text("name: l2\n")
    assert main(["scenes", "--config-dir", str(folder)]) == 2
    error = capsys.readouterr().err
    assert f"loss=l2 is in isas itself and in {folder}: rename one" in error
    assert main(["run", "--config-dir", str(folder), "scene=dodoco", "loss=l2"]) == 2
    assert f"loss=l2 is in isas itself and in {folder}: rename one" in capsys.readouterr().err


def test_a_scene_s_own_method_may_choose_a_filter(folder, monkeypatch):
    file = folder / "scene/small.yaml"
    scene = yaml.safe_load(file.read_text()) | {"method": {"optimizer": {"filter": "gaussian"}}}
    file.write_text(yaml.safe_dump(scene))
    monkeypatch.setenv(searchpath.VARIABLE, str(folder))
    assert compose(translate(["scene=small"])).optimizer.filter.name == "gaussian"
    typed = ["scene=small", "optimizer.filter=none"]
    assert compose(translate(typed)).optimizer.filter.name == "none"


@pytest.mark.parametrize("flag", [["--config-dir", "nowhere"], ["--config-dir"], ["-cd", "a,b"]])
def test_a_folder_that_is_none_is_refused_in_one_line(flag, refused):
    Path("a,b").mkdir()
    assert refused(["scenes", *flag]).startswith(f"isas: {flag[0]}=")


def test_a_folder_chooses_no_code(folder, refused):
    """Only what is installed is trusted."""
    (folder / "loss/soft.yaml").write_text("name: soft\n_target_: os.path.join\n")
    command = ["run", "--config-dir", str(folder), "scene=small", "loss=soft", "hydra.run.dir=r"]
    refused(command, "would import code that is not isas's own")


def test_an_entry_point_that_cannot_be_imported_names_its_package(tmp_path, monkeypatch):
    info = tmp_path / "broken-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[isas.kinds]\nworse = not_there.at_all:Kind\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delenv(guests.ALLOW)
    guests.points.cache_clear()
    try:
        assert guests.installed() == {"broken": "1.0"}
        with pytest.raises(InputError, match=r"^broken 1.0: entry point worse of isas.kinds"):
            guests.loaded(guests.KINDS)
        with pytest.raises(InputError, match="cannot be imported"):
            allowed.named("not_there.Kind", "isas_cli", "loss._target_")
    finally:
        monkeypatch.undo()
        guests.points.cache_clear()


def test_changed_code_is_another_version(tmp_path, monkeypatch):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/__init__.py").write_text("")
    (tmp_path / "mine/dark.py").write_text("POWER = 1\n")
    info = tmp_path / "mine-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[isas.configs]\nmine = mine\n")
    monkeypatch.syspath_prepend(tmp_path)
    found = []
    for power in (1, 2, 1):
        (tmp_path / "mine/dark.py").write_text(f"POWER = {power}\n")
        guests.points.cache_clear()
        guests._digest.cache_clear()
        found.append(guests.installed()["mine"])
    monkeypatch.undo()
    guests.points.cache_clear()
    assert found[0] == found[2] != found[1] and all(each.startswith("1.0+") for each in found)


def test_changed_code_that_is_allowed_is_another_version(tmp_path, monkeypatch):
    """Of a module that this process has imported; programs have none."""
    monkeypatch.setenv(guests.ALLOW, "loss_of_mine.Loss, ./draw, no_such")
    name, file = "loss_of_mine", tmp_path / "loss_of_mine.py"
    file.touch()
    monkeypatch.syspath_prepend(tmp_path)
    guests._digest.cache_clear()
    assert guests.installed() == {}
    spec = importlib.util.spec_from_file_location(name, file)
    monkeypatch.setitem(sys.modules, name, importlib.util.module_from_spec(spec))
    found = []
    for power in (1, 2, 1):
        file.write_text(f"POWER = {power}\n")
        guests._digest.cache_clear()
        found.append(guests.installed())
    assert all(each.keys() == {"loss_of_mine"} for each in found)
    assert found[0] == found[2] != found[1]


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """Runs isas in an environment of its own that has the example and a second guest beside it: →
    what was printed."""
    root = tmp_path_factory.mktemp("guest")
    venv.create(root / "venv", with_pip=False)
    python = root / "venv/bin/python"
    lib = next((root / "venv/lib").glob("python*")) / "site-packages"
    # What is installed here is there as well.
    (lib / "here.pth").write_text(f"import site; site.addsitedir({site.getsitepackages()[0]!r})\n")
    install = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps"]
    subprocess.run([*install, "--no-build-isolation", str(_copied(root))], check=True)
    for name, text in SECOND.items():
        (lib / name).parent.mkdir(parents=True, exist_ok=True)
        (lib / name).write_text(text)

    def call(*arguments: str, code: str = "") -> str:
        command = [python, *(["-c", code] if code else ["-m", "isas_cli"]), *arguments]
        done = subprocess.run(command, cwd=root, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def conforms(choice: str, *more: str) -> subprocess.CompletedProcess:
        command = [python, "-m", "pytest", "--pyargs", "isas_cli.conformance", *more]
        chosen = {**os.environ, "ISAS_CHOICE": choice}
        return subprocess.run(command, cwd=root, env=chosen, capture_output=True, text=True)

    call.root, call.conforms = root, conforms
    return call


def _copied(root: Path) -> Path:
    """The example, so that building leaves nothing in it."""
    return Path(shutil.copytree(EXAMPLE, root / "source"))


def test_the_example_is_found_by_every_command(beside):
    told = beside("scenes")
    assert "dark" in told and "huber" in told
    chosen = ["scene=dodoco", "sampler=dark", "loss=huber", "prior=level", "prior.height=2", *TINY]
    beside("run", *chosen, "hydra.run.dir=run")
    manifest = json.loads((beside.root / "run/manifest.json").read_text())
    assert manifest["guests"]["isas-example"].startswith("0.1+")
    assert manifest["guests"]["level"].startswith("1.0+")
    assert (records.load(beside.root / "run").history["prior"] == 2).all()
    beside("run", "resume=run", "budget.iterations=3")
    assert records.load(beside.root / "run").summary["iterations"] == 3
    beside("race", "scene=dodoco", *TINY, "samplers=[dark,uniform]", "hydra.run.dir=race")
    beside("run", "-m", *chosen, "sampler.power=2", "hydra.sweep.dir=sweep")
    assert len(list((beside.root / "sweep").rglob("summary.json"))) == 1
    small = ["scene=dodoco", "size=tiny", "target.spp=2", "estimator.batch=256", "repeats=2"]
    beside("variance", *small, "best=0", "samplers=[dark]", "hydra.run.dir=variance")
    rows = (beside.root / "variance/variance.csv").read_text().splitlines()[1:]
    assert [row.partition(",")[0] for row in rows] == ["uniform", "gradient", "dark"]


def test_a_guest_s_cameras_are_read(beside):
    folder = Path(shutil.copytree(ASSETS / "chessboard", beside.root / "photographs"))
    (folder / "cameras.json").rename(folder / "mine.rig")
    code = "from isas_cli.scene.photos.reading import read; import sys; print(*"
    code += "(len(read(sys.argv[1], cameras=file).cameras) for file in (None, 'mine.rig')))"
    assert beside(str(folder), code=code) == "13 13\n"


def test_the_example_s_kind_finds_what_it_stands_for(beside):
    key = "log:mirror.bsdf.roughness.value"
    unknown = f'scene.unknowns={{"{key}": {{"start": -0.7}}}}'
    chosen = ["scene=dodoco", "~scene.unknowns", unknown, *TINY[:-1], "estimator.batch=4096"]
    beside("run", *chosen, "budget.iterations=30", "target.spp=64", "hydra.run.dir=log")
    history = records.load(beside.root / "log").history
    assert history["parameter_rmse"].iloc[-1] < 0.7 * history["parameter_rmse"].iloc[0]


@pytest.mark.parametrize("choice", ["sampler=dark", "loss=huber loss.width=0.2"])
def test_the_example_keeps_what_isas_relies_on(choice, beside):
    done = beside.conforms(choice)
    assert done.returncode == 0, done.stdout


def test_what_is_not_kept_is_noticed(beside):
    """Without a floor the paper's sampler leaves out pixels that no derivative meets."""
    done = beside.conforms("sampler=ours sampler.floor=0", "-k", "every_pixel")
    assert done.returncode == 1 and "a pixel that is never drawn" in done.stdout


def test_a_race_goes_on_with_the_folders_and_the_slice_that_it_began_with(
    folder, tmp_path, monkeypatch, no_plots
):
    """One of its runs was killed before its record: what it is composed of lies in the folder."""
    monkeypatch.chdir(tmp_path)
    words = ["race", "--config-dir", str(folder), "scene=small", "loss=soft", *TINY]
    assert main([*words, "samplers=[uniform,relevant]", "slice=7", "hydra.run.dir=race"]) == 0
    kept = records.load(Path("race/uniform/seed1"))
    assert f"hydra.searchpath=[{folder}]" in kept.manifest["command"]
    shutil.rmtree("race/relevant")
    turns = []
    held = race.race.run
    monkeypatch.setattr(
        race.race, "run", lambda left, turn, begin: turns.append(turn) or held(left, turn, begin)
    )
    assert main(["race", "resume=race"]) == 0
    assert turns == [7.0]
    assert records.load(Path("race/relevant/seed1")).config["loss"]["epsilon"] == 0.5
    assert searchpath.VARIABLE not in os.environ


@pytest.mark.parametrize(
    "text, words",
    [
        ("name: [bad", "bad.yaml"),
        ("[a, b]", "holds no settings by name"),
        ("name: bad\nunknowns: 5", "unknowns: holds no settings by name"),
        ("name: bad\nmethod: [a]", "method: holds no settings by name"),
    ],
)
def test_a_file_of_one_s_own_that_cannot_be_read_is_named(folder, refused, text, words):
    (folder / "scene/bad.yaml").write_text(text)
    for command in (["run", "scene=bad"], ["scenes"]):
        if command == ["scenes"] and "unknowns" in words:
            continue  # which it lists as they are
        assert "scene/bad.yaml" in refused([*command, f"--config-dir={folder}"], words)


def test_a_loss_that_is_no_yaml_is_named(folder, refused):
    (folder / "loss/bad.yaml").write_text("name: [bad")
    refused(["run", "scene=pottery", "loss=bad", f"--config-dir={folder}"], "loss/bad.yaml")


def test_a_scene_may_take_a_budget_alone(folder, capsys):
    file = folder / "scene/small.yaml"
    file.write_text(file.read_text() + "\nmethod: {budget: {iterations: 5}}\n")
    assert main(["scenes", f"--config-dir={folder}"]) == 0
    assert "small" in capsys.readouterr().out


def test_brackets_of_one_s_own_are_listed_as_they_are(folder, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "300")
    file = folder / "scene/small.yaml"
    own = {
        "description": "a [red] [/]",
        "unknowns": {"wall[blue].data": None},
        "sizes": {"[b]": {}},
    }
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | own))
    (folder / "loss/soft.yaml").write_text("# sum [red] [/]\n")
    assert main(["scenes", f"--config-dir={folder}"]) == 0
    out = capsys.readouterr().out
    for text in ("a [red] [/]", "wall[blue].data", "[b]", "sum [red] [/]"):
        assert text in out


def test_home_is_a_folder_s_beginning(folder, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(folder.parent))
    assert main(["scenes", "--config-dir=~/mine"]) == 0
    assert "small" in capsys.readouterr().out
