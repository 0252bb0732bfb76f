"""Files that a configuration names are found from anywhere."""

import datetime
import os
import shlex
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from isas_cli.config import paths
from isas_cli.config.compose import compose, translate

STARTS = '{"ball.vertices": {"start": "sphere"}, "a": {"start": "a.exr"}, "b": {"start": 1}}'
UNKNOWNS = f"scene.unknowns={STARTS}"
FILES = ["scene.path=my.xml", "scene.targets=[a.exr,gone.exr]", "scene.masks=[/m.png,a.exr]"]


@pytest.fixture
def home(tmp_path, monkeypatch):
    for name in ("my.xml", "a.exr", "photos", "sphere"):
        (tmp_path / name).touch()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    return tmp_path


def located(settings: list[str], home: Path | str | None):
    cfg = compose(translate(settings))
    before = OmegaConf.to_yaml(cfg)
    paths.locate(cfg, None if home is None else str(home))
    return cfg.scene, OmegaConf.to_yaml(cfg) == before


def test_they_are_where_the_run_was_started(home):
    scene, _ = located(["scene=file", *FILES, UNKNOWNS], home)
    assert scene.path == str(home / "my.xml")
    # What is not there stays, and so do absolute ones.
    assert list(scene.targets) == [str(home / "a.exr"), "gone.exr"]
    assert list(scene.masks) == ["/m.png", str(home / "a.exr")]
    # A word is no file, even where there is one of its name.
    starts = {key: unknown.start for key, unknown in scene.unknowns.items()}
    assert starts == {"ball.vertices": "sphere", "a": str(home / "a.exr"), "b": 1}
    scene, _ = located(["scene=photos", "photos.path=photos", "photos.mesh=m.obj"], home)
    assert (scene.photos.path, scene.photos.mesh) == (str(home / "photos"), "m.obj")


def test_a_relative_name_may_mean_another_file_elsewhere(home):
    cfg = compose(translate(["scene=file", "scene.path=my.xml"]))
    assert paths.elsewhere(cfg, str(home)) is None  # there is none here
    Path("my.xml").touch()
    assert paths.elsewhere(cfg, str(home)) == "scene.path=my.xml"
    assert paths.elsewhere(cfg, str(Path.cwd())) is None
    assert paths.elsewhere(cfg, None) is None


def test_files_that_changed_after_a_time_are_told_those_of_a_scene_s_xml_too(home):
    Path("my.xml").write_text('<string name="filename" value="wood.png"/>')
    Path("wood.png").touch()
    cfg = compose(translate(["scene=file", "scene.path=my.xml"]))
    now = datetime.datetime.now(datetime.timezone.utc)
    before, after = ((now + datetime.timedelta(hours=h)).isoformat() for h in (-1, 1))
    assert paths.newer(cfg, before) == "scene.path=my.xml" and paths.newer(cfg, after) is None
    os.utime("my.xml", (0, 0))
    assert paths.newer(cfg, before) == "wood.png" and paths.newer(cfg, "") is None


def test_files_of_a_renderer_s_command_are_found_from_elsewhere(home, monkeypatch):
    (home / "draw").touch()

    def words(command: str) -> list[str]:
        scene, _ = located(["scene=external", f"external.command={command}"], home)
        return shlex.split(scene.external.command)

    whole = [str(home / name) for name in ("draw", "a.exr")]
    assert words("./draw a.exr gone.exr --x={x} {out}") == [*whole, "gone.exr", "--x={x}", "{out}"]
    assert words("draw a.exr {out}") == ["draw", whole[1], "{out}"]  # an installed one
    monkeypatch.chdir(home)  # where it is called as it was
    assert words("./draw a.exr {out}") == ["./draw", "a.exr", "{out}"]


@pytest.mark.parametrize(
    "setting", ["command=./draw.py {out}", "command=python draw.py {out}", "function=draw.render"]
)
def test_another_renderer_s_file_that_changed_after_a_time_is_told(home, setting):
    Path("draw.py").touch()
    cfg = compose(translate(["scene=external", f"external.{setting}"]))
    name = "./draw.py" if "./" in setting else "draw.py"
    told = f"scene.external.{setting.partition('=')[0]}={name}"
    assert paths.newer(cfg, "1999-01-01T00:00:00") == told
    assert paths.newer(cfg, "2999-01-01T00:00:00") is None


@pytest.mark.parametrize("gone", [None, "/nowhere/at/all"])
def test_records_of_what_has_moved_are_left_as_they_are(home, gone):
    """Their files are looked for in the working directory."""
    assert located(["scene=file", *FILES, UNKNOWNS], gone)[1]


@pytest.mark.parametrize(
    "typed, expected",
    [
        ("photos.texture=~/a.png", "scene.photos.texture=/home/me/a.png"),
        ("photos.texture=128", "scene.photos.texture=128"),
        ("scene.targets=[~/a.exr, ~/b.exr]", "scene.targets=[/home/me/a.exr, /home/me/b.exr]"),
        ("scene.masks=['~/a~/b.png']", "scene.masks=['/home/me/a~/b.png']"),
        ('scene.unknowns={"a": {"start": "~/a.exr"}}', "/home/me/a.exr"),
    ],
)
def test_home_is_found_in_lists_and_starts(typed, expected, monkeypatch):
    monkeypatch.setenv("HOME", "/home/me")
    assert expected in translate([typed])[0]


def test_what_lies_in_a_set_is_not_looked_for_where_the_run_was_started(home):
    """Folders of pictures and masks are the set's own, if it has them, as they were in the run."""
    for name in ("mug/masks", "masks", "images", "none"):
        (home / name).mkdir(parents=True)
    told = ["scene=photos", "photos.path=mug", "photos.masks=masks", "photos.images=images"]
    cfg = compose(translate(told))
    paths.locate(cfg, str(home))
    photos = cfg.scene.photos
    assert (photos.masks, photos.images) == ("masks", str(home / "images"))
    cfg = compose(translate([*told[:2], "photos.masks=none"]))
    paths.locate(cfg, str(home))
    assert cfg.scene.photos.masks == "none"
    (home / "elsewhere/mug/masks").mkdir(parents=True)
    (home / "elsewhere/masks").mkdir()
    names = [key for key, _ in paths.named(compose(translate(told[:3])))]
    assert names == ["scene.photos.path"]


def test_a_set_that_comes_along_has_its_own_masks(home):
    (home / "mask").mkdir()
    cfg = compose(translate(["scene=photos", "photos.path=head", "photos.masks=mask"]))
    paths.locate(cfg, str(home))
    assert cfg.scene.photos.masks == "mask"


def test_files_of_parts_are_looked_for_where_the_scene_looks(tmp_path):
    """Beside the main file, as Blender's add-on has it, by defaults and in its own folders."""
    names = ("textures/a.png", "other/b.png", "library/c.png")
    for name in (*names, "parts/x.xml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    main, part = tmp_path / "main.xml", tmp_path / "parts/x.xml"
    main.write_text("<scene><include filename='parts/x.xml'/><path value='library'/></scene>")
    part.write_text(
        "<scene><default name='dir' value='other'/>"
        "<string name='filename' value='textures/a.png'/>"
        "<string value='$dir/b.png' name='filename'/>"
        "<string name='filename' value='c.png'/>"
        f"<spectrum name='radiance' value='{'400:0.25, ' * 40}'/></scene>"
    )
    assert {tmp_path / name for name in names} <= set(paths._within(main, {main}))


def test_defaults_are_put_in_as_mitsuba_does(tmp_path):
    """Of names the longest first, and those of the scene around before a part's own."""
    main, part = tmp_path / "a.xml", tmp_path / "b.xml"
    main.write_text(
        "<scene><default name='tex' value='c'/><default name='texture' value='d'/>"
        "<include filename='b.xml'/></scene>"
    )
    part.write_text(
        "<scene><default name='tex' value='z'/><string name='filename' value='$tex.png'/>"
        "<string name='filename' value='$texture.png'/></scene>"
    )
    pictures = {tmp_path / name for name in ("c.png", "d.png")}
    found = paths._within(main, {main})  # values of defaults are names, too
    assert {each for each in found if each.suffix == ".png"} == pictures


def test_files_of_files_are_asked_when_they_were_changed(tmp_path):
    main, part, picture = (tmp_path / name for name in ("a.xml", "b.xml", "c.png"))
    main.write_text("<scene><include filename='b.xml'/></scene>")
    part.write_text("<scene><string name='filename' value='c.png'/></scene>")
    picture.write_bytes(b"")
    assert set(paths._within(main, {main})) == {part, picture}
    part.write_text(part.read_text() + "<include filename='a.xml'/>")  # round and round
    assert picture in paths._within(main, {main})
